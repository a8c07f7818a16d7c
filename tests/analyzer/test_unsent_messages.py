"""Messages that were due and never left are infinitely late for everyone who judges: drawn traces, analyzed whole.

Two vendors at 10 Hz for a minute. `whole` sends its 600 messages and takes 5 ms; `half` takes 1 ms and stops sending after
30 s, though its run goes on to the end: what it sent came back, all of it.
"""

import math

import pytest
from campaigns import write_run
from trace_files import Message, evenly, ping_session, run, write_pair
from wording import numbers

from dds_trace.analyzer.analysis import load_analysis
from dds_trace.analyzer.model.finding import Severity
from dds_trace.analyzer.pipeline import analyze
from dds_trace.analyzer.verdicts.answers import Clarity
from dds_trace.analyzer.verdicts.job import make_job
from dds_trace.analyzer.verdicts.recommend import Fit
from dds_trace.extensions.campaigns.verdicts.false_alarms import count_false_alarms, half_widths
from dds_trace.extensions.gates.compare import compare
from dds_trace.extensions.gates.gate import GateOutcome, parse_gates
from dds_trace.extensions.gates.gates import judge_gates

MS = 1_000_000
PERIOD = 100 * MS
DUE = 600
VENDORS = {"whole": "cyclonedds", "half": "fastdds"}
SENT = {"whole": 600, "half": 300}
LATENCY = {"whole": 5 * MS, "half": MS}


def record(folder, kind, *, first=0, vendor=None, domain_id=5, bridge="none"):
    """Three runs, each in a folder of its own, 1 % slower and faster in turn; those of another `first` are recorded in between."""
    vendor = vendor or VENDORS[kind]
    for number in range(first, first + 3):
        start = (number - first) * 10**12 + first * DUE * PERIOD
        way = round(LATENCY[kind] * (0.99 + 0.01 * (number - first)))
        write_run(
            folder / str(number),
            number,
            evenly([way] * SENT[kind], start_ns=start),
            ping={"vendor": vendor},
            relay={"vendor": vendor, "relay_id": 150 + number, "domain_id": domain_id},
            planned_messages=DUE,
            relay_domain_id=domain_id,
            bridge=bridge,
            extra={"ended_ns": start + (DUE - 1) * PERIOD + MS},
        )


def relabelled(analysis):
    return {run.run_id: number for number, run in enumerate(analysis.runs)}


