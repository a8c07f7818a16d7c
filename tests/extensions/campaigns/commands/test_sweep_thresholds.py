import json

import pytest
from processes import run, socket_plan

from dds_trace.base.errors import OptionError
from dds_trace.extensions.gates.gate import Against, GateOutcome, parse_threshold


@pytest.fixture
def sweep(tmp_path, domain_id):
    def start(thresholds, *options, repeats=3):
        path = tmp_path / "p.toml"
        path.write_text(socket_plan(domain_id, messages=100, repeats=repeats, more=f"[thresholds]\n{thresholds}\n"))
        return run("dds-trace", "sweep", path, "--out", tmp_path / "runs", *options)

    return start


def test_a_threshold_is_the_gate_that_fails_where_it_is_missed():
    gate = parse_threshold("latency_p99", "< 20 ms")
    assert (gate.metric, gate.statistic, gate.against, gate.limit) == ("latency", "p99", Against.NEW, 20e6)
    assert gate.text == "latency_p99 < 20 ms"
    assert gate.judge(10e6, 8e6, 12e6) is GateOutcome.PASSED
    assert gate.judge(20e6, 20e6, 20e6) is GateOutcome.REGRESSED  # not below 20 ms
    assert gate.judge(19e6, 15e6, 25e6) is GateOutcome.INCONCLUSIVE
    received = parse_threshold("received_ratio", ">=99.9%")
    assert received.limit == pytest.approx(0.999)
    assert received.judge(1.0, 0.9995, 1.0) is GateOutcome.PASSED
    assert received.judge(0.99, 0.98, 0.995) is GateOutcome.REGRESSED


@pytest.mark.parametrize(
    ("metric", "condition", "word"),
    [
        ("latency_p98", "< 20 ms", "latency_p9"),
        ("latency_p99", "20 ms", "what passes"),
        ("latency_p99", "< 20 parsecs", "no limit"),
        ("received_ratio", "> 5 ms", "99%"),
    ],
)
def test_what_is_no_threshold_is_one_line(metric, condition, word):
    with pytest.raises(OptionError) as error:
        parse_threshold(metric, condition)
    assert word in str(error.value)
    assert "[thresholds]" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("thresholds", "options", "repeats", "word"),
    [
        ("latency_p98 = '< 20 ms'", (), 3, "latency_p98"),
        ("latency_p50 = 20", (), 3, "condition"),
        ("latency_p50 = '< 20 ms'", (), 2, "repeats"),
        ("latency_p50 = '< +10%'", (), 3, "one side"),
        ("['payload=3']\nlatency_p50 = '< 20 ms'".replace("[", "[thresholds."), (), 3, "COLUMN=PATTERN"),
        ("", ("--limits", "missing.toml"), 3, "missing.toml"),
        ("latency_p98 = '< +20 %'", ("--against", "SAME"), 3, "latency_p98"),
    ],
)
def test_bad_thresholds_end_the_sweep_before_its_first_recording(sweep, tmp_path, thresholds, options, repeats, word):
    done = sweep(thresholds, *options, repeats=repeats)
    assert done.status == 2
    assert word in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "runs").exists()


@pytest.mark.thorough
@pytest.mark.middleware
def test_a_sweep_ends_with_pass_or_fail(sweep):
    passed = sweep("latency_p50 = '< 10 s'\nreceived_ratio = ['> 10 %', '<= 100 %']", "--json")
    assert passed.status == 0, passed.stderr
    judged = json.loads(passed.stdout)["thresholds"]
    assert [one["threshold"] for one in judged] == [
        "latency_p50 < 10 s",
        "received_ratio > 10 %",
        "received_ratio <= 100 %",
    ]
    assert {one["outcome"] for one in judged} == {"passed"}
    # The recordings are there: other thresholds are judged without another run.
    failed = sweep("rtt_p50 = '< 1 s'\n[thresholds.'payload_bytes=1*']\nrtt_p50 = '< 1 ns'")
    assert failed.status == 20, failed.stderr
    assert "\n✗  rtt_p50 < 1 ns" in failed.stdout
    # Of two sides the new one is judged, by changes too.
    changed = sweep("latency_p50 = ['< 10 s', '< +99900 %']\nrtt_p50 = '< 1 ns'", "--against", "SAME", "--json")
    assert changed.status == 20, changed.stderr
    assert json.loads(changed.stdout)["outcome"] == "regressed"
