import math
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest
from roundtrip_frames import MS, in_runs, of_sizes, steady
from wording import numbers

from dds_trace.analyzer.model.finding import Finding, Severity
from dds_trace.analyzer.run_statistics.change import Change
from dds_trace.analyzer.statistics.distributions import shift_for_power, student_cdf, student_quantile
from dds_trace.analyzer.statistics.intervals import Basis, Interval
from dds_trace.analyzer.statistics.power import holm_adjusted
from dds_trace.base.errors import OptionError
from dds_trace.extensions.gates import gates
from dds_trace.extensions.gates.compare import CompareOptions, compare_roundtrips
from dds_trace.extensions.gates.gate import DEFAULT_GATES, Against, GateOutcome, parse_gate, parse_gates
from dds_trace.extensions.gates.gates import (
    _Advice,
    _advice,
    _advice_on_received,
    _Measured,
    judge_gates,
    options_for,
    overall_outcome,
    result_of,
)
from dds_trace.extensions.gates.info import comparison_info
from dds_trace.extensions.gates.sides import SideError, errors_of


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
        ("received_ratio < -0.5 points", "received_ratio", "", Against.DIFFERENCE, -0.005),
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
        (1.2, None, GateOutcome.REGRESSED),  # wherever the other end is
        (None, 1.05, GateOutcome.PASSED),
    ],
)
def test_a_gate_is_about_the_whole_interval(low, high, outcome):
    assert parse_gate("latency_p99 > +10%").judge(1.1, low, high) is outcome


def results_of(texts, base, new):
    gates = [parse_gate(text) for text in texts]
    options = options_for(gates, CompareOptions(metrics=(), statistics=()))
    return judge_gates(compare_roundtrips(base, new, options), gates)


@pytest.mark.parametrize(
    ("text", "is_passable"),
    [
        ("received_ratio > +1 points", True),
        ("received_ratio > -99 points", True),
        ("received_ratio > -101 points", False),
        ("received_ratio < +99 points", True),
        ("received_ratio < +101 points", False),
        ("received_ratio > 1%", True),
        ("received_ratio < 99%", True),
        ("received_ratio < 101%", False),
        ("latency_p50 > -5ms", True),
        ("latency_p50 < -5ms", True),
    ],
)
def test_a_gate_that_fails_whatever_is_measured_is_refused(text, is_passable):
    if is_passable:
        assert parse_gate(text).text == text
    else:
        with pytest.raises(OptionError, match="can pass"):
            parse_gate(text)


def test_the_change_that_would_have_been_found_is_the_same_as_a_share_and_as_a_time():
    base, new = in_runs([5 * MS] * 40, runs=5, spread=0.02), in_runs([5 * MS] * 40, runs=5, spread=0.02, run_id=2)
    by_share, by_time = results_of(["latency_p50 > +20%", "latency_p50 > +1ms"], base, new)
    assert 1.2 < by_share.found_from < 2
    assert by_time.found_from == pytest.approx((by_share.found_from - 1) * 5 * MS, rel=1e-3)
    lower, lower_time = results_of(["latency_p50 < -20%", "latency_p50 < -1ms"], base, new)
    assert 0.5 < lower.found_from < 0.8
    assert lower_time.found_from == pytest.approx((lower.found_from - 1) * 5 * MS, rel=1e-3)


def test_a_time_that_is_saved_may_be_all_that_the_base_takes():
    base, new = in_runs([5 * MS] * 40, spread=0.0), in_runs([6 * MS] * 40, spread=0.0)
    (result,) = results_of(["latency_p50 > -5ms"], base, new)
    assert result.outcome is GateOutcome.REGRESSED
    with pytest.raises(OptionError, match="can pass"):
        results_of(["latency_p50 > -5001us"], base, new)


