"""Ranks the setups of every kind of message by each percentile: who leads, who differs from whom, what decides the rest.

docs/explanation/statistics.md has the tests (R. Berger, Technometrics 24, 1982). All claims need an estimated lead of the margin.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

from ..run_statistics.change import Verdict, change_of_estimates
from ..run_statistics.received import change_of_received
from ..run_statistics.setups import (
    Key,
    RunLogarithms,
    SetupMean,
    overlap_in_time,
    passes_depend,
    setup_means,
    tier_letters,
)
from ..statistics.intervals import MIN_RUNS, Basis
from ..statistics.power import hochberg_adjusted, holm_adjusted, runs_to_decide
from .judgements import OPEN, PROVEN, Claim, Judgement, Reason
from .setup_runs import SetupRuns

TAIL_ONLY = 0.05
"""Part of the significance level for a difference at p99 where the medians do not differ: two verdicts err little more than one."""

PAIR_LEVEL = 0.9
"""Part of the significance level for the only pair of a kind of message: Welch's test errs a little more where spreads are unlike."""


@dataclass(frozen=True, slots=True)
class RankingOptions:
    margin: float = 0.05
    trust_order: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Kind:
    family: Hashable
    setups: Mapping[str, SetupRuns]
    percentiles: tuple[str, ...]
    columns: Mapping[str, Any] = field(default_factory=dict)
    barred: frozenset[str] = frozenset()
    """Setups that may not lead, as they lose too much."""


@dataclass(frozen=True, slots=True)
class SetupPair:
    fast: str
    slow: str
    p_value: float
    ratio: float
    is_interleaved: bool
    means: tuple[SetupMean, SetupMean] | None
    runs: int

    def repeats_to_decide(self, confidence: float) -> int | None:
        """Return the repeats that would probably show the difference; None where the order of recording hides it, or beyond 1000."""
        if self.means is None or not self.is_interleaved:
            return None
        base, new = (math.sqrt(mean.variance * self.runs) for mean in self.means)
        count = runs_to_decide(math.log(self.ratio), base, new, confidence)
        return None if count is None else max(count, self.runs + 1)

    def judged(self, claim: Claim, percentile: str, confidence: float, kind: Kind) -> Judgement:
        subject, base = (self.fast, self.slow) if claim is Claim.FASTEST else (self.slow, self.fast)
        low = high = None
        if self.means is not None:
            test = self.means[0].against(self.means[1])
            reach = test.reach(confidence) * test.error
            low, high = math.exp(test.difference - reach), math.exp(test.difference + reach)
        basis = Basis.WITHIN_RUN if self.means is None else Basis.BETWEEN_RUNS
        measured = self.ratio, low, high, basis.value, self.p_value
        return Judgement(claim, subject, f"latency_{percentile}", base, *measured, group=kind.setups[subject].group)


@dataclass(frozen=True, slots=True)
class Ranking:
    """The setups of one kind of message by one percentile: who leads or why nobody does, and who takes longer than whom."""

    lead: Judgement
    slower: tuple[Judgement, ...]
    letters: Mapping[str, str]
    is_interleaved: bool
    drift_ratio: float | None

    @property
    def leader(self) -> str:
        return self.lead.subject if self.lead.verdict == PROVEN else ""

    def differ(self, first: str, other: str) -> bool:
        return not set(self.letters[first]) & set(self.letters[other])


def rank_setups(
    kinds: Sequence[Kind], confidence: float = 0.95, options: RankingOptions = RankingOptions()
) -> list[dict[str, Ranking]]:
    rankings: list[dict[str, Ranking]] = [{} for _ in kinds]
    names = dict.fromkeys(name for kind in kinds for name in kind.percentiles)
    logarithms = {percentile: _logarithms_by_family(kinds, percentile) for percentile in names}
    dependent = {family for family, runs in logarithms.get("p50", {}).items() if passes_depend(runs)}
    for percentile, families in logarithms.items():
        pairs_of = _pairs(kinds, percentile, families, trust_order=options.trust_order)
        for index, pairs in pairs_of.items():
            if kinds[index].family in dependent:
                pairs_of[index] = [replace(pair, p_value=1.0) for pair in pairs]
        lead_p = hochberg_adjusted(
            [max((pair.p_value for pair in _lead(pairs)), default=1.0) for pairs in pairs_of.values() if pairs]
        )
        pair_p = holm_adjusted([pair.p_value for pairs in pairs_of.values() for pair in pairs])
        leads, tests = iter(lead_p.tolist()), iter(pair_p.tolist())
        for index, pairs in pairs_of.items():
            median = rankings[index].get("p50")
            rankings[index][percentile] = _ranking(
                kinds[index],
                percentile,
                [(pair, next(tests)) for pair in pairs],
                next(leads) if pairs else 1.0,
                median if percentile != "p50" else None,
                confidence,
                1 + options.margin,
                is_dependent=kinds[index].family in dependent,
            )
    return rankings


