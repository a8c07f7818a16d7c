import math
from dataclasses import replace

import numpy as np
import pytest

from dds_trace.analyzer.run_statistics.between_runs import Estimate, Units
from dds_trace.analyzer.statistics.distributions import student_cdf, student_quantile
from dds_trace.analyzer.statistics.intervals import Basis, Interval
from dds_trace.analyzer.statistics.power import runs_to_decide
from dds_trace.analyzer.verdicts.judgements import OPEN, PROVEN
from dds_trace.analyzer.verdicts.ranking import Kind, RankingOptions, judge_losers, rank_setups
from dds_trace.analyzer.verdicts.setup_runs import SetupRuns

INTERVAL = Interval(None, None, None, 0.95, 180, 180, Basis.BETWEEN_RUNS, 3, 3, None)
NO_MARGIN = RankingOptions(margin=0.0)


def estimate(mean, spread=0.05):
    values = np.exp(mean + spread * np.array([-1.0, 0.0, 1.0]))
    return Estimate(replace(INTERVAL, value=math.exp(mean)), Units(values, 180, 180, 3, None))


UNITS_NONE = Estimate(replace(INTERVAL, value=1.0, basis=Basis.WITHIN_RUN, runs=2, units=0), None)


def runs(p50, p99=None, **more):
    estimates = {"p50": p50} | ({} if p99 is None else {"p99": p99})
    return SetupRuns(estimates, **more)


def kind(family="kind", percentiles=("p50",), barred="", **setups):
    return Kind(family, setups, percentiles, barred=frozenset(barred))


def step(t, spread=0.05):
    """The distance of two means for which Welch's test of 3 and 3 runs has this t."""
    return t * spread * math.sqrt(2 / 3)


SAME = estimate(0.0)
LIKELY = estimate(step(3.0))
"""p = 0.04 against `SAME`, by t with four degrees of freedom."""
SURE = estimate(step(7.0))
"""p = 0.002."""


def test_the_lead_is_one_claim_and_each_pair_another():
    # Three pairs: by Holm 0.04 * 3 shows none of them, by the largest of its two p values `a` leads.
    (ranking,) = rank_setups([kind(a=runs(SAME), b=runs(LIKELY), c=runs(LIKELY))])
    assert ranking["p50"].leader == "a"
    assert ranking["p50"].letters == {"a": "a", "b": "b", "c": "b"}
    assert ranking["p50"].lead.needs is None
    (barred,) = rank_setups([kind(barred="a", a=runs(SAME), b=runs(LIKELY), c=runs(LIKELY))])
    assert (barred["p50"].leader, set(barred["p50"].letters.values())) == ("", {"a"})
    assert barred["p50"].lead.p == pytest.approx(0.04, abs=0.001)
    assert barred["p50"].lead.needs > 3


@pytest.mark.parametrize("t", [1.0, 3.0])
def test_a_pair_has_the_ratio_of_its_means_with_its_interval_and_the_repeats_that_would_decide(t):
    (ranking,) = rank_setups([kind(a=runs(SAME), b=runs(estimate(step(t))))], options=NO_MARGIN)
    lead, reach = ranking["p50"].lead, step(student_quantile(0.975, 4))
    ends = np.exp([step(t), step(t) - reach, step(t) + reach])
    assert [lead.value, lead.low, lead.high] == pytest.approx(ends.tolist())
    assert lead.basis == "between runs"
    assert lead.p == pytest.approx(2 * student_cdf(-t, 4) / 0.9)
    assert lead.needs == (runs_to_decide(step(t), 0.05, 0.05, 0.95) if t < 3 else None)


@pytest.mark.parametrize(
    ("median", "tail", "leader"), [(SAME, LIKELY, ""), (SAME, SURE, "a"), (SURE, LIKELY, "a"), (SURE, SAME, "")]
)
def test_a_lead_at_p99_alone_takes_a_fifth_of_the_significance_level(median, tail, leader):
    setups = {"a": runs(SAME, SAME), "b": runs(median, tail)}
    (ranking,) = rank_setups([kind(percentiles=("p50", "p99"), **setups)])
    assert ranking["p99"].leader == leader