def test_gates_on_frames():
    base, new = in_runs([5 * MS] * 40, spread=0.001), in_runs([6 * MS] * 40, spread=0.001)  # +20 %, +1 ms
    texts = [
        "latency_p50 > +10%",
        "latency_p50 > +2ms",
        "latency_p50 > 5.5ms",
        "received_ratio < 50%",
        "latency_p99 > +1%",
    ]
    results = results_of(texts, base, new)
    assert [r.outcome.value for r in results] == ["regressed", "passed", "regressed", "passed", "inconclusive"]
    assert [r.value for r in results[:4]] == pytest.approx([1.2, MS, 6 * MS, 1.0])
    assert results[4].reason.startswith("within one run: ")
    assert "payload_bytes=33000 rate_hz=10" in results[0].subject
    outcomes = [r.outcome for r in results]
    assert (overall_outcome([]), overall_outcome(outcomes)) == (GateOutcome.NOTHING_TO_COMPARE, GateOutcome.REGRESSED)
    assert overall_outcome(outcomes[1:2]) is GateOutcome.PASSED
    assert overall_outcome([outcomes[1], outcomes[4]]) is GateOutcome.INCONCLUSIVE


def test_losses_and_a_limit_of_one_side_need_no_interval_of_the_base():
    (result,) = results_of(["latency_p50 > 5.5ms"], steady([5 * MS] * 3), in_runs([6 * MS] * 40, spread=0.001))
    (lossy,) = results_of(["received_ratio < 99%"], in_runs([MS] * 300), in_runs([MS, None] * 150))
    assert result.outcome is lossy.outcome is GateOutcome.REGRESSED


def test_one_run_decides_no_gate_and_says_what_it_takes(sentences):
    results = results_of(["latency_p50 > +10%", "received_ratio < 99%"], steady([MS] * 99), steady([9 * MS] * 99))
    assert [r.outcome for r in results] == [GateOutcome.INCONCLUSIVE] * 2
    assert {r.reason.partition(": ")[0] for r in results} == {"within one run"}
    assert [numbers(r.reason)[0] for r in results] == [3, 3]
    sentences(*(r.reason for r in results))


def test_an_inconclusive_gate_says_how_many_runs_would_decide(sentences):
    sides = in_runs([10 * MS] * 40), in_runs([int(11.5 * MS)] * 40)
    (result,) = results_of(["latency_p50 > +10%"], *sides)
    said = comparison_info(compare_roundtrips(*sides), [result]).said
    assert 100 * (result.smallest_ratio - 1) < numbers(said.partition("Such runs decide")[2])[0]
    assert result.outcome is GateOutcome.INCONCLUSIVE
    # Spread 3 % a side, 4.4 % from the limit: smallest_shift(sqrt(2 / n) * 0.0296, 2 (n - 1)) <= 0.0445 from n = 9 on.
    assert numbers(result.reason) == [9, 3, 3]
    sentences(result.reason)
    assert result.smallest_ratio > 1


def test_an_inconclusive_tail_says_how_many_messages_it_takes(sentences):
    """Ninety messages have no p99, 120 of three runs have one within them only."""
    (short,) = results_of(["latency_p99 > +10%"], in_runs([MS] * 30), in_runs([MS] * 30, run_id=2))
    assert short.reason.startswith("within one run: p99 takes ")
    assert numbers(short.reason)[:2] == [100, 90]
    sentences(short.reason)
    slow = [MS + (9 * MS if i % 150 == 0 else i % 7 * 1000) for i in range(40)]
    (few,) = results_of(["latency_p99 > +10%"], in_runs(slow, runs=3), in_runs(slow, runs=3, run_id=2))
    assert few.outcome is GateOutcome.INCONCLUSIVE
    more = int(re.search(r"record about ([\d,]+) more a side", few.reason)[1].replace(",", ""))
    assert 0 < more < 5000