def _logarithms_by_family(kinds: Sequence[Kind], percentile: str) -> dict[Hashable, dict[Key, RunLogarithms]]:
    families: dict[Hashable, dict[Key, RunLogarithms]] = defaultdict(dict)
    for index, kind in enumerate(kinds):
        if percentile not in kind.percentiles:
            continue
        for name, setup in kind.setups.items():
            logarithms = setup.logarithms(percentile)
            if logarithms is not None:
                families[kind.family][index, name] = logarithms
    return families


def judge_losers(kinds: Sequence[Kind], confidence: float = 0.95) -> list[list[Judgement]]:
    """Judge for each kind of message whether a setup receives less than the one that receives most.

    That one is picked by what it received, so the tests are adjusted by Holm over all pairs of all kinds.
    """
    tests = []
    for index, kind in enumerate(kinds):
        *others, most = sorted(kind.setups, key=lambda name: (kind.setups[name].received_share, name))
        base = kind.setups[most].received
        tests += [
            (index, name, most, change_of_received(base, kind.setups[name].received, confidence)) for name in others
        ]
    p_values = [1.0 if change.p_value is None else change.p_value for *_, change in tests]
    pairs = sum(math.comb(len(kind.setups), 2) for kind in kinds)
    adjusted = holm_adjusted([*p_values, *[1.0] * (pairs - len(tests))])
    judged: list[list[Judgement]] = [[] for _ in kinds]
    for (index, name, most, change), p_adjusted in zip(tests, adjusted.tolist(), strict=False):
        is_worse = change.verdict() is Verdict.WORSE and p_adjusted <= 1 - confidence
        ends = change.difference_low, change.difference_high
        numbers = change.difference, *ends, change.basis.value, change.p_value, p_adjusted
        judged[index].append(
            Judgement(Claim.LOSES_MORE, name, "received_ratio", most, *numbers, PROVEN if is_worse else OPEN)
        )
    return judged


def _lead(pairs: Sequence[SetupPair]) -> list[SetupPair]:
    return [pair for pair in pairs if pair.fast == pairs[0].fast]


def _ranking(
    kind: Kind,
    percentile: str,
    tests: Sequence[tuple[SetupPair, float]],
    lead_p: float,
    median: Ranking | None,
    confidence: float,
    least_ratio: float,
    *,
    is_dependent: bool,
) -> Ranking:
    pairs = [pair for pair, _ in tests]
    lead = _lead(pairs)
    names = [lead[0].fast, *(pair.slow for pair in lead)] if lead else list(kind.setups)

    def level(*, has_median: bool) -> float:
        return (1 - confidence) * (1 if has_median else TAIL_ONLY)

    different = {
        (pair.fast, pair.slow)
        for pair, p in tests
        if pair.ratio >= least_ratio and p <= level(has_median=median is None or median.differ(pair.fast, pair.slow))
    }
    is_tested = lead_p <= level(has_median=median is None or bool(median.leader))
    is_ahead = (
        bool(lead) and names[0] not in kind.barred and is_tested and all(pair.ratio >= least_ratio for pair in lead)
    )
    if is_ahead:
        different |= {(pair.fast, pair.slow) for pair in lead}
    in_sequence = [pair.means[0].against(pair.means[1]) for pair in pairs if pair.means and not pair.is_interleaved]
    letters = tier_letters(names, different)
    first = Judgement(Claim.FASTEST, "", f"latency_{percentile}", group=kind.setups[names[0]].group)
    if lead:
        counts = [
            pair.repeats_to_decide(confidence) if pair.ratio >= least_ratio and not is_dependent else None
            for pair in lead
            if (pair.fast, pair.slow) not in different
        ]
        first = replace(
            min(lead, key=lambda pair: pair.ratio).judged(Claim.FASTEST, percentile, confidence, kind),
            p_adjusted=lead_p,
            verdict=PROVEN if is_ahead else OPEN,
            needs=max(count or 0 for count in counts) if counts and all(counts) else None,
        )
    if not is_ahead:
        reason = _reason(kind, percentile, lead, least_ratio, is_dependent=is_dependent, is_tested=is_tested)
        first = replace(first, reason=reason.value)
    return Ranking(
        lead=first,
        slower=tuple(
            replace(pair.judged(Claim.SLOWER, percentile, confidence, kind), p_adjusted=p_adjusted, verdict=PROVEN)
            for pair, p_adjusted in tests
            if not set(letters[pair.fast]) & set(letters[pair.slow])
        ),
        letters=letters,
        is_interleaved=all(pair.is_interleaved for pair in pairs),
        drift_ratio=min((math.exp(test.reach(confidence) * test.error) for test in in_sequence), default=None),
    )


