"""The first sentences of a report; each rests on verdicts within one device pair and link, and none on a mean over several."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from statistics import median

import polars as pl

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.model.setting import condition_of
from dds_trace.analyzer.verdicts.answers import CaseAnswer, Clarity
from dds_trace.analyzer.verdicts.judgements import DO_NOT_USE, Claim, Judgement, Reason
from dds_trace.base.printable import printable
from dds_trace.base.units import counted, format_duration, format_number, format_rate, format_size

from .groups import (
    Group,
    Groups,
    VendorLabels,
    data_type_label,
    device_pair,
    domain_label,
    format_count,
    format_ratio,
    joined,
    way_words,
)
from .numbers import Values
from .outcomes import PERCENTILES, Outcome, Stretch, answers_by_kind, outcome_of, places_alike, stretches
from .verdicts import MODES, conditions_label, contender_labels, place_of

BUSY_SHARE = 0.25
"""Share of recordings with a full processor from which on a report warns."""

MOST_NAMED = 3


def recovery_sentence(analysis: Analysis, groups: Groups) -> str:
    """Return how long each setup took to come back from outages that the sweep made: median and range of its runs."""
    times_ns: dict[str, list[float | None]] = {}
    own = {group.index: groups.series_of(group) for group in groups.groups}
    rows = analysis.details.recoveries.select("group", "by", "outage_ns", "never", "back_ns")
    for group, by, outage_ns, never, back_ns in rows.iter_rows():
        if group in own:
            setup = f"{own[group].vendor_label}, {domain_label(own[group])}, {printable(by)} {outage_ns / 1e9:.1f} s"
            times_ns.setdefault(setup, []).append(None if never else back_ns)
    return (
        f"After an outage, replies came back: {_some([*map(_came_back, times_ns.items())], 'more')}."
        if times_ns
        else ""
    )


def _came_back(setup: tuple[str, Sequence[float | None]]) -> str:
    name, times_ns = setup
    back_ns = sorted(time_ns for time_ns in times_ns if time_ns is not None)
    never = len(times_ns) - len(back_ns)
    words = [f"never in {never} of {counted(len(times_ns), 'run')}"] * bool(never)
    if back_ns:
        least, most = format_duration(back_ns[0]), format_duration(back_ns[-1])
        words.insert(
            0, f"after {format_duration(median(back_ns))} ({least} to {most} in {counted(len(back_ns), 'run')})"
        )
    return f"{name}: {', '.join(words)}"


def loss_sentence(groups: Groups, values: Values) -> str:
    planned, lost = _planned_and_lost(groups.groups, values)
    if not lost:
        return ""
    scope = _scope([group for group in groups.groups if _planned_and_lost([group], values)[1]], groups)
    where = f", all of them {scope}" if scope else ""
    return f"{format_ratio(lost / planned)} of the messages were lost ({format_count(lost)} of {format_count(planned)}){where}."


def _planned_and_lost(groups: Sequence[Group], values: Values) -> tuple[int, int]:
    planned = sum(group.published + round(values.plain["unsent"][group.index] or 0) for group in groups)
    return planned, planned - sum(group.received for group in groups)


def _scope(lossy: Sequence[Group], groups: Groups) -> str:
    sides: tuple[tuple[Callable[[Group], str], str], ...] = (
        (lambda group: groups.series_of(group).vendor_label, "by {}"),
        (lambda group: domain_label(groups.series_of(group)), "{}"),
        (lambda group: printable(groups.series_of(group).connectivity), "over {}"),
    )
    ways = {domain_label(groups.series_of(group)) for group in lossy}
    vendors = {series.vendor_label for series in groups.series if domain_label(series) in ways}
    parts = []
    for value_of, words in sides if len(vendors) > 1 else sides[1:]:
        values, all_values = ({value_of(group) for group in side} for side in (lossy, groups.groups))
        if values != all_values and len(values) <= MOST_NAMED:
            parts.append(words.format(joined(sorted(values), "or").replace(" or through ", " or ")))
    cells = [groups.cell_of(group) for group in lossy]
    if len({cell.data_type for cell in cells}) == 1:
        least = min(cell.payload_bytes for cell in cells)
        measured = [cell.payload_bytes for cell in groups.cells if cell.data_type == cells[0].data_type]
        if least > min(measured):
            parts.append(_from_size(least, max(measured)))
    return ", ".join(parts)


def _from_size(least: int, largest: int) -> str:
    return f"at {format_size(least)}" if least == largest else f"from {format_size(least)} on"


def avoid_sentence(answers: Sequence[CaseAnswer], vendors: VendorLabels, cures: Mapping[int, str]) -> str:
    """Return which setups are not to be used, the worst result of each; not those whose losses have a cure (row -> cure)."""
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
    parts = [f"{_some(setups, 'more')}: {printable(cure)}" for cure, setups in by_cure.items()]
    return f"Losses with a known cure: {_some(parts, 'more in the findings')}." if parts else ""


def few_lost_sentence(answers: Sequence[CaseAnswer], vendors: VendorLabels) -> str:
    few = [
        f"{where} ({format_count(row.lost or 0)} of {format_count(row.messages or 0)})"
        for row, where in _lossy(answers, vendors)
        if row.reason == Reason.FEW_LOST.value
    ]
    return f"Too few losses to judge: {_some(few, 'more in the table')}." if few else ""


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


def winner_sentences(answers: Sequence[CaseAnswer], vendors: VendorLabels) -> tuple[str, ...]:
    labels = contender_labels(answers, vendors)
    several_types = len({answer.data_type for answer in answers}) > 1
    compared = (answer for answer in answers if answer.clarity is not Clarity.ONLY_ONE)
    sentences = []
    for (mode, data_type), by_pair in answers_by_kind(compared):
        if not any(outcome_of(case).is_decided for cases in by_pair.values() for case in cases):
            continue
        words = MODES.get(mode, printable(mode))
        where = f"In the {words}" if mode == "same" else f"Across {words}"
        what = f"{where}, {data_type_label(data_type)}" if several_types else where
        shown = places_alike(by_pair)[: MOST_NAMED if len(by_pair) <= MOST_NAMED else 1]
        for pairs in shown:
            cut = stretches(case for pair in pairs for case in by_pair[pair])
            on = "" if len(by_pair) == 1 else f", on {_pairs(pairs, len(by_pair))}"
            sentences.append(f"{what}{on}: {_outcomes(cut, labels)}.")
        more = len(by_pair) - sum(map(len, shown))
        if more:
            sentences[-1] += f" For the others see the table ({counted(more, 'pair')} of devices and links)."
    return tuple(sentences)


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


def _outcomes(cut: Sequence[Stretch], labels: Mapping[str, str]) -> str:
    sizes = [size for stretch in cut for size in stretch.sizes]
    parts = []
    for stretch in by_outcome(cut) if len(cut) > MOST_NAMED else cut:
        where, outcome = size_span(stretch.sizes, sizes), stretch.outcome
        if outcome is None:
            parts.append(f"{where} it depends on the rate ({_wins(stretch.cases, labels)})")
        elif outcome.p50 or outcome.p99:
            parts.append(f"{where} {_leader_words(stretch, outcome, labels)}")
        elif outcome.slower:
            parts.append(f"{where} {_tier_words(stretch, outcome, labels)}")
        elif outcome.is_interleaved:
            parts.append(f"{where} no clear winner{_repeats_words(stretch.cases, '')}")
        else:
            parts.append(f"{where} no clear winner: the setups were recorded one after the other")
    return "; ".join(parts)


def _wins(cases: Sequence[CaseAnswer], labels: Mapping[str, str]) -> str:
    won = Counter(name for case in cases if (name := case.leader_p50 or case.leader_p99))
    (first, count), *others = won.most_common()
    lead = f"{labels[first]} is fastest in {count} of {counted(len(cases), 'comparison')}"
    return ", ".join([lead, *(f"{labels[name]} in {wins}" for name, wins in others)])


def by_outcome(cut: Sequence[Stretch]) -> list[Stretch]:
    joined_of: dict[Outcome | None, Stretch] = {}
    for stretch in cut:
        joined = joined_of.get(stretch.outcome, Stretch(stretch.outcome, (), ()))
        sizes, cases = (*joined.sizes, *stretch.sizes), (*joined.cases, *stretch.cases)
        joined_of[stretch.outcome] = Stretch(stretch.outcome, sizes, cases)

    def order(stretch: Stretch) -> tuple[bool, int]:
        return stretch.outcome is None or not stretch.outcome.is_decided, -len(stretch.sizes)

    return sorted(joined_of.values(), key=order)


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


def _leader_words(stretch: Stretch, outcome: Outcome, labels: Mapping[str, str]) -> str:
    leaders = [(getattr(outcome, percentile), percentile, label) for percentile, label in PERCENTILES]
    leads = [(name, _lead_words(stretch, percentile), label) for name, percentile, label in leaders if name]
    start = "all setups lose too much; of them, " if outcome.is_lossy else ""
    if len(leads) == len(leaders) and outcome.p50 == outcome.p99:
        by = ", ".join(f"{words} {label}" for _, words, label in leads)
        return f"{start}{labels[outcome.p50]} is fastest (the next takes {by})"
    parts = [
        f"{labels[name]}{'' if number else ' is fastest'} {label} (the next takes {words})"
        for number, (name, words, label) in enumerate(leads)
    ]
    is_tested = all(setup.letters_p99 for case in stretch.cases for setup in case.contenders)
    parts += [
        f"no clear difference {label}"
        for name, percentile, label in leaders
        if not name and (percentile == "p50" or is_tested)
    ]
    return start + ", ".join(parts)


def _lead_words(stretch: Stretch, percentile: str) -> str:
    won, factors = _leads(stretch, percentile)
    within = f" in {len(won)} of {len(stretch.cases)} comparisons" if len(won) < len(stretch.cases) else ""
    return f"{factor_words(factors)} as long{within}" if factors else f"longer, as its messages were lost{within}"


def _leads(stretch: Stretch, percentile: str) -> tuple[list[CaseAnswer], list[float]]:
    won = [case for case in stretch.cases if getattr(case, f"leader_{percentile}")]
    return won, [factor for case in won if (factor := _factor(case, percentile)) is not None]


def _lead_factors(stretch: Stretch, percentile: str) -> str:
    factors = _leads(stretch, percentile)[1]
    return factor_words(factors) if factors else "longer, as its messages were lost"


def _slower_factors(stretch: Stretch, outcome: Outcome, name: str) -> str:
    ratios = []
    for case in stretch.cases:
        times = {setup.name: getattr(setup, f"{outcome.percentile}_ns") for setup in case.contenders}
        if outcome_of(case) == outcome and times[name] != float("inf"):
            ratios.append(times[name] / times[outcome.best[0]])
    return factor_words(ratios) if ratios else ""


def _tier_words(stretch: Stretch, outcome: Outcome, labels: Mapping[str, str]) -> str:
    first = outcome.best[0]
    label = dict(PERCENTILES)[outcome.percentile]
    best = f"{joined([labels[name] for name in outcome.best], 'or')}, no difference proven {label}"
    if len(outcome.best) == 1:  # a setup that loses more is as fast
        best = f"of setups that lose little, {labels[first]} is fastest {label}"
    parts = []
    for name in outcome.slower:
        factors = _slower_factors(stretch, outcome, name)
        takes = f"{factors} as long as {labels[first]}" if factors else "longer, as messages were lost"
        parts.append(f"{labels[name]} takes {takes}")
    shown = parts[:MOST_NAMED] + ([f"{len(parts) - MOST_NAMED} more take longer"] if parts[MOST_NAMED:] else [])
    return f"{best}, while {joined(shown)}{_repeats_words(stretch.cases, ' the rest')}"


def _repeats_words(cases: Sequence[CaseAnswer], what: str) -> str:
    counts = [case.repeats_p50 for case in cases if case.repeats_p50 is not None]
    return f" (about {max(counts)} repeats would decide{what})" if counts else ""


def _factor(case: CaseAnswer, percentile: str) -> float | None:
    times = {setup.name: getattr(setup, f"{percentile}_ns") for setup in case.contenders}
    fastest_ns = times.pop(getattr(case, f"leader_{percentile}"))
    others = [value for value in times.values() if value is not None and fastest_ns <= value != float("inf")]
    return min(others) / fastest_ns if others and fastest_ns else None


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
    return f"Measured on {_some(parts, 'more pairs of devices')}{runs}.{_busy(analysis)}"


def _busy(analysis: Analysis) -> str:
    full = sum(finding.count for finding in analysis.findings if finding.code == "cpu_saturated")
    recordings = len(analysis.sessions)
    if not full or full < BUSY_SHARE * recordings:
        return ""
    return f" The machine was busy in {full} of {counted(recordings, 'recording')}: these times include waiting for a processor."


def _some(parts: Sequence[str], noun: str) -> str:
    more = len(parts) - MOST_NAMED
    return "; ".join([*parts[:MOST_NAMED], *([f"and {more} {noun}"] if more > 0 else [])])


def fastest_words(stretch: Stretch, labels: Mapping[str, str]) -> str:
    outcome = stretch.outcome
    if outcome is None:
        return f"it depends on the rate ({_wins(stretch.cases, labels)})"
    if outcome.p50 or outcome.p99:
        leads = [
            f"{'' if percentile == 'p50' else 'at p99 '}{labels[name]}, next {_lead_factors(stretch, percentile)}"
            for percentile, _ in PERCENTILES
            if (name := getattr(outcome, percentile))
        ]
        if outcome.p50 == outcome.p99:
            leads = [f"{leads[0]}, at p99 {_lead_factors(stretch, 'p99')}"]
        return "; ".join(leads) + (" (all setups lose too much)" if outcome.is_lossy else "")
    repeats = _repeats_words(stretch.cases, "").replace("about ", "")
    if not outcome.slower:
        return f"no clear winner{repeats}"
    slower = {labels[name]: _slower_factors(stretch, outcome, name) for name in outcome.slower}
    parts = [f"{name} {factors}" for name, factors in [*slower.items()][:MOST_NAMED]]
    at_tail = "at p99 " if outcome.percentile == "p99" else ""
    return f"{at_tail}{joined([labels[name] for name in outcome.best], 'or')}; {joined(parts)}{repeats}"