def test_an_inconclusive_received_ratio_says_how_many_runs_and_what_it_could_have_seen():
    base = pl.concat(
        steady([None if i < lost else MS for i in range(1000)], run_id=run_id)
        for run_id, lost in ((1, 8), (2, 10), (3, 12))
    )
    new = pl.concat(
        steady([None if i < lost else MS for i in range(1000)], run_id=run_id)
        for run_id, lost in ((4, 10), (5, 14), (6, 18))
    )
    (result,) = results_of(["received_ratio < -0.5 points"], base, new)
    assert result.outcome is GateOutcome.INCONCLUSIVE
    assert result.value == pytest.approx(-0.004)
    assert numbers(result.reason)[1:] == [3, 3]
    assert "would decide" in result.reason
    # The runs vary by less than outages of half the mean one of 12 messages do; with Welch's four degrees that is found in 80 of 100.
    angle = sum(math.asin(math.sqrt(lost / 1000)) for lost in (8, 10, 12)) / 3
    farthest = angle + math.sqrt(2 * 6 / 4000 / 3) * shift_for_power(4, 0.95, 0.8)
    assert result.found_from < -0.005 - result.smallest_drop / 2
    assert result.smallest_drop == pytest.approx(math.sin(farthest) ** 2 - math.sin(angle) ** 2, rel=0.01)
    (alone,) = results_of(["received_ratio < 99%"], base, new)
    assert alone.smallest_drop is None


def test_a_missing_and_a_dead_group_regress_unless_that_is_allowed(sentences):
    base = pl.concat([in_runs([MS] * 40, payload_bytes=size, run_id=size) for size in (1, 2, 3)])
    new = pl.concat([in_runs([MS] * 40, payload_bytes=1), in_runs([None] * 40, payload_bytes=2, run_id=2)])
    comparison = compare_roundtrips(base, new, CompareOptions(metrics=("latency",), statistics=("p50",)))
    gates = [parse_gate("latency_p50 > +50%")]
    results = judge_gates(comparison, gates)
    assert [r.outcome.value for r in results[:2]] == ["regressed", "regressed"]
    missing, unanswered = (r.reason for r in results[:2])
    assert missing == "missing on the new side"
    assert unanswered.startswith("no reply was received")
    sentences(missing, unanswered)
    assert "payload_bytes=3" in results[0].subject
    allowed = judge_gates(comparison, gates, allow_missing=True)
    assert "every group" not in " ".join(r.gate.text for r in allowed)


def test_a_finding_of_severity_error_leaves_its_groups_inconclusive():
    base, new = in_runs([5 * MS] * 40), in_runs([9 * MS] * 40)
    found = compare_roundtrips(base, new, CompareOptions(metrics=("latency",), statistics=("p50",)))
    gates = [parse_gate("latency_p50 > +10%")]
    for groups, outcome in ((frozenset(), "inconclusive"), (frozenset({("other",)}), "regressed")):
        (result,) = judge_gates(replace(found, errors=(SideError("new: recorder_drops", groups),)), gates)
        assert result.outcome.value == outcome


def test_an_error_of_a_recording_is_about_the_whole_side_though_it_names_its_groups():
    keys = [("one",), ("other",)]
    of_recording, of_group = (
        Finding(Severity.ERROR, code, "where", "What.", "Do.", groups=(1,))
        for code in ("recorder_drops", "not_applied")
    )
    told = list(errors_of("new", [of_recording, of_group, of_recording], keys))
    assert "(where and 1 more)" in told[0].text
    assert [[one.is_about(key) for key in keys] for one in told] == [[True, True], [False, True]]


def test_many_groups_are_adjusted_by_holm():
    (alone,) = results_of(["latency_p50 > +1%"], of_sizes([1.0]), of_sizes([1.1]))
    among = results_of(["latency_p50 > +1%"], of_sizes([1.0] * 40), of_sizes([1.1] + [1.0] * 39))
    assert alone.outcome is GateOutcome.REGRESSED
    assert among[0].outcome is GateOutcome.INCONCLUSIVE
    assert "Holm over groups" in among[0].reason


def normal_beyond(errors):
    return math.erfc(errors / math.sqrt(2)) / 2


Z = 1.959963984540054  # standard errors that an interval of 95 % reaches


