"""Who is fastest: what is shown about the setups at each size, and the sentences of it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from dds_trace.analyzer.verdicts.answers import CaseAnswer, Clarity
from dds_trace.analyzer.verdicts.judgements import DO_NOT_USE, PROVEN, Claim, Reason
from dds_trace.base.printable import printable
from dds_trace.base.units import counted, format_rate, joined

from .groups import MOST_NAMED, VendorLabels, data_type_label, factor_words, size_span, some_of
from .verdicts import MODES, contender_labels, place_of

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


@dataclass(frozen=True, slots=True)
class Fastest:
    """One kind of message: `lines` are spans of sizes, what is shown there, and whether it differs; `cases` are of `place`."""

    heading: str
    lines: tuple[tuple[str, str, bool], ...]
    place: str
    cases: tuple[CaseAnswer, ...]
    left_out: int = 0

    @property
    def is_decided(self) -> bool:
        return any(is_decided for *_, is_decided in self.lines)


def fastest_setups(answers: Sequence[CaseAnswer], vendors: VendorLabels) -> list[Fastest]:
    labels = contender_labels(answers, vendors)
    several_types = len({answer.data_type for answer in answers}) > 1
    compared = (answer for answer in answers if answer.clarity is not Clarity.ONLY_ONE)
    kinds = []
    for (mode, data_type), by_pair in answers_by_kind(compared):
        words = MODES.get(mode, printable(mode))
        what = f"Fastest {'in the' if mode == 'same' else 'across'} {words}"
        what += f" ({data_type_label(data_type)})" if several_types else ""
        alike = places_alike(by_pair)[: MOST_NAMED if len(by_pair) <= MOST_NAMED else 1]
        for pairs in alike:
            cut = stretches(case for pair in pairs for case in by_pair[pair])
            cut = by_outcome(cut) if len(cut) > MOST_NAMED else cut
            lines = tuple(_line(stretch, cut, labels) for stretch in cut)
            on = "" if len(by_pair) == 1 else f" on {_pairs(pairs, len(by_pair))}"
            left_out = len(by_pair) - sum(map(len, alike)) if pairs is alike[-1] else 0
            kinds.append(Fastest(what + on, lines, pairs[0], tuple(by_pair[pairs[0]]), left_out))
    return sorted(kinds, key=lambda kind: not kind.is_decided)


def winner_sentences(kinds: Sequence[Fastest]) -> tuple[str, ...]:
    sentences: list[str] = []
    for kind in kinds:
        clauses = [f"{span}: {words}" for span, words, _ in kind.lines]
        first = next((index for index, (*_, is_decided) in enumerate(kind.lines) if is_decided), 0)
        parts = [[clauses.pop(first)], clauses] if not sentences else [clauses]
        sentences += [f"{kind.heading} {'; '.join(part)}." for part in parts if part]
        if kind.left_out:
            sentences.append(f"For the others see the table ({counted(kind.left_out, 'pair')} of devices and links).")
    return tuple(sentences)


def _line(stretch: Stretch, cut: Sequence[Stretch], labels: Mapping[str, str]) -> tuple[str, str, bool]:
    sizes = [size for other in cut for size in other.sizes]
    span = "at every size" if {*stretch.sizes} == {*sizes} and len({*sizes}) > 1 else size_span(stretch.sizes, sizes)
    rates = {case.rate_hz for case in stretch.cases}
    if any(other is not stretch and {*other.sizes} & {*stretch.sizes} for other in cut) and len(rates) == 1:
        span += f" and {format_rate(rates.pop())}"
    parts = {name: labels[name].split(", ") for name in stretch.setups}
    shared = [part for part in next(iter(parts.values()))[1:] if all(part in own[1:] for own in parts.values())]
    span += f" with {', '.join(shared)}" if shared else ""
    own_labels = {
        name: ", ".join([own[0], *(part for part in own[1:] if part not in shared)]) for name, own in parts.items()
    }
    return span, fastest_words(stretch, own_labels), stretch.is_decided


def tail_sentence(answers: Sequence[CaseAnswer]) -> str:
    if any(answer.leader_p99 for answer in answers):
        return ""
    is_tested = any(setup.letters_p99 for answer in answers for setup in answer.contenders)
    what = "No difference at p99 can be shown" if is_tested else "Too few messages to judge who is fastest at p99"
    return f"{what}; record longer or more runs."


def _pairs(pairs: Sequence[str], count: int) -> str:
    if len(pairs) == count > 1:
        return f"each of {count} pairs of devices and links"
    return "; ".join(pairs) if len(pairs) <= MOST_NAMED else f"{len(pairs)} of {count} pairs of devices and links"


def _wins(cases: Sequence[CaseAnswer], labels: Mapping[str, str]) -> str:
    won = Counter(name for case in cases if (name := case.leader_p50 or case.leader_p99))
    if not won:
        return "who is slower depends on the rate"
    (first, count), *others = won.most_common()
    lead = f"{labels[first]} is fastest in {count} of {counted(len(cases), 'comparison')}"
    return f"it depends on the rate ({', '.join([lead, *(f'{labels[name]} in {wins}' for name, wins in others)])})"


def by_outcome(cut: Sequence[Stretch]) -> tuple[Stretch, ...]:
    joined_of: dict[tuple[Outcome | None, frozenset[str]], Stretch] = {}
    for stretch in cut:
        key = stretch.outcome, stretch.setups
        joined_of[key] = joined_of[key].with_sizes(stretch) if key in joined_of else stretch
    return tuple(
        sorted(
            joined_of.values(),
            key=lambda stretch: (not stretch.is_decided, stretch.outcome is None, -len(stretch.sizes)),
        )
    )


def fastest_words(stretch: Stretch, labels: Mapping[str, str]) -> str:
    outcome = stretch.outcome
    if outcome is None:
        return _wins(stretch.cases, labels)
    leads = [
        f"{'at p99 ' if percentile == 'p99' else ''}{labels[name]} (the next takes {_takes(stretch, Claim.FASTEST, percentile, name)})"
        for percentile, _ in PERCENTILES
        if (name := getattr(outcome, percentile))
    ]
    if len(leads) == len(PERCENTILES) and outcome.p50 == outcome.p99:
        leads = [f"{leads[0].removesuffix(')')}, at p99 {_takes(stretch, Claim.FASTEST, 'p99', outcome.p99)})"]
    if leads:
        return ("of setups that all lose too much, " if outcome.is_lossy else "") + ", ".join(leads)
    counts = [case.repeats_p50 for case in stretch.cases if case.repeats_p50 is not None]
    repeats = f"about {max(counts)} repeats would decide" if counts else ""
    if not outcome.slower:
        if not outcome.is_interleaved:
            repeats = "the setups were recorded one after the other"
        elif any(row.reason == Reason.DEPENDENT.value for case in stretch.cases for row in case.judgements):
            repeats = Reason.DEPENDENT.value
        return f"no clear winner{f' ({repeats})' if repeats else ''}"
    parts = [
        f"{labels[name]} takes {_takes(stretch, Claim.SLOWER, outcome.percentile, name, outcome.best[0])}"
        for name in outcome.slower
    ]
    shown = some_of(parts, "take longer").split("; ") + ([f"{repeats} the rest"] if repeats else [])
    at_tail = "at p99 " if outcome.percentile == "p99" else ""
    only = "of setups that lose little, " if len(outcome.best) == 1 else ""  # one that loses more is as fast
    return f"{at_tail}{only}{joined([labels[name] for name in outcome.best], 'or')} ({'; '.join(shown)})"


def _takes(stretch: Stretch, claim: Claim, percentile: str, subject: str, base: str | None = None) -> str:
    rows = [
        row
        for case in stretch.cases
        for row in case.of_claim(claim, f"latency_{percentile}")
        if row.verdict == PROVEN and row.subject == subject and base in (None, row.base)
    ]
    factors = [row.value for row in rows if row.value is not None and math.isfinite(row.value)]
    within = (
        f", in {len(rows)} of {counted(len(stretch.cases), 'comparison')}" if len(rows) < len(stretch.cases) else ""
    )
    return f"{factor_words(factors)} as long{within}" if factors else f"longer, as messages were lost{within}"