def _reason(
    kind: Kind, percentile: str, lead: Sequence[SetupPair], least_ratio: float, *, is_dependent: bool, is_tested: bool
) -> Reason:
    if not lead:
        return Reason.ONLY_ONE
    if any(setup.estimates[percentile].units is None for setup in kind.setups.values()):
        return Reason.FEW_RUNS
    if not all(pair.is_interleaved for pair in lead):
        return Reason.IN_SEQUENCE
    if is_dependent:
        return Reason.DEPENDENT
    if not is_tested:
        return Reason.NOT_SHOWN
    is_near = any(pair.ratio < least_ratio for pair in lead)
    return Reason.BELOW_MARGIN if is_near else Reason.LOSSES


def _pairs(
    kinds: Sequence[Kind],
    percentile: str,
    families: Mapping[Hashable, Mapping[Key, RunLogarithms]],
    *,
    trust_order: bool,
) -> dict[int, list[SetupPair]]:
    means = {key: mean for runs in families.values() for key, mean in setup_means(runs).items()}

    def order(item: tuple[str, SetupRuns]) -> tuple[float, str]:
        value = item[1].estimates[percentile].interval.value
        return math.inf if value is None else value, item[0]

    return {
        index: [
            _pair(kind, percentile, names, [means.get((index, name)) for name in names], trust_order=trust_order)
            for names in combinations(dict(sorted(kind.setups.items(), key=order)), 2)
        ]
        for index, kind in enumerate(kinds)
        if percentile in kind.percentiles
    }


def _pair(
    kind: Kind, percentile: str, names: tuple[str, str], means: Sequence[SetupMean | None], *, trust_order: bool
) -> SetupPair:
    fast, slow = (kind.setups[name] for name in names)
    fewest = min(len(fast.starts_ns), len(slow.starts_ns))
    is_interleaved = fewest < MIN_RUNS or overlap_in_time(fast.starts_ns, slow.starts_ns)
    p_value: float | None
    ratio: float | None
    if means[0] is not None and means[1] is not None:
        tested = means[0], means[1]
        test = means[0].against(means[1])
        p_value, ratio = test.p_value, math.exp(test.difference)
    else:
        tested = None
        losses = change_of_received(fast.received, slow.received).p_value
        change = change_of_estimates(
            fast.estimates[percentile], slow.estimates[percentile], p_of_losses=1.0 if losses is None else losses
        )
        p_value, ratio = change.p_value, change.ratio
    units = fast.estimates[percentile].units
    return SetupPair(
        *names,
        p_value=1.0
        if p_value is None or not (is_interleaved or trust_order)
        else min(1.0, p_value / (PAIR_LEVEL if len(kind.setups) == 2 else 1.0)),
        ratio=1.0 if ratio is None else ratio,
        is_interleaved=is_interleaved,
        means=tested,
        runs=0 if units is None else len(units),
    )