@pytest.mark.parametrize(
    ("value", "low", "high", "limit", "is_ratio", "p"),
    [
        # The end towards the limit is one reach away, the limit two; above it, then below.
        (3.0, 2.0, None, 1.0, False, normal_beyond(2 * Z)),
        (1.0, None, 2.0, 3.0, False, normal_beyond(2 * Z)),
        (math.exp(2), math.e, None, 1.0, True, normal_beyond(2 * Z)),
        (math.exp(1), None, math.exp(2), math.exp(4), True, normal_beyond(3 * Z)),
        # Where one of the three has no logarithm they are compared as they are.
        (0.0, None, 1.0, 2.0, True, normal_beyond(2 * Z)),
        (2.0, 0.0, None, -1.0, True, normal_beyond(1.5 * Z)),
        # Of an infinite value the reciprocals: 0, -1/2 and -1/1.5.
        (math.inf, 2.0, None, 1.5, True, normal_beyond(2 / 1.5 * Z)),
        (math.inf, math.inf, None, 1.5, True, 0.0),
        (2.0, 2.0, None, 1.5, True, 0.0),  # no spread at all
        # Without the end that counts nothing is known but the interval's own error.
        (2.0, None, 3.0, 1.0, True, 0.025),
        (None, 2.0, 3.0, 1.0, True, 0.025),
    ],
)
def test_how_likely_a_value_this_far_beyond_a_limit_is_by_chance(value, low, high, limit, is_ratio, p):
    gate = replace(parse_gate("latency_p50 > +10%"), limit=limit)
    result = result_of(gate, "", GateOutcome.REGRESSED, value, low, high)
    judged = _Measured(result, (), None, _Advice(""), 0.0, 0.0)
    assert judged.p_beyond(0.95, is_ratio=is_ratio) == pytest.approx(p, rel=1e-6)
    few = replace(judged, degrees=2).p_beyond(0.95, is_ratio=is_ratio)
    assert few > p or p in {0.0, 0.025}
    if (value, limit, is_ratio) == (3.0, 1.0, False):
        t = 2 * 4.302652729911275  # of two degrees of freedom there is a closed form
        assert few == pytest.approx(0.5 - t / (2 * math.sqrt(2 + t * t)), rel=1e-6)


def side(value, low, high, *, runs=4, basis=Basis.BETWEEN_RUNS, samples=400, spread=None, episodes=None):
    return Interval(value, low, high, 0.95, samples, 100, basis, runs, runs, episodes, spread)


@pytest.mark.parametrize(
    ("text", "value", "low", "high", "wanted"),
    [
        # The reach towards the limit is 3 or 2, the limit 1 away: nine and four times the runs.
        ("received_ratio < -1 points", 0.0, -0.03, 0.02, [36, 3, 4]),
        ("received_ratio < -1 points", -0.02, -0.05, 0.0, [16, 3, 4]),
        # A limit that is far takes one run more at the least, of the side that has more.
        ("received_ratio < -50 points", 0.0, -0.03, 0.02, [5, 3, 4]),
        ("received_ratio < -1 points", -0.01, -0.03, 0.02, []),
        ("received_ratio < -0.5 points", 0.993 - 0.998, -0.03, 0.02, []),  # a limit but for the error of a float
        ("received_ratio < -1 points", -0.0099, -0.03, 0.02, [1000, 3, 4]),  # and no number beyond it
        ("received_ratio < -1 points", None, -0.03, 0.02, []),
        ("received_ratio < -1 points", 0.0, None, 0.02, []),
        ("received_ratio < -1 points", 0.0, -0.03, None, []),
        ("received_ratio < 50%", 0.75, 0.0, 1.0, [36, 4]),
        ("received_ratio < 50%", 0.25, 0.0, 0.75, [16, 4]),
        ("received_ratio < 50%", 0.75, 0.25, 1.0, [16, 4]),
        ("received_ratio < 50%", None, 0.3, 0.6, []),
    ],
)
def test_how_many_runs_a_share_takes(text, value, low, high, wanted):
    gate, new = parse_gate(text), side(value, low, high)

    def advice(base_runs):
        base = [] if gate.against is Against.NEW else [side(1.0, 0.9, 1.0, runs=base_runs)]
        return _advice_on_received(gate.limit, value, low, high, [*base, new]).text

    assert numbers(advice(3)) == wanted
    assert ("would decide" if wanted else "do not decide") in advice(3)
    if gate.against is not Against.NEW:
        assert numbers(advice(2)) == [3, 2, 4]
    assert all(number <= 1000 for number in numbers(advice(3)))


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        # Spreads 5 % a side, 10 % from the limit each: what runs_to_decide says of them is tested where it is.
        ("latency_p50 > +20%", [7, 3, 4]),
        ("latency_p50 > +2ms", [7, 3, 4]),
        ("latency_p50 > 12ms", [5, 4]),
        ("latency_p50 > +100%", [5, 3, 4]),
        ("latency_p50 > -2000ms", "do not decide"),
        ("latency_p50 > -100%", "do not decide"),  # a ratio of 0 is no limit that runs could settle
        ("latency_p50 < -30%", [5, 3, 4]),
        ("latency_p50 > +10%", "too close to the limit"),  # where it is
    ],
)
def test_how_many_runs_a_time_takes(text, wanted, sentences):
    base = side(10.0 * MS, 9.0 * MS, 11.0 * MS, runs=3, spread=0.05)
    new = side(11.0 * MS, 10.0 * MS, 12.0 * MS, spread=0.05)
    said, runs = _advice(parse_gate(text), Change(base, new, Basis.BETWEEN_RUNS, ratio=1.1))
    assert runs == (None if isinstance(wanted, str) else wanted[0])
    assert ((wanted in said) if runs is None else numbers(said) == wanted) is True
    sentences(said)
    lost = Change(base, replace(new, upper=math.inf, unit_spread=None), Basis.BETWEEN_RUNS, ratio=1.1)
    assert "too much was lost" in _advice(parse_gate(text), lost).text