@pytest.fixture(scope="module")
def sides(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sides")
    record(folder / "base", "whole", vendor="fastdds")
    record(folder / "new", "half", first=10)
    return tuple(analyze(folder / side, details=False) for side in ("base", "new"))


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    folder = tmp_path_factory.mktemp("both")
    record(folder / "whole", "whole")
    record(folder / "half", "half", first=10)
    job = make_job(data="binary", size="33KB", rate="10", deadline="50ms", reliability="0.9")
    return analyze(folder, deadline_ns=50 * MS, job=job)


def test_the_summary_counts_them(both):
    counts = dict(zip(both.summary["vendor"], both.summary.select("planned", "unsent").rows(), strict=True))
    assert counts == {"cyclonedds": (1800, 0), "fastdds": (1800, 900)}
    assert both.summary["received_ratio"].to_list() == [1.0, 1.0]
    assert both.unsent == {80: 300, 81: 300, 82: 300}


def test_a_comparison_calls_the_side_worse(sides):
    rows = {row["statistic"]: row for row in compare(*sides).rows.filter(metric="latency").to_dicts()}
    assert {rows[name]["verdict"] for name in ("p90", "p95")} == {"worse"}
    assert rows["p90"]["new_ns"] == math.inf
    assert rows["p90"]["new_survivors_ns"] == pytest.approx(MS, rel=0.02)
    assert rows["p90"]["new_received_ratio"] == pytest.approx(0.5)


@pytest.mark.parametrize("gate", ["latency_p90 > +10%", "latency_p90 > 20ms", "received_ratio < 99%"])
def test_gates_regress(sides, gate):
    (result,) = judge_gates(compare(*sides), parse_gates([gate]))
    assert result.outcome is GateOutcome.REGRESSED


def test_an_a_a_sweep_sees_them(sides):
    base, new = sides
    passes = relabelled(base) | relabelled(new)
    assert count_false_alarms(base.load_messages(), new.load_messages(), passes).measured > 0


def test_the_answer_is_the_one_that_sends(both):
    (answer,) = both.details.answers
    assert (answer.clarity, answer.leaders[0].name) == (Clarity.CLEAR, "cyclonedds")
    half = answer.contenders[1]
    assert (half.loses_more, half.received.value) == (True, pytest.approx(0.5))
    assert half.latency.value == math.inf
    assert half.survivors_ns == pytest.approx(MS, rel=0.02)


def test_the_recommendation_does_not_endorse_it(both):
    fits = {c.setting["vendor"]: c for c in both.details.recommendation.candidates}
    assert (fits["cyclonedds"].fit, fits["fastdds"].fit) == (Fit.MEETS, Fit.MISSES)
    assert fits["fastdds"].received_ratio == pytest.approx(0.5)


def test_they_miss_the_deadline(both):
    missed = both.details.freshness.group_by("group", maintain_order=True).sum()
    assert missed.sort("group").select("judged", "missed").rows() == [(1800, 0), (1800, 900)]


def test_a_bridge_that_holds_them_back_is_slower(tmp_path):
    record(tmp_path / "same", "whole", vendor="fastdds")
    record(tmp_path / "bridged", "half", first=10, domain_id=10, bridge="builtin")
    costs = analyze(tmp_path).details.bridge_costs
    (row,) = costs.filter(metric="latency", statistic="p90").to_dicts()
    assert (row["verdict"], row["new_ns"]) == ("worse", math.inf)
    assert row["new_survivors_ns"] == pytest.approx(MS, rel=0.02)


def test_a_sweep_that_waits_for_a_narrow_interval_goes_on(sides):
    base, new = sides
    for side, is_known in ((base, True), (new, False)):
        runs = {"cell": [described.run_id for described in side.runs]}
        width = half_widths(side.load_messages(), runs, "latency_p90")["cell"]
        assert math.isfinite(width) is is_known


def test_they_are_saved(both, tmp_path):
    both.save(tmp_path / "saved")
    loaded = load_analysis(tmp_path / "saved")
    assert loaded.unsent == both.unsent
    assert loaded.load_messages().equals(both.load_messages())


def test_what_was_under_way_when_the_ping_was_killed_is_neither_lost_nor_unsent(tmp_path, sentences):
    # 20 messages, replies after 200 ms: the last event is T1 of 19 and T2 of 17 at 1.9 s. Of 5 no reply came; 18 and 19 are open.
    messages = [
        Message(s, t0=t, t1=t, t3=t + 1, t4=t + 2, t2=t + 200 * MS if s < 18 and s != 5 else None)
        for s, t in enumerate(range(0, 20 * PERIOD, PERIOD))
    ]
    write_pair(tmp_path, messages, runs=[run(state="started", planned_messages=DUE, published=0)])
    analysis = analyze(tmp_path, deadline_ns=50 * MS)
    (row,) = analysis.summary.to_dicts()
    assert (row["published"], row["received"], row["lost_return"], row["unsent"]) == (18, 17, 1, 0)
    assert len(analysis.load_messages()) == 18
    assert analysis.details.freshness["judged"].to_list() == [18]
    (delivery,) = compare(analysis, analysis).delivery.to_dicts()
    assert delivery["new_received_ratio"] == pytest.approx(17 / 18)
    (finding,) = (one for one in analysis.findings if one.code == "unfinished_run")
    assert numbers(finding.what)[-3:] == [20, 600, 2]
    sentences(finding.what)
    assert finding.groups == (0,)


@pytest.mark.parametrize(
    ("state", "severity", "outcome"),
    [("finished", Severity.ERROR, GateOutcome.INCONCLUSIVE), ("started", Severity.WARNING, GateOutcome.PASSED)],
)
def test_a_run_of_which_nothing_left_is_told(tmp_path, state, severity, outcome):
    record(tmp_path / "runs", "whole")
    silent = run(run_id=500, state=state, planned_messages=DUE, published=0, extra={"session_id": f"{99:016x}"})
    write_pair(tmp_path / "runs" / "silent", [], ping=ping_session(session_id=99), runs=[silent])
    analysis = analyze(tmp_path / "runs", details=False)
    (finding,) = (one for one in analysis.findings if one.code == "unpublished_run")
    assert finding.severity is severity
    assert finding.where == "run 00000000000001f4 (silent/ping.mcap)"
    assert "None of 600 planned messages left" in finding.what
    record(tmp_path / "base", "whole", first=3)
    base = analyze(tmp_path / "base", details=False)
    (result,) = judge_gates(compare(base, analysis), parse_gates(["latency_p90 > +10%"]))
    assert result.outcome is outcome
