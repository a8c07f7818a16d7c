"""The first sentences of a report; each rests on verdicts within one device pair and link."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import median

import polars as pl

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.model.names import device_pair
from dds_trace.analyzer.model.setting import condition_of, parse_setting
from dds_trace.analyzer.verdicts.answers import CaseAnswer, Clarity
from dds_trace.analyzer.verdicts.judgements import DO_NOT_USE, PROVEN, Claim, Judgement, Reason
from dds_trace.base.printable import printable
from dds_trace.base.units import counted, format_duration, format_number, format_rate, format_size
from dds_trace.tracefile.format.json_fields import object_of

from .groups import (
    Group,
    Groups,
    VendorLabels,
    data_type_label,
    domain_label,
    format_count,
    format_ratio,
    group_labels,
    joined,
    way_words,
)
from .numbers import Values
from .outcomes import PERCENTILES, Outcome, Stretch, answers_by_kind, places_alike, stretches
from .verdicts import MODES, conditions_label, contender_labels, place_of, setup_labels

BUSY_SHARE = 0.25
"""Share of recordings with a full processor from which on a report warns."""

FORGED, DOUBTFUL = "forged_or_foreign", "doubtful_replies"
MOST_NAMED = 3


def forged_sentence(analysis: Analysis, groups: Groups) -> str:
    labels = group_labels(groups)
    sentences = []
    for code, words in (FORGED, "Do not use, as somebody else may have answered"), (DOUBTFUL, "Doubtful"):
        whats = {
            group: finding.what for finding in analysis.findings if finding.code == code for group in finding.groups
        }
        parts = [f"{labels[group]} ({what.rstrip('.')})" for group, what in whats.items()]
        sentences += [f"{words}: {_some(parts, 'more in the findings')}."] * bool(parts)
    return " ".join(sentences)


def recovery_sentences(analysis: Analysis, groups: Groups) -> list[str]:
    series = {group.index: groups.series_of(group) for group in groups.groups}
    labels = setup_labels({group: asdict(member) for group, member in series.items()}, groups.vendors)
    outages: dict[tuple[str, float, str], dict[str, list[float | None]]] = {}
    for group, by, never, back_ns in analysis.details.recoveries.select("group", "by", "never", "back_ns").iter_rows():
        if group in series:
            planned = parse_setting(series[group].setting).get("outage", "")
            length_s = float(planned.removesuffix("s")) if planned[:1].isdigit() else 0.0
            outage = _OUTAGES.get(by, by), length_s, planned
            outages.setdefault(outage, {}).setdefault(labels[group], []).append(None if never else back_ns)
    return [
        printable(
            f"Back after {planned or 'an outage'} {by}: {joined(_came_back(*setup) for setup in setups.items())}."
        )
        for (by, _, planned), setups in sorted(outages.items())
    ]


_OUTAGES = {
    "link": "with the link down",
    "address": "with the link down and another address",
    "loss": "with all packets lost",
    "relay": "without the relay",
}


def _came_back(name: str, times_ns: Sequence[float | None]) -> str:
    back_ns = sorted(time_ns for time_ns in times_ns if time_ns is not None)
    runs, never = counted(len(times_ns), "run"), len(times_ns) - len(back_ns)
    if not back_ns:
        return f"{name} never ({runs})"
    least, middle, most = (
        format_duration(ns) if ns else "at once" for ns in (back_ns[0], median(back_ns), back_ns[-1])
    )
    ends = f"{least} to {most}, " if least != most else ""
    return (
        f"{name} {'' if middle == 'at once' else 'in '}{middle} ({ends}{runs}{f', never in {never}' if never else ''})"
    )


def interference_sentences(judged: pl.DataFrame, groups: Groups) -> list[str]:
    vendors = {group.index: groups.series_of(group).vendor_label for group in groups.groups}
    cases: dict[str, dict[tuple[str, str], list[float]]] = {}
    for row in judged.filter(pl.col("group").is_in(list(vendors)), claim=Claim.WITH.value).iter_rows(named=True):
        who = f"The flow {row['base']}" if row["base"] else "A message"
        factors = cases.setdefault(f"{who} with {row['subject']}", {})
        if row["verdict"] == PROVEN and row["value"] is not None and math.isfinite(row["value"]):
            factors.setdefault((vendors[row["group"]], row["statistic"]), []).append(row["value"])
    return [
        printable(f"{case} takes {'; '.join(_as_long(*factor) for factor in factors.items()) or _NOT_LONGER}.")
        for case, factors in cases.items()
    ]


_NOT_LONGER = "as long as without, as far as can be shown"


def _as_long(vendor_statistic: tuple[str, str], factors: Sequence[float]) -> str:
    vendor, statistic = vendor_statistic
    return f"{factor_words(factors)} as long {dict(PERCENTILES)[statistic.removeprefix('latency_')]} ({vendor})"


def loss_sentence(groups: Groups, values: Values) -> str:
    planned, lost = _planned_and_lost(groups.groups, values)
    if not lost:
        return ""
    lossy = [group for group in groups.groups if _planned_and_lost([group], values)[1]]
    scope, unsent = _scope(lossy, groups), sum(round(values.plain["unsent"][group.index] or 0) for group in lossy)
    where = f", all of them {scope}" if scope else ""
    never = f", {format_count(unsent)} of them never sent" if unsent else ""
    return f"{format_ratio(lost / planned)} of the messages were lost ({format_count(lost)} of {format_count(planned)}{never}){where}."


def _planned_and_lost(groups: Sequence[Group], values: Values) -> tuple[int, int]:
    planned = sum(group.published + round(values.plain["unsent"][group.index] or 0) for group in groups)
    return planned, planned - sum(group.received for group in groups)


def _scope(lossy: Sequence[Group], groups: Groups) -> str:
    sides: tuple[tuple[Callable[[Group], str], str], ...] = (
        (lambda group: groups.series_of(group).vendor_label, "by {}"),
        (lambda group: domain_label(groups.series_of(group)), "{}"),
        (lambda group: printable(groups.series_of(group).connectivity), "over {}"),
    )
    ways, messages = ({part(group) for group in lossy} for part in (sides[1][0], lambda group: group.cell))
    same = [group for group in groups.groups if group.cell in messages]
    vendors = {groups.series_of(group).vendor_label for group in same if sides[1][0](group) in ways}
    parts = []
    for value_of, words in sides if len(vendors) > 1 else sides[1:]:
        values, all_values = ({value_of(group) for group in side} for side in (lossy, same))
        if values != all_values and len(values) <= MOST_NAMED:
            parts.append(words.format(joined(sorted(values), "or").replace(" or through ", " or ")))
    cells = [groups.cell_of(group) for group in lossy]
    if len({cell.data_type for cell in cells}) == 1:
        sizes = sorted({cell.payload_bytes for cell in cells})
        measured = sorted({cell.payload_bytes for cell in groups.cells if cell.data_type == cells[0].data_type})
        span = size_span(sizes, measured)
        if sizes != measured:
            parts.append(f"at {len(sizes)} of {len(measured)} sizes" if span.count(",") >= MOST_NAMED else span)
    return ", ".join(parts)


def avoid_sentence(answers: Sequence[CaseAnswer], vendors: VendorLabels, cures: Mapping[int, str]) -> str:
    lossy = [(row, where) for row, where in _advised(answers, vendors) if row.group not in cures]
    worst = {row.subject: (row, where) for row, where in reversed(lossy)}.values() if len(lossy) > MOST_NAMED else lossy
    shown = sorted(worst, key=lossy.index)[:MOST_NAMED]
    more = [f"and {len(lossy) - len(shown)} more in the table"] if len(lossy) > len(shown) else []
    words = "; ".join([*(_lost_words(row, where) for row, where in shown), *more])
    return f"Do not use, because of losses: {words}." if lossy else ""


def cure_sentence(answers: Sequence[CaseAnswer], vendors: VendorLabels, cures: Mapping[int, str]) -> str:
    by_cure: dict[str, list[str]] = {}
    for row, where in _advised(answers, vendors):
        if row.group is not None and row.group in cures:
            by_cure.setdefault(cures[row.group], []).append(_lost_words(row, where))
    more = f"; and {len(by_cure) - 1} more in the findings" if len(by_cure) > 1 else ""
    parts = [f"{_some(setups, 'more')}: {printable(cure)}" for cure, setups in by_cure.items()]
    return f"Losses with a known cure: {parts[0]}{more}." if parts else ""


def few_lost_sentence(answers: Sequence[CaseAnswer], vendors: VendorLabels) -> str:
    few = [
        f"{where} ({format_count(row.lost or 0)} of {format_count(row.messages or 0)})"
        for row, where in _lossy(answers, vendors)
        if row.reason == Reason.FEW_LOST.value
    ]
    return f"Too few losses or runs to judge: {_some(few, 'more in the table')}." if few else ""


def _lost_words(row: Judgement, where: str) -> str:
    return f"{where} ({format_ratio(row.value)} lost)"


def _advised(answers: Sequence[CaseAnswer], vendors: VendorLabels) -> list[tuple[Judgement, str]]:
    return [(row, where) for row, where in _lossy(answers, vendors) if row.verdict == DO_NOT_USE]


def _lossy(answers: Sequence[CaseAnswer], vendors: VendorLabels) -> list[tuple[Judgement, str]]:
    """Name setup, message, rate and link; not what all results share, nor the domains, as a setup across them names its bridge."""
    labels = contender_labels(answers, vendors)
    types, places = {answer.data_type for answer in answers}, {place_of(answer) for answer in answers}
    has_devices = len({(answer.ping_device, answer.relay_device) for answer in answers}) > 1
    lossy = []
    for answer in answers:
        devices = "" if has_devices else f"{device_pair(answer.ping_device, answer.relay_device)}, "
        kind = f"{data_type_label(answer.data_type)} " if len(types) > 1 else ""
        place = f", {place_of(answer).removeprefix(devices)}" if len(places) > 1 else ""
        where = f"{kind}{format_size(answer.payload_bytes)} at {format_rate(answer.rate_hz)}{place}"
        lossy += [(row, f"{labels[row.subject]} with {where}") for row in answer.of_claim(Claim.LOSSY)]
    return sorted(lossy, key=lambda one: -(one[0].value or 0.0))


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


def size_span(sizes: Sequence[int], all_sizes: Sequence[int]) -> str:
    if len(sizes) < sum(sizes[0] <= size <= sizes[-1] for size in all_sizes):
        return f"at {joined(map(format_size, sizes))}"
    low, high = format_size(sizes[0]), format_size(sizes[-1])
    if low == high:
        return f"at {low}"
    first, last = sizes[0] == min(all_sizes), sizes[-1] == max(all_sizes)
    if first and last:
        return f"at every size ({low} to {high})"
    return f"from {low} on" if last else f"up to {high}" if first else f"from {low} to {high}"


def factor_words(factors: Sequence[float]) -> str:
    low, high = (format_number(end) for end in (min(factors), max(factors)))
    if high == "1":
        return "less than 1.01 times"
    return f"{high if low == high else f'up to {high}' if low == '1' else f'{low} to {high}'} times"


def bridge_sentence(costs: pl.DataFrame, vendors: VendorLabels) -> str:
    facts = bridge_facts(costs, vendors)
    return f"{COMPARED}: {'; '.join(facts)}." if facts else ""


COMPARED = "A message takes, compared with the same domain"


def bridge_facts(costs: pl.DataFrame, vendors: VendorLabels) -> tuple[str, ...]:
    latencies = costs.filter(metric="latency")
    several = latencies["vendor"].n_unique() > 1
    ways = latencies.group_by("bridge", "vendor", "relay_vendor", maintain_order=True)
    parts = []
    for (bridge, vendor, relay_vendor), rows in ways:
        factors = _cost_words(rows)
        if factors:
            pair = vendors.of_pair(str(vendor), None if relay_vendor is None else str(relay_vendor))
            parts.append(f"{way_words(str(bridge))}{f' with {pair}' if several else ''} {factors}")
    return tuple(parts)


def _cost_words(rows: pl.DataFrame) -> str:
    is_finite = pl.col("ratio").is_finite().fill_null(value=False)
    parts, lost, others, compared = [], 0, 0, 0
    for name, label in (("p50", "at the median"), ("p99", "at p99")):
        costs = rows.filter(statistic=name)
        slower = costs.filter((pl.col("verdict") == "worse") & is_finite)
        if not slower.is_empty():
            parts.append(f"{factor_words(slower['ratio'].to_list())} as long {label}")
            lost = max(lost, costs.filter(~is_finite).height)
            others = max(others, costs.filter((pl.col("verdict") != "worse") & is_finite).height)
            compared = max(compared, costs.height)
    counts = ((lost, "lost"), (others, "not clearly slower"))
    noted = [f"{words} in {count}" for count, words in counts if count]
    return ", ".join(parts) + (f" ({', '.join(noted)} of {counted(compared, 'comparison')})" if noted else "")


def where_sentence(analysis: Analysis, groups: Groups, values: Values) -> str:
    links: dict[str, dict[str, None]] = {}
    for series in groups.series:
        pair = device_pair(series.ping_device, series.relay_device)
        if series.relay_device == series.ping_device:
            pair = f"one machine ({pair})"
        conditions = conditions_label(condition_of(series.setting))
        link = printable(series.connectivity) + (f" with {conditions}" if conditions else "")
        links.setdefault(pair, {})[link] = None
    pairs_of: dict[tuple[str, ...], list[str]] = {}
    for pair, link_names in links.items():
        pairs_of.setdefault(tuple(link_names), []).append(pair)
    parts = [
        f"{joined(pairs)}, {'each ' if len(pairs) > 1 and len(own_links) > 1 else ''}{joined(own_links)}"
        for own_links, pairs in pairs_of.items()
    ]
    counts = sorted({round(count) for count in values.plain["runs"] if count})
    fewest = f"{counts[0]} to " if len(counts) > 1 else ""
    runs = f"; {fewest}{counted(counts[-1], 'run')} of each" if counts else ""
    middlewares = [object_of(session.host.get("middleware")) for session in analysis.sessions]
    executors = sorted({str(setting["executor"]) for setting in middlewares if "executor" in setting})
    ros = f"; ROS 2 with the {printable(joined(executors))} executor" if executors else ""
    return f"Measured on {_some(parts, 'more pairs of devices')}{runs}{ros}.{limits_words(analysis)}"


def limits_words(analysis: Analysis) -> str:
    counts = Counter(code for finding in analysis.findings for code in [finding.code] * finding.count)
    full, recordings = counts["cpu_saturated"], len(analysis.sessions)
    words = ""
    if full and full >= BUSY_SHARE * recordings:
        words = f" The machine was busy in {full} of {counted(recordings, 'recording')}: these times include waiting for a processor."
    if sent := counts["client_bound"]:
        words += f" The throughput of {counted(sent, 'result')} is the sending program's, not the middleware's."
    return words


def _some(parts: Sequence[str], noun: str) -> str:
    more = len(parts) - MOST_NAMED
    return "; ".join([*parts[:MOST_NAMED], *([f"and {more} {noun}"] if more > 0 else [])])


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
    shown = _some(parts, "take longer").split("; ") + ([f"{repeats} the rest"] if repeats else [])
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