@pytest.mark.parametrize(("between", "says"), [(0.0, "times the messages a run"), (0.1, "runs a side would decide")])
def test_longer_runs_decide_where_runs_differ_by_their_messages_alone(between, says):
    generator = np.random.default_rng(3)
    base, new = (
        pl.concat(
            steady(
                MS * level * np.exp(generator.normal(between * generator.normal(), 0.5, 200)), run_id=10 * level + run
            )
            for run in range(5)
        )
        for level in (10, 11)
    )
    (result,) = results_of(["latency_p50 > +5%"], base, new)
    assert result.outcome is GateOutcome.INCONCLUSIVE
    assert says in result.reason


@pytest.fixture
def family(monkeypatch):
    """What Holm's procedure is given and gives: `asked` by gate, and `answer` in its place once that is set."""
    one = SimpleNamespace(asked=[], answer=None)

    def adjust(p_values):
        one.asked.append(list(p_values))
        return holm_adjusted(p_values) if one.answer is None else np.array(one.answer)

    monkeypatch.setattr(gates, "holm_adjusted", adjust)
    return one


def test_each_gate_asks_how_likely_its_groups_are_by_chance(family):
    base = in_runs([5 * MS] * 40, runs=5, spread=0.003)
    new = in_runs([6 * MS, 6 * MS, 6 * MS, None] * 10, runs=4, spread=0.003)
    texts = ["latency_p50 > 5.9ms", "latency_p50 > +15%", "received_ratio < 90%", "received_ratio < -5 points"]
    results = results_of(texts, base, new)
    assert {each.outcome for each in results} == {GateOutcome.REGRESSED}
    assert [len(each) for each in family.asked] == [1] * 4

    def p_value(result, scale, degrees):
        end = scale(result.low if result.value > result.gate.limit else result.high)
        value, limit = scale(result.value), scale(result.gate.limit)
        reach = student_quantile(0.975, degrees)
        return student_cdf(-reach * (value - limit) / (value - end), degrees)

    (absolute,), _, (share,), (drop,) = family.asked
    assert absolute == pytest.approx(p_value(results[0], math.log, 3), rel=1e-6)
    assert share == pytest.approx(p_value(results[2], float, 3), rel=1e-6)
    assert drop == pytest.approx(p_value(results[3], float, 3), rel=1e-6)


@pytest.mark.parametrize(
    ("adjusted", "outcome"),
    [(0.02, "regressed"), ((1 - 0.95) / 2, "regressed"), (0.0251, "inconclusive"), (0.04, "inconclusive")],
)
def test_half_of_the_error_of_an_interval_may_be_chance(family, adjusted, outcome):
    family.answer = [adjusted]
    base, new = in_runs([5 * MS] * 40, spread=0.001), in_runs([6 * MS] * 40, spread=0.001)
    (result,) = results_of(["latency_p50 > +10%"], base, new)
    assert result.outcome.value == outcome


