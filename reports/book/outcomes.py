"""What is shown about the setups at each size: who leads, or who is slower than whom."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from dds_trace.analyzer.verdicts.answers import CaseAnswer, Clarity
from dds_trace.analyzer.verdicts.judgements import DO_NOT_USE, Claim, exceeds_lossy_share

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
    """Neighbouring sizes with the same outcome, which is None where it depends on the rate."""

    outcome: Outcome | None
    sizes: tuple[int, ...]
    cases: tuple[CaseAnswer, ...]


def outcome_of(case: CaseAnswer) -> Outcome:
    if case.leader_p50 or case.leader_p99:
        leaders = {case.leader_p50, case.leader_p99}
        is_lossy = any(row.subject in leaders and row.verdict == DO_NOT_USE for row in case.of_claim(Claim.LOSSY))
        return Outcome(case.leader_p50, case.leader_p99, is_lossy=is_lossy)
    usable = [
        contender for contender in case.contenders if not (contender.loses_more or exceeds_lossy_share(contender.lost))
    ]
    for percentile, _ in PERCENTILES:
        ranked = sorted(
            (value, setup.name, set(getattr(setup, f"letters_{percentile}")))
            for setup in usable or case.contenders
            if (value := getattr(setup, f"{percentile}_ns")) is not None
        )
        slower = [name for _, name, letters in ranked if not letters & ranked[0][2]]
        if slower and ranked[0][2]:
            first, *slower_ones = (name for _, name, _ in ranked if name not in slower)
            return Outcome(best=(first, *sorted(slower_ones)), slower=tuple(sorted(slower)), percentile=percentile)
    return Outcome(is_interleaved=case.interleaved)


def stretches(cases: Iterable[CaseAnswer]) -> tuple[Stretch, ...]:
    by_size: dict[int, list[CaseAnswer]] = {}
    for case in cases:
        if case.clarity is not Clarity.ONLY_ONE:
            by_size.setdefault(case.payload_bytes, []).append(case)
    cut: list[Stretch] = []
    for size, cases_of_size in sorted(by_size.items()):
        outcome = _common_outcome(cases_of_size)
        before = cut.pop() if cut and cut[-1].outcome == outcome else Stretch(outcome, (), ())
        cut.append(Stretch(outcome, (*before.sizes, size), (*before.cases, *cases_of_size)))
    return tuple(cut)


def answers_by_kind(answers: Iterable[CaseAnswer]) -> list[tuple[tuple[str, str], dict[str, list[CaseAnswer]]]]:
    kinds: dict[tuple[str, str], dict[str, list[CaseAnswer]]] = {}
    for answer in answers:
        kinds.setdefault((answer.domain_mode, answer.data_type), {}).setdefault(place_of(answer), []).append(answer)
    return sorted(kinds.items(), key=lambda item: item[0][0] != "same")


def places_alike(by_place: Mapping[str, Sequence[CaseAnswer]]) -> list[list[str]]:
    alike: dict[object, list[str]] = {}
    for site, cases in by_place.items():
        alike.setdefault(tuple((stretch.outcome, stretch.sizes) for stretch in stretches(cases)), []).append(site)
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
    return decided[0] if len(decided) == 1 else min(outcomes, key=lambda one: one.is_interleaved)