@pytest.mark.parametrize(
    ("median", "tail", "letters"), [(SAME, LIKELY, "aa"), (SURE, LIKELY, "ab"), (SAME, SURE, "ab")]
)
def test_so_does_a_difference_of_setups_that_may_not_lead(median, tail, letters):
    setups = {"a": runs(SAME, SAME), "b": runs(median, tail)}
    (ranking,) = rank_setups([kind(percentiles=("p50", "p99"), barred="a", **setups)])
    assert "".join(ranking["p99"].letters.values()) == letters


def test_what_enough_repeats_of_one_kind_show_takes_another_one_among_forty():
    kinds = [kind(number, a=runs(SAME), b=runs(SURE if number == 0 else SAME)) for number in range(40)]
    lead = rank_setups(kinds)[0]["p50"].lead
    assert (lead.subject, lead.base, lead.verdict, lead.needs) == ("a", "b", OPEN, 4)
    assert rank_setups(kinds[:2])[0]["p50"].leader == "a"


def ratio_of(fast, slow):
    (ranking,) = rank_setups([kind(a=runs(fast), b=runs(slow))], 1 - 1e-12, NO_MARGIN)
    return ranking["p50"].lead.value


def test_a_lead_of_just_the_margin_is_enough():
    margin = ratio_of(SAME, SURE) - 1
    leaders = {
        more: rank_setups([kind(a=runs(SAME), b=runs(SURE))], options=RankingOptions(margin + more))[0]["p50"].leader
        for more in (0.0, 1e-9)
    }
    assert leaders == {0.0: "a", 1e-9: ""}


def test_a_difference_of_just_the_margin_is_enough():
    far = estimate(2 * step(7.0))
    margin = ratio_of(SURE, far) - 1
    (ranking,) = rank_setups([kind(a=runs(SURE), b=runs(SURE), c=runs(far))], options=RankingOptions(margin))
    assert ranking["p50"].letters == {"a": "a", "b": "a", "c": "b"}


def test_without_a_margin_equal_setups_are_undecided():
    (ranking,) = rank_setups([kind(a=runs(SAME), b=runs(SAME))], options=NO_MARGIN)
    assert (ranking["p50"].lead.value, ranking["p50"].lead.verdict) == (1.0, OPEN)


def test_each_setup_brings_its_own_spread():
    calm, wild = estimate(0.0, 0.01), estimate(0.0, 0.3)
    slow_calm, slow_wild = estimate(0.2, 0.01), estimate(0.2, 0.3)
    counts, drifts = set(), set()
    for number, (fast, slow) in enumerate([(calm, slow_wild), (wild, slow_calm)]):
        (ranking,) = rank_setups([kind(number, a=runs(fast), b=runs(slow))])
        counts.add(ranking["p50"].lead.needs)
        first, later = {"starts_ns": (0, 1, 2)}, {"starts_ns": (3, 4, 5)}
        (apart,) = rank_setups([kind(a=runs(fast, **first), b=runs(slow, **later))])
        assert not apart["p50"].is_interleaved
        drifts.add(round(apart["p50"].drift_ratio, 6))
    assert len(counts) == len(drifts) == 1
    assert None not in counts


def test_setups_without_three_runs_or_a_value_are_not_told_apart():
    (ranking,) = rank_setups([kind(a=runs(UNITS_NONE), b=runs(SURE))])
    assert ranking["p50"].leader == ""
    nothing = Estimate(replace(UNITS_NONE.interval, value=None), None)
    (ranking,) = rank_setups([kind(a=runs(nothing), b=runs(nothing))])
    assert (ranking["p50"].leader, ranking["p50"].lead.needs) == ("", None)


def lost(*counts):
    return runs(SAME, received=tuple(~np.isin(np.arange(60), 6 * np.arange(count)) for count in counts))


FEW, MANY = lost(0, 1, 0, 2), lost(4, 9, 5, 7)
"""p = 0.006 by Welch's test."""


@pytest.mark.parametrize(
    ("kinds", "losers"),
    [
        pytest.param([kind(a=FEW, b=FEW, c=FEW, d=MANY)], [{"d"}], id="six pairs"),
        pytest.param([kind(a=FEW, b=FEW, c=MANY), *[kind(a=FEW, b=FEW, c=FEW)] * 2], [set()] * 3, id="nine pairs"),
        pytest.param([kind(a=FEW, b=lost(), c=MANY)], [{"c"}], id="one that sent nothing"),
    ],
)
def test_who_receives_less_is_tested_over_all_pairs(kinds, losers):
    assert [{row.subject for row in rows if row.verdict == PROVEN} for rows in judge_losers(kinds)] == losers
