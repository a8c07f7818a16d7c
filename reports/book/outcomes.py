"""What is shown about the setups at each size: who leads, or who is slower than whom."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from dds_trace.analyzer.verdicts.answers import CaseAnswer, Clarity
from dds_trace.analyzer.verdicts.judgements import DO_NOT_USE, Claim

from .verdicts import place_of

PERCENTILES = (("p50", "at the median"), ("p99", "at p99"))


@dataclass(frozen=True, slots=True)
class Outcome:
    p50: str = ""
    p99: str = ""
    best: tuple[str, ...] = ()
    slower: tuple[str, ...] = ()
    percentile: str = ""
    is_interleaved: bool = True
    is_lossy: bool = False

    @property
    def is_decided(self) -> bool:
        return bool(self.p50 or self.p99 or self.slower)


@dataclass(frozen=True, slots=True)
class Stretch:
    """Neighbouring sizes with the same setups and outcome, None where it depends on the rate."""

    outcome: Outcome | None
    sizes: tuple[int, ...]
    cases: tuple[CaseAnswer, ...]

    @property
    def setups(self) -> frozenset[str]:
        return _setups(self.cases[0])

    @property
    def is_decided(self) -> bool:
        return self.outcome is None or self.outcome.is_decided

    def with_sizes(self, other: Stretch) -> Stretch:
        return Stretch(self.outcome, (*self.sizes, *other.sizes), (*self.cases, *other.cases))


def _setups(case: CaseAnswer) -> frozenset[str]:
    return frozenset(setup.name for setup in case.contenders)


def outcome_of(case: CaseAnswer) -> Outcome:
    if case.leader_p50 or case.leader_p99:
        leaders = {case.leader_p50, case.leader_p99}
        is_lossy = any(row.subject in leaders and row.verdict == DO_NOT_USE for row in case.of_claim(Claim.LOSSY))
        return Outcome(case.leader_p50, case.leader_p99, is_lossy=is_lossy)
    usable = [contender for contender in case.contenders if contender.is_usable]
    for percentile, _ in PERCENTILES:
        ranked = sorted(
            (value, setup.name)
            for setup in usable or case.contenders
            if (value := getattr(setup, f"{percentile}_ns")) is not None
        )
        names = [name for _, name in ranked]
        rows = case.of_claim(Claim.SLOWER, f"latency_{percentile}")
        slower = sorted(row.subject for row in rows if row.base == names[0] and row.subject in names)
        if slower:
            first, *alike = (name for name in names if name not in slower)
            return Outcome(best=(first, *sorted(alike)), slower=tuple(slower), percentile=percentile)
    return Outcome(is_interleaved=case.interleaved)


def stretches(cases: Iterable[CaseAnswer]) -> tuple[Stretch, ...]:
    by_size: dict[tuple[int, frozenset[str]], list[CaseAnswer]] = {}
    for case in cases:
        if case.clarity is not Clarity.ONLY_ONE:
            by_size.setdefault((case.payload_bytes, _setups(case)), []).append(case)
    cut: list[Stretch] = []
    for (size, setups), same_size in sorted(by_size.items(), key=lambda item: item[0][0]):
        added = Stretch(_common_outcome(same_size), (size,), tuple(same_size))
        joins = cut and (cut[-1].outcome, cut[-1].setups) == (added.outcome, setups)
        cut.append(cut.pop().with_sizes(added) if joins else added)
    return tuple(cut)


def answers_by_kind(answers: Iterable[CaseAnswer]) -> list[tuple[tuple[str, str], dict[str, list[CaseAnswer]]]]:
    kinds: dict[tuple[str, str], dict[str, list[CaseAnswer]]] = {}
    for answer in answers:
        kinds.setdefault((answer.domain_mode, answer.data_type), {}).setdefault(place_of(answer), []).append(answer)
    return sorted(kinds.items(), key=lambda item: item[0][0] != "same")


def places_alike(by_place: Mapping[str, Sequence[CaseAnswer]]) -> list[list[str]]:
    alike: dict[object, list[str]] = {}
    for site, cases in by_place.items():
        cut = tuple((stretch.outcome, stretch.sizes, stretch.setups) for stretch in stretches(cases))
        alike.setdefault(cut, []).append(site)
    return sorted(alike.values(), key=lambda sites: -len(sites))


def shown_case(cases: Sequence[CaseAnswer]) -> CaseAnswer:
    usable = [case for case in cases if outcome_of(case).is_decided] or cases
    largest = max(case.payload_bytes for case in usable)
    by_rate = sorted((case for case in usable if case.payload_bytes == largest), key=lambda case: case.rate_hz)
    return by_rate[(len(by_rate) - 1) // 2]


def _common_outcome(cases: Sequence[CaseAnswer]) -> Outcome | None:
    medians, tails = ({case.leader_p50 for case in cases} - {""}, {case.leader_p99 for case in cases} - {""})
    if len(medians) > 1 or len(tails) > 1:
        return None
    if medians or tails:
        is_lossy = any(outcome_of(case).is_lossy for case in cases)
        return Outcome(next(iter(medians), ""), next(iter(tails), ""), is_lossy=is_lossy)
    outcomes = list(dict.fromkeys(map(outcome_of, cases)))
    decided = [outcome for outcome in outcomes if outcome.is_decided]
    if len(decided) > 1:
        return None
    return decided[0] if decided else min(outcomes, key=lambda outcome: outcome.is_interleaved)
