"""Who is fastest: what is shown about the setups at each size, and the sentences of it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from dds_trace.analyzer.verdicts.answers import CaseAnswer, Clarity
from dds_trace.analyzer.verdicts.judgements import DO_NOT_USE, PROVEN, Claim, Judgement, Reason
from dds_trace.base.printable import printable
from dds_trace.base.units import counted, first_of, format_rate, format_size, joined

from .groups import MOST_NAMED, VendorLabels, data_type_label, factor_words, in_domain, size_span, some_of, time_words
from .verdicts import MODES, contender_labels, place_of

PERCENTILES = (("p50", "at the median"), ("p99", "at p99"))

ALIKE = "neighbouring passes are alike"


@dataclass(frozen=True, slots=True)
class Outcome:
    p50: str = ""
    p99: str = ""
    best: tuple[str, ...] = ()
    slower: tuple[str, ...] = ()
    percentile: str = ""
    is_interleaved: bool = True
    is_lossy: bool = False
    pairs: tuple[tuple[str, str], ...] = ()
    """Slower and faster setup, neither with the lowest times."""

    @property
    def is_decided(self) -> bool:
        return bool(self.p50 or self.p99 or self.slower or self.pairs)


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
    for percentile, _ in PERCENTILES:
        if rows := case.of_claim(Claim.SLOWER, f"latency_{percentile}"):
            return Outcome(percentile=percentile, pairs=tuple(sorted((row.subject, row.base) for row in rows)))
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
    return sorted(
        alike.values(),
        key=lambda sites: (not any(stretch.is_decided for stretch in stretches(by_place[sites[0]])), -len(sites)),
    )


def _shown_case(cases: Sequence[CaseAnswer]) -> CaseAnswer:
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
    """One kind of message: `lines` are spans of sizes, what is shown there, and whether it differs; `shown` is of the first that does."""

    heading: str
    lines: tuple[tuple[str, str, bool], ...]
    place: str
    shown: CaseAnswer
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
        what = f"Fastest {in_domain(MODES.get(mode, printable(mode)))}"
        what += f" ({data_type_label(data_type)})" if several_types else ""
        alike = places_alike(by_pair)[: MOST_NAMED if len(by_pair) <= MOST_NAMED else 1]
        for pairs in alike:
            cut = stretches(case for pair in pairs for case in by_pair[pair])
            cut = by_outcome(cut) if len(cut) > MOST_NAMED else cut
            lines = tuple(_line(stretch, cut, labels) for stretch in cut)
            on = "" if len(by_pair) == 1 else f" on {_pairs(pairs, len(by_pair))}"
            left_out = len(by_pair) - sum(map(len, alike)) if pairs is alike[-1] else 0
            first = next((stretch for stretch in cut if stretch.is_decided), cut[0])
            shown = _shown_case([case for case in by_pair[pairs[0]] if case in first.cases])
            kinds.append(Fastest(what + on, lines, pairs[0], shown, left_out))
    return sorted(kinds, key=lambda kind: not kind.is_decided)


def winner_sentences(kinds: Sequence[Fastest]) -> tuple[str, ...]:
    sentences: list[str] = []
    for kind in kinds:
        clauses = [f"{span}: {words}" for span, words, _ in kind.lines]
        first = next((index for index, (*_, is_decided) in enumerate(kind.lines) if is_decided), 0)
        parts = [[clauses.pop(first)], clauses] if not sentences else [clauses]
        sentences += [f"{kind.heading} {'; '.join(part)}." for part in parts if part]
        if kind.left_out:
            sentences.append(f"For the others see the table ({counted(kind.left_out, 'link')}).")
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


def tail_sentence(answers: Sequence[CaseAnswer], labels: Mapping[str, str]) -> str:
    has_named = False
    slower: dict[tuple[str, str], list[CaseAnswer]] = {}
    for answer in answers:
        if answer.leader_p99 or outcome_of(answer).percentile == "p99":
            has_named = True
            continue
        for row in answer.of_claim(Claim.SLOWER, "latency_p99"):
            slower.setdefault((row.subject, row.base), []).append(answer)
    parts = []
    for pair, cases in slower.items():
        sizes = sorted({case.payload_bytes for case in cases})
        measured = sorted({answer.payload_bytes for answer in answers if answer.data_type == cases[0].data_type})
        words = _takes_longer(Stretch(None, tuple(sizes), tuple(cases)), "p99", pair, labels)
        parts.append(f"{words} {size_span(sizes, measured)}")
    if parts:
        return f"At p99, where no setup is proven to be the fastest, {some_of(parts, 'more pairs of setups', 'more pair of setups')}."
    if has_named:
        return ""
    is_tested = any(setup.letters_p99 for answer in answers for setup in answer.contenders)
    what = "No difference between setups at p99 is proven" if is_tested else "Too few messages to compare setups at p99"
    return f"{what}; {_decides(answers, 'p99') or 'record longer or more runs'}."


def lowest_sentence(judged: Sequence[tuple[Judgement, CaseAnswer]], labels: Mapping[str, str]) -> str:
    ordered = sorted(judged, key=lambda pair: (pair[0].needs or math.inf, -(pair[0].value or 1.0)))
    cases = [case for _, case in ordered]
    parts = []
    for row, case in ordered:
        decides = f", and {repeats_words([row.needs])}" if row.needs else ""
        who, times = _lowest([case], labels)
        if who:
            parts.append(f"{_where(case, cases)} {who} ({times}){decides}")
    shown = "; ".join(first_of(parts, MOST_NAMED + (len(parts) == MOST_NAMED + 1), "more in the table"))
    return f"{shown[:1].upper()}{shown[1:]}." if parts else ""


def _where(case: CaseAnswer, cases: Sequence[CaseAnswer]) -> str:
    words = [f"at {format_size(case.payload_bytes)}"]
    if len({other.data_type for other in cases}) > 1:
        words[0] = f"{words[0]} ({data_type_label(case.data_type)})"
    if len({other.rate_hz for other in cases}) > 1:
        words.append(f"and {format_rate(case.rate_hz)}")
    if len({other.domain_mode for other in cases}) > 1:
        words.append(in_domain(MODES.get(case.domain_mode, printable(case.domain_mode))))
    if len({place_of(other) for other in cases}) > 1:
        words.append(f"on {place_of(case)}")
    return " ".join(words)


def repeats_words(counts: Iterable[int | None]) -> str:
    counted_repeats = [count for count in counts if count is not None]
    return f"about {max(counted_repeats)} repeats would decide" if counted_repeats else ""


def _decides(cases: Sequence[CaseAnswer], percentile: str, tail: str = "") -> str:
    rows = [row for case in cases for row in case.of_claim(Claim.FASTEST, f"latency_{percentile}")]
    open_rows = [row for row in rows if row.verdict != PROVEN and row.value is not None]
    needs = [row.needs for row in open_rows if row.needs is not None]
    if not needs:
        is_near = any(row.reason == Reason.BELOW_MARGIN.value for row in open_rows)
        return "the measured lead is below the margin" if is_near else ""
    is_part = len(needs) < len(open_rows)
    return repeats_words(needs) + (f" {len(needs)} of {len(open_rows)} comparisons" if is_part else tail)


def _lowest(cases: Sequence[CaseAnswer], labels: Mapping[str, str]) -> tuple[str, str]:
    times = [
        sorted((setup.p50_ns, setup.name) for setup in case.contenders if setup.p50_ns is not None) for case in cases
    ]
    firsts = [lowest for ordered in times for lowest in ordered[:1]]
    seconds = [ns for ordered in times for ns, _ in ordered[1:2]]
    names = Counter(name for _, name in firsts)
    if not names:
        return "", ""
    if len(names) > 1:
        counts = [f"{labels[name]} in {count}" for name, count in names.most_common(MOST_NAMED)]
        return f"the lowest median is of {joined(counts)} of {counted(len(cases), 'comparison')}", ""
    (name,) = names
    following = f"; next {_ends(seconds)}" if seconds else ""
    return f"{labels[name]} is lowest", f"{_ends([ns for ns, _ in firsts])}{following}"


def _ends(times_ns: Sequence[float]) -> str:
    return " to ".join(dict.fromkeys(map(time_words, (min(times_ns), max(times_ns)))))


def _pairs(pairs: Sequence[str], count: int) -> str:
    if len(pairs) == count > 1:
        return f"each of {count} links"
    return "; ".join(pairs) if len(pairs) <= MOST_NAMED else f"{len(pairs)} of {count} links"


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
    decides = _decides(stretch.cases, "p50")
    if not outcome.slower:
        if outcome.pairs:
            tail = "at p99 " if outcome.percentile == "p99" else ""
            pairs = [_takes_longer(stretch, outcome.percentile, pair, labels) for pair in outcome.pairs]
            return f"no proven winner, but {tail}{some_of(pairs, 'more')}{f' ({decides})' if decides else ''}"
        if not outcome.is_interleaved:
            decides = "the setups were recorded one after the other"
        elif any(row.reason == Reason.DEPENDENT.value for case in stretch.cases for row in case.judgements):
            decides = ALIKE
        if not any(setup.p50_ns is not None for case in stretch.cases for setup in case.contenders):
            return "no proven winner (no reply has a relay's time stamps, so the latency is unknown)"
        notes = "; ".join(filter(None, (", ".join(filter(None, _lowest(stretch.cases, labels))), decides)))
        return f"no proven winner{f' ({notes})' if notes else ''}"
    parts = [
        f"{labels[name]} takes {_takes(stretch, Claim.SLOWER, outcome.percentile, name, outcome.best[0])}"
        for name in outcome.slower
    ]
    decides = _decides(stretch.cases, "p50", " the rest")
    unclear = [labels[name] for name in outcome.best[1:] if _is_above_a_slower(stretch, outcome, name)]
    if unclear:
        parts.append(f"{joined(unclear)} {'are' if len(unclear) > 1 else 'is'} undecided")
    shown = [*some_of(parts, "take longer").split("; "), *filter(None, [decides])]
    at_tail = "at p99 " if outcome.percentile == "p99" else ""
    only = "of setups that lose little, " if len(outcome.best) == 1 else ""  # one that loses more is as fast
    best = [labels[name] for name in outcome.best if labels[name] not in unclear]
    return f"{at_tail}{only}{joined(best, 'or')} ({'; '.join(shown)})"


def _is_above_a_slower(stretch: Stretch, outcome: Outcome, subject: str) -> bool:
    """Return whether a setup that no test excludes has a longer time somewhere than one that a test does."""
    for case in stretch.cases:
        values = {setup.name: getattr(setup, f"{outcome.percentile}_ns") for setup in case.contenders}
        times = {name: math.inf if value is None else value for name, value in values.items()}
        if times[subject] > min(times[name] for name in outcome.slower):
            return True
    return False


def _takes(
    stretch: Stretch, claim: Claim, percentile: str, subject: str, base: str | None = None, than: str = ""
) -> str:
    rows = [
        row
        for case in stretch.cases
        for row in case.of_claim(claim, f"latency_{percentile}")
        if row.verdict == PROVEN and row.subject == subject and base in (None, row.base)
    ]
    factors = [row.value for row in rows if row.value is not None and math.isfinite(row.value)]
    is_part = len(rows) < len(stretch.cases)
    within = f", in {len(rows)} of {counted(len(stretch.cases), 'comparison')}" if is_part else ""
    if not factors:
        return f"longer{f' than {than}' if than else ''}, as messages were lost{within}"
    return f"{factor_words(factors)} as long{f' as {than}' if than else ''}{within}"


def _takes_longer(stretch: Stretch, percentile: str, pair: tuple[str, str], labels: Mapping[str, str]) -> str:
    slow, fast = pair
    return f"{labels[slow]} takes {_takes(stretch, Claim.SLOWER, percentile, slow, fast, labels[fast])}"
