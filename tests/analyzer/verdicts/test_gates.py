"""Gates: the grammar and its errors, outcomes by hand, overall outcome and exit codes."""

from __future__ import annotations

import pytest
from roundtrip_frames import MS, steady

from dds_trace.analyzer.verdicts.compare import CompareOptions, compare_roundtrips
from dds_trace.analyzer.verdicts.gates import (
    Against,
    GateOutcome,
    judge_gates,
    options_for,
    overall_outcome,
    parse_gate,
)
from dds_trace.tracefile.errors import OptionError


@pytest.mark.parametrize(
    ("text", "metric", "statistic", "against", "limit"),
    [
        ("latency_p99 > +10%", "latency", "p99", Against.RATIO, 1.1),
        ("latency_p99>=+10%", "latency", "p99", Against.RATIO, 1.1),
        ("  rtt_mean  <  -2.5 %", "rtt", "mean", Against.RATIO, 0.975),
        ("response_p99.9 > 20ms", "response", "p99_9", Against.NEW, 20 * MS),
        ("response_p99_9 > 0.02s", "response", "p99_9", Against.NEW, 20 * MS),
        ("intermediate_p50 > +500us", "intermediate", "p50", Against.DIFFERENCE, 500_000),
        ("Latency_P90 > -3ns", "latency", "p90", Against.DIFFERENCE, -3),
        ("received_ratio < 99.9%", "received_ratio", "", Against.NEW, 0.999),
    ],
)
def test_the_grammar(text, metric, statistic, against, limit):
    gate = parse_gate(text)
    assert (gate.metric, gate.statistic, gate.against) == (metric, statistic, against)
    assert gate.limit == pytest.approx(limit)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("latency_p9 > +10%", "did you mean 'latency_p99'"),
        ("latncy_p99 > +10%", "did you mean 'latency_p99'"),
        ("p99 > +10%", "did you mean '"),
        ("latency_p99", "write METRIC > LIMIT"),
        ("", "write METRIC > LIMIT"),
        ("latency_p99 = 5ms", "write METRIC > LIMIT"),
        ("latency_p99 > 10%", r"write \+10%"),
        ("latency_p99 > 10", "no limit '10'"),
        ("latency_p99 > +10 percent", "no limit"),
        ("latency_p99 > ten ms", "no limit"),
        ("received_ratio < 5ms", "takes a share"),
        ("received_ratio < -1%", "takes a share"),
    ],
)
def test_errors_say_what_to_write(text, words):
    with pytest.raises(OptionError, match=words):
        parse_gate(text)


@pytest.mark.parametrize(
    ("low", "high", "outcome"),
    [
        (1.11, 1.30, GateOutcome.REGRESSED),
        (1.00, 1.10, GateOutcome.PASSED),  # 1.10 is not more than 10 %
        (1.05, 1.20, GateOutcome.INCONCLUSIVE),
        (None, None, GateOutcome.INCONCLUSIVE),
    ],
)
def test_a_gate_is_about_the_whole_interval(low, high, outcome):
    assert parse_gate("latency_p99 > +10%").judge(1.1, low, high) is outcome


def results_of(texts, base, new):
    gates = [parse_gate(text) for text in texts]
    options = options_for(gates, CompareOptions(metrics=(), statistics=(), replicates=199))
    return judge_gates(compare_roundtrips(base, new, options), gates)


def test_gates_on_frames():
    base, new = steady([5 * MS] * 40), steady([6 * MS] * 40)  # +20 %, +1 ms
    texts = [
        "latency_p50 > +10%",
        "latency_p50 > +2ms",
        "latency_p50 > 5.5ms",
        "received_ratio < 50%",
        "latency_p99 > +1%",
    ]
    results = results_of(texts, base, new)
    assert [r.outcome.value for r in results] == [
        "regressed",
        "passed",
        "regressed",
        "passed",
        "inconclusive",
    ]
    assert [r.measured for r in results] == [1.2, MS, 6 * MS, 1.0, None]
    assert "payload_bytes=33000 rate_hz=10" in results[0].where
    assert overall_outcome(results) is GateOutcome.REGRESSED
    assert overall_outcome(results[1:2]) is GateOutcome.PASSED
    assert overall_outcome([results[1], results[4]]) is GateOutcome.INCONCLUSIVE


def test_a_single_side_gate_needs_no_interval_of_the_base():
    (result,) = results_of(["latency_p50 > 5.5ms"], steady([5 * MS] * 3), steady([6 * MS] * 40))
    assert result.outcome is GateOutcome.REGRESSED


def test_losses_regress():
    (result,) = results_of(["received_ratio < 99%"], steady([MS] * 300), steady([MS, None] * 150))
    assert result.outcome is GateOutcome.REGRESSED


def test_nothing_in_common_is_an_outcome_of_its_own():
    results = results_of(["latency_p50 > +10%"], steady([MS] * 9), steady([MS] * 9, vendor="zenoh"))
    assert results == []
    assert overall_outcome(results) is GateOutcome.NOTHING_TO_COMPARE


def test_exit_codes_are_distinct_and_not_those_of_errors():
    codes = {outcome.value: outcome.exit_code for outcome in GateOutcome}
    assert codes == {"passed": 0, "regressed": 20, "inconclusive": 21, "nothing to compare": 22}