def test_what_keeps_a_time_from_being_decided_comes_first(sentences):
    whole = side(10.0 * MS, 9.0 * MS, 11.0 * MS, spread=0.05)
    few = replace(whole, runs=2)
    short = side(None, None, None, samples=40)
    by_ratio, by_value = parse_gate("latency_p99 > +20%"), parse_gate("latency_p99 > 20ms")
    reasons = []
    for before, now, relative, alone in (
        (few, whole, ("runs", [3, 2, 4]), None),
        (whole, few, ("runs", [3, 4, 2]), ("runs", [3, 2])),
        (short, whole, ("messages", [100, 40]), None),
        (whole, short, ("messages", [100, 40]), ("messages", [100, 40])),
    ):
        change = Change(before, now, Basis.BETWEEN_RUNS, ratio=1.0)
        reasons += [_advice(gate, change).text for gate in (by_ratio, by_value)]
        taken = [(re.findall(r"takes \d+ (\w+)", said), numbers(said)) for said in reasons[-2:]]
        assert taken[0] == ([relative[0]], relative[1])
        assert taken[1] == ([alone[0]], alone[1]) if alone else reasons[-1].startswith("about ")
    sentences(*reasons)


def test_default_gates_are_three():
    assert [gate.text for gate in parse_gates(["default"])] == list(DEFAULT_GATES)
    assert len(parse_gates(["default", "rtt_p50 > +2ms"])) == len(DEFAULT_GATES) + 1


def test_a_run_without_an_end_passes_no_gate_and_its_fragment_weighs_nothing(sentences):
    base, whole = in_runs([5 * MS] * 40, runs=5), in_runs([5 * MS] * 40, runs=4)
    gates = [parse_gate("latency_p50 > +10%"), parse_gate("received_ratio < -50 points")]
    reasons = set()
    for fragment, unfinished in (([5 * MS], 1), ([900 * MS], 1), ([None], 1), ([5 * MS] * 40, 1), ([5 * MS] * 40, 0)):
        new = pl.concat([whole, steady(fragment, run_id=99)])
        found = compare_roundtrips(base, new, unfinished=[99] if unfinished else [])
        results = judge_gates(found, gates)
        assert [r.outcome.value for r in results] == ["inconclusive" if unfinished else "passed"] * 2
        assert [r.reason.partition(": ")[0] for r in results] == ["1 run did not finish" if unfinished else ""] * 2
        reasons |= {r.reason for r in results}
        assert found.rows.filter(statistic="p50")["ratio"].to_list() == pytest.approx([1, 1], rel=0.01)
    sentences(*sorted(reasons))
    slow = pl.concat([in_runs([9 * MS] * 40, runs=4), steady([5 * MS], run_id=99)])
    results = judge_gates(compare_roundtrips(base, slow, unfinished=[99]), gates)
    assert results[0].outcome is GateOutcome.REGRESSED


@pytest.mark.parametrize(("results", "outcome"), [(1, "regressed"), (50, "inconclusive")])
def test_a_p99_that_is_lost_in_every_run_is_by_chance_among_many(results, outcome):
    """Two percent lost in each of five runs against none: 1 of 252 ways to deal the runs, not certainty."""
    some = [MS] * 98 + [None] * 2

    def side(times):
        return pl.concat(in_runs(times, runs=5, run_id=10 * size, payload_bytes=size) for size in range(1, results + 1))

    whole = side([MS] * 100)
    lossy = pl.concat([whole.filter(pl.col("payload_bytes") > 1), in_runs(some, runs=5, run_id=10, payload_bytes=1)])
    judged = judge_gates(
        compare_roundtrips(whole, lossy, CompareOptions(metrics=("latency",), statistics=("p99",))),
        [parse_gate("latency_p99 > +20%")],
    )
    assert judged[0].outcome.value == outcome
