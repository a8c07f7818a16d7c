"""The sections of the report of an analysis, and its answer on one screen of a terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from dds_trace.analyzer.model.finding import Severity
from dds_trace.analyzer.statistics.intervals import MIN_RUNS, messages_to_end
from dds_trace.analyzer.verdicts.answers import CaseAnswer
from dds_trace.base.printable import printable
from dds_trace.base.units import MISSING, counted, format_duration, format_rate, format_size

from .. import blocks
from ..blocks import (
    MARKDOWN,
    TERMINAL,
    Bars,
    Block,
    Column,
    Fitted,
    Heading,
    Points,
    Row,
    Section,
    Sentence,
    Span,
    Table,
)
from .answer import PointKind
from .contents import Contents
from .findings import severity_counts
from .groups import (
    LATENCY_MEANING,
    METRIC_LABELS,
    STATISTIC_LABELS,
    Group,
    data_type_label,
    drift_words,
    format_added_ns,
    format_ratio,
)
from .headline import COMPARED, Fastest, bridge_facts
from .numbers import Cost, Values
from .outcomes import outcome_of, shown_case
from .recommendation import COLUMNS
from .sizes import HOW_TO_READ, SizeTable, size_rows
from .topics import topic_sections
from .verdicts import contender_labels

MOST_CHOICES = 3
"""Setups side by side in 80 columns."""
MOST_GROUPS = 150

_SEVERITY_TONES = {"error": "bad", "warning": "open", "info": "info"}


def sections(book: Contents) -> list[Section]:
    overview, answer = book.overview, book.answer
    title = Heading(f"Latency report: {overview.title}", 1)
    parts = [
        Section([title, *_advice_table(book)]),
        Section([Sentence(answer.headline, "headline"), Points(answer.points)]),
        *_sizes(book.sizes),
        Section([Points(answer.remarks), *([Sentence(answer.rule, "soft")] if answer.rule else [])]),
        *topic_sections(book.analysis),
    ]
    aligned = [[Span(f"{fact.label:<20}", "soft"), Span(fact.value, "")] for fact in overview.facts]
    measured: list[Block] = [
        Heading("What was measured", media=MARKDOWN),
        Points(aligned, bullet="", media=TERMINAL),
        Points([f"{fact.label}: {fact.value}" for fact in overview.facts], media=MARKDOWN),
        Sentence(LATENCY_MEANING, media=MARKDOWN),
    ]
    parts += [
        Section(measured),
        Section([Heading("Findings", media=MARKDOWN), *_findings(book)]),
        *_series(book),
        Section([*_results(book)]),
        Section([*_costs(book), *_clocks(book)]),
    ]
    return [*parts, *screen(book)]


def _advice_table(book: Contents) -> Iterator[Block]:
    advice = book.advice
    if advice is None:
        return
    yield Sentence([Span(advice.sentence), Span(f" Job: {advice.job}", "")], media=MARKDOWN)
    yield _markdown_table(COLUMNS, advice.rows)
    yield Sentence(advice.missing, media=MARKDOWN)
    yield from (blocks.Command(*command, media=MARKDOWN) for command in advice.commands)


def _sizes(sizes: SizeTable | None) -> Iterator[Section]:
    if sizes is None:
        return
    for site in sizes.places:
        caption = f"{sizes.caption}, on {site.place}"
        for start in range(0, len(sizes.choices), MOST_CHOICES):
            part = slice(start, start + MOST_CHOICES)
            columns = [Column("Size", width=15), *(Column(choice, width=20) for choice in sizes.choices[part])]
            rows = size_rows(sizes, site, part=part, separator="\n")
            yield Section([Table(columns, rows, "" if start else caption, media=TERMINAL)])
        rows = size_rows(sizes, site)
        yield Section([Table([*map(Column, ("Size", *sizes.choices))], rows, caption, media=MARKDOWN)])
    yield Section([Sentence(HOW_TO_READ, "soft")])


def _findings(book: Contents) -> Iterator[Block]:
    kinds = book.findings
    for kind in kinds:
        first = kind.listed[0]
        words = [Span(f"{kind.severity_word} ", f"strong {_SEVERITY_TONES[kind.severity]}"), Span(f"{kind.heading}: ")]
        yield Sentence([*words, Span(f"{first.where}: {first.what}", "")], media=TERMINAL)
        yield Points([[Span(first.action, "soft")]], bullet=" ", media=TERMINAL)
    if not kinds:
        yield Sentence("Nothing doubtful was found.", media=MARKDOWN)
    rows = [
        (kind.severity_word, kind.heading, one.where, one.what, one.action) for kind in kinds for one in kind.listed[:1]
    ]
    yield _markdown_table(("Severity", "Finding", "Where", "What", "What to do"), rows)
    for kind in kinds:
        if len(kind.listed) > 1:
            points = Points([f"{observation.where}: {observation.what}" for observation in kind.listed])
            yield blocks.Fold(kind.heading, [points], media=MARKDOWN)


SPARK_CELLS = 12
_BLOCKS = " ▁▂▃▄▅▆▇█"
_COLUMNS = (*(("Size", 7), ("Rate", 7), ("Runs", 4), ("Recv", 9)), *(("p50", 7), ("p99", 7), ("Bur.", 4), ("max", 7)))
_NOTES = (
    f"Runs: with a *, numbers hold within one run; a verdict needs {MIN_RUNS}. Bur.: the bursts that p99 rests on; "
    f"one or two runs give it an upper bound from {messages_to_end(0.99)} messages on."
)


def _series(book: Contents) -> Iterator[Section]:
    metric = book.values.default_metric
    values = [value for curve in book.curves.values_ns[metric] for value in curve if value > 0]
    ends_ns = (min(values, default=1), max(values, default=1))
    if values:
        yield Section([Heading(f"{METRIC_LABELS[metric]} of all messages that were received", media=TERMINAL)])
    columns = [Column("Data", width=7, is_cut=True)]
    columns += [Column(name, width=width, right=True, is_cut=True) for name, width in _COLUMNS]
    columns.append(Column("Distribution", width=SPARK_CELLS, is_cut=True))
    for series, label in enumerate(book.groups.labels):
        rows = [_group_row(book, group, ends_ns) for group in book.groups.in_order if group.series == series]
        yield Section([Table(columns, rows, label, media=TERMINAL)])
    if values:
        low, high = map(format_duration, ends_ns)
        note = f"Each sparkline spans {low} to {high} (log scale)."
        yield Section([Sentence(text, "soft", media=TERMINAL) for text in (note, _NOTES)])


def _group_row(book: Contents, group: Group, ends_ns: tuple[int, int]) -> Row:
    values, metric, index = book.values, book.values.default_metric, group.index
    times, cell = values.times_ns[metric], book.groups.cell_of(group)
    runs, bursts = values.plain["runs"][index], book.intervals.tail_episodes(metric, "p99", index)
    return Row(
        [
            printable(cell.data_type),
            format_size(cell.payload_bytes),
            format_rate(cell.rate_hz),
            MISSING if runs is None else f"{runs:.0f}" + ("*" if runs < MIN_RUNS else ""),
            format_ratio(values.plain["received_ratio"][index]),
            *(format_duration(times[name][index]) for name in ("p50", "p99")),
            MISSING if bursts is None else str(bursts),
            format_duration(times["max"][index]),
            _sparkline(book.curves.values_ns[metric][index], ends_ns),
        ]
    )


def _sparkline(curve: Sequence[int], ends: tuple[int, int]) -> str:
    positive = [value for value in curve if value > 0]
    if not positive:
        return MISSING
    low, high = map(math.log, ends)
    counts = [0] * SPARK_CELLS
    for value in positive:
        share = (math.log(value) - low) / (high - low) if high > low else 0.5
        counts[min(SPARK_CELLS - 1, int(share * SPARK_CELLS))] += 1
    most = max(counts)
    return "".join(_BLOCKS[math.ceil(count / most * (len(_BLOCKS) - 1))] for count in counts)


COST_STATISTICS = ("p50", "p90", "p99")
SHOWN_STATISTICS = ("p50", "p90", "p99", "max")
HOW_TO_READ_COSTS = (
    "Latency of a typical run through the bridge less the one in the same domain, its 95 % interval, and the ratio of the two, with "
    "the runs and the shares received of the same domain and of the bridge; a lost message is infinitely late. Without an interval the "
    "samples show no more than the difference; with fewer than three runs a side all is within one run."
)
OWN_SHARE_NOTE = (
    "Own share: what the nodes of ping and relay themselves take of the median round trip, as each measured it at the run's rate "
    "before it started; a dash where a side measured none."
)
_INTERVAL_NOTE = (
    "In brackets: 95 % confidence intervals, of a typical run where there are three or more, else within one run; a dash is "
    f"an end that the sample does not support, as of p99 in one or two runs below {messages_to_end(0.99)} messages."
)
_MESSAGE_COLUMNS = ("Data", "Size", "Rate", "Setup")


def _message_cells(book: Contents, group: Group) -> tuple[str, str, str, str]:
    cell = book.groups.cell_of(group)
    label = book.groups.labels[group.series]
    return data_type_label(cell.data_type), format_size(cell.payload_bytes), format_rate(cell.rate_hz), label


def _markdown_table(names: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "") -> Table:
    return Table([*map(Column, names)], [*map(Row, rows[:MOST_GROUPS])], caption, media=MARKDOWN)


def _results(book: Contents) -> Iterator[Block]:
    groups, values, intervals = book.groups.in_order, book.values, book.intervals
    metric = values.default_metric
    yield Heading("Results", media=MARKDOWN)
    if not groups:
        yield Sentence("No measurement was found.", media=MARKDOWN)
        return
    rows = [
        (
            *_message_cells(book, group),
            format_ratio(values.plain["own_share"][group.index]),
            _received(values, group.index),
            intervals.basis(metric, "p50", group.index, values.plain["runs"][group.index]),
            *(_with_interval(book, name, group.index) for name in SHOWN_STATISTICS),
        )
        for group in groups[:MOST_GROUPS]
    ]
    names = (f"{METRIC_LABELS[metric]} {STATISTIC_LABELS[name]}" for name in SHOWN_STATISTICS)
    caption = f"{METRIC_LABELS[metric]} of all messages that were received"
    yield _markdown_table((*_MESSAGE_COLUMNS, "Own share", "Received", "Runs", *names), rows, caption)
    if intervals.low_ns.get(metric) or intervals.high_ns.get(metric):
        yield Sentence(_INTERVAL_NOTE, media=MARKDOWN)
    if any(share is not None for share in values.plain["own_share"]):
        yield Sentence(OWN_SHARE_NOTE, media=MARKDOWN)
    yield from _left_out(len(groups), "`summary.parquet`")


def _left_out(count: int, where: str) -> Iterator[Block]:
    if count > MOST_GROUPS:
        yield Sentence(
            f"{counted(count - MOST_GROUPS, 'more result is', 'more results are')} in {where}.", media=MARKDOWN
        )


def _received(values: Values, group: int) -> str:
    unsent = values.plain["unsent"][group]
    return format_ratio(values.plain["received_ratio"][group]) + (f", {unsent:.0f} unsent" if unsent else "")


def _with_interval(book: Contents, name: str, group: int) -> str:
    metric, intervals = book.values.default_metric, book.intervals
    low, high = intervals.ends(metric, name, group)
    shown, bursts = (
        format_duration(book.values.times_ns[metric][name][group]),
        intervals.tail_episodes(metric, name, group),
    )
    shown += "" if low is None and high is None else f" [{format_duration(low)}, {format_duration(high)}]"
    return shown if bursts is None else f"{shown} (rests on {counted(bursts, 'burst')})"


def _costs(book: Contents) -> Iterator[Block]:
    cells, _ = book.bridge_costs
    rows = []
    for index, bridged in cells.items():
        first = next(iter(bridged.costs.values()))  # runs and shares are the same for every statistic
        load = bridged.bridge_cpu_percent
        added = (_added(bridged.costs.get(name)) for name in COST_STATISTICS)
        cpu = MISSING if load is None else f"{load:.0f} %"
        rows.append((*_message_cells(book, book.groups.groups[index]), first.runs, first.received, *added, cpu))
    if rows:
        names = (f"Added, {STATISTIC_LABELS[name]}" for name in COST_STATISTICS)
        yield Heading("What a bridge costs", media=MARKDOWN)
        yield _markdown_table((*_MESSAGE_COLUMNS, "Runs", "Received", *names, "Bridge CPU"), rows)
        yield Sentence(HOW_TO_READ_COSTS, media=MARKDOWN)
        yield from _left_out(len(rows), "the JSON report")
    costs = {row["group"]: row for row in book.analysis.details.wire.iter_rows(named=True)}
    wire = [_wire_row(book, group, row) for group in book.groups.in_order if (row := costs.get(group.index))]
    if wire:
        columns = (
            *("Bytes per payload byte", "Sent again", "Messages sent again"),
            *("TCP", "First message after", "Incomplete"),
        )
        yield Heading("What a message costs on the wire", media=MARKDOWN)
        yield _markdown_table((*_MESSAGE_COLUMNS, *columns), wire)
        yield from _left_out(len(wire), "the JSON report")


def _added(cost: Cost | None) -> str:
    if cost is None:
        return MISSING
    within = ""
    if cost.low_ns is not None and cost.high_ns is not None:
        within = f" [{format_added_ns(cost.low_ns)}, {format_added_ns(cost.high_ns)}]"
    ratio = "" if cost.ratio is None else f", x{cost.ratio:.3g}"
    return f"{format_added_ns(cost.difference_ns)}{within}{ratio}"


def _wire_row(book: Contents, group: Group, row: Mapping[str, Any]) -> tuple[str, ...]:
    ratio, rtt_ns = row["bytes_per_payload_byte"], row["tcp_rtt_p50_ns"]
    messages = f"{row['again_messages']} of {counted(row['messages'], 'message')}"
    segments = counted(row["tcp_retransmitted_segments"], "segment")
    return (
        *_message_cells(book, group),
        MISSING if ratio is None else f"{ratio:.3g}",
        format_ratio(row["again_bytes_share"]),
        messages if row["messages"] else "not seen",
        "" if rtt_ns is None else f"{segments} again, round trip {format_duration(rtt_ns)}",
        format_duration(row["match_p50_ns"]),
        "" if row["complete"] else f"{counted(row['kernel_drops'], 'packet')} dropped by the kernel",
    )


def _clocks(book: Contents) -> Iterator[Block]:
    rows = [
        (
            f"{row['ping_device']} → {row['relay_device']}",
            f"{format_duration(row['offset_ns'])} ± {format_duration(row['bound_ns'])}",
            drift_words(row),
            "" if row["step_before_ns"] is None else format_duration(row["step_before_ns"]),
        )
        for row in book.analysis.details.clock_fits.iter_rows(named=True)
        if not row["same_clock"]
    ]
    if rows:
        yield Heading("Clocks", media=MARKDOWN)
        yield _markdown_table(("Devices", "Offset", "Drift", "Step before"), rows)


MOST_LINES = 18
"""With the lines of the written files it is a screen of 20."""
MOST_SETUPS = 4
MOST_ADVICE = 6
"""Setups of a recommendation without `--all`."""

PASS, FAIL, OPEN, NONE = Span("✓", "good"), Span("✗", "bad"), Span("·", "soft"), Span("")
LOSSES = (PointKind.FORGED, PointKind.LOSS, PointKind.AVOID)
FIRST = (PointKind.RECOVERY, PointKind.INTERFERENCE, *LOSSES, PointKind.CURE)


def screen(book: Contents) -> list[Section]:
    return [Section([*_advice(book)] or [_brief(book)])]


def _brief(book: Contents) -> Fitted:
    answer = book.answer
    measured = next((fact.value for fact in book.overview.facts if fact.label == "Messages"), "")
    noun = "message" if measured.startswith("1 ") else "messages"
    title = book.overview.title + (f": {measured.replace(' in ', f' {noun} in ', 1)}" if measured else "")
    parts: list[Sequence[Block]] = [[Sentence(title, "strong", NONE)]]
    parts += [
        [Sentence(f"{kind.heading}: {kind.listed[0].what} {kind.listed[0].action}", mark=FAIL)]
        for kind in book.findings
        if kind.severity == Severity.ERROR.value
    ]
    vendors = book.groups.vendors
    parts += [
        [Sentence(sentence, mark=FAIL if kind in LOSSES else OPEN)]
        for kind, sentence in answer.sentences
        if kind in FIRST
    ]
    parts += _thresholds(book.sizes)
    if PointKind.FASTEST in answer.kinds:
        parts += _winners(book.fastest, contender_labels(book.analysis.details.answers, vendors))
    for kind, sentence in answer.sentences:
        if kind is PointKind.BRIDGE:
            facts = bridge_facts(book.analysis.details.bridge_costs, vendors)
            sentences = [Sentence(fact.replace(" as long", ""), mark=PASS) for fact in facts]
            parts.append([Sentence(COMPARED, "strong", NONE), *sentences])
        elif kind not in (*FIRST, PointKind.FASTEST):
            parts.append([Sentence(sentence, mark=OPEN)])
    findings = [words for severity, words in severity_counts(book.findings) if severity != Severity.ERROR.value]
    more = ", ".join([*findings, f"tables of {counted(len(book.groups.groups), 'result')}"])
    return Fitted(parts, MOST_LINES, "" if book.shows_all else more, media=TERMINAL)


def _winners(kinds: Sequence[Fastest], labels: Mapping[str, str]) -> Iterator[list[Block]]:
    is_drawn = False
    for kind in kinds:
        part: list[Block] = [Sentence(kind.heading, "strong", NONE)]
        part += [Sentence(f"{span}: {words}", mark=PASS if decided else OPEN) for span, words, decided in kind.lines]
        bars = [] if is_drawn else _bars(kind.cases, labels, place=kind.place if " on " in kind.heading else "")
        is_drawn = is_drawn or bool(bars)
        yield [*part, *bars]


def _bars(cases: Sequence[CaseAnswer], labels: Mapping[str, str], place: str) -> list[Bars]:
    if not any(outcome_of(case).is_decided for case in cases):
        return []
    case = shown_case(cases)
    times = sorted(
        (setup.p50_ns, labels[setup.name])
        for setup in case.contenders
        if setup.p50_ns is not None and math.isfinite(setup.p50_ns)
    )[:MOST_SETUPS]
    if len(times) < 2:
        return []
    size = format_size(case.payload_bytes)
    where = ", ".join(filter(None, (place, f"{size} at {format_rate(case.rate_hz)}")))
    return [Bars([(name, ns, format_duration(ns)) for ns, name in times], where, () if place else (where, size))]


def _thresholds(sizes: SizeTable | None) -> list[list[Block]]:
    if sizes is None or not sizes.deadline:
        return []
    lines: list[Block] = [Sentence(f"{sizes.deadline[:1].upper()}{sizes.deadline[1:]}", "strong", NONE)]
    order, passed = ["fail", "not known", "pass"], []
    for index, choice in enumerate(sizes.choices):
        judged = [
            (result, rows.place) for rows in sizes.places if rows.thresholds and (result := rows.thresholds[index])
        ]
        worst, site = min(judged, key=lambda pair: order.index(pair[0].outcome), default=(None, ""))
        if worst is None or worst.outcome == "pass":
            passed += [choice] if worst else []
            continue
        on = f" on {site}" if len(sizes.places) > 1 else ""
        lines.append(Sentence(f"{choice}{on}: {worst.why}", mark=FAIL if worst.outcome == "fail" else OPEN))
    return [[*lines, *([Sentence(", ".join(passed), mark=PASS)] if passed else [])]]


def _advice(book: Contents) -> Iterator[Block]:
    advice = book.advice
    if advice is None:
        return
    rows = advice.brief_rows if book.shows_all else advice.brief_rows[:MOST_ADVICE]
    yield Sentence(f"Job: {advice.job}", media=TERMINAL)
    yield Sentence(advice.sentence, "strong", media=TERMINAL)
    marks = {"meets": PASS, "misses": FAIL}
    cells = [
        Row([f"{number:2}.", [marks.get(fit, OPEN)], [Span(f"{setting}: {fit}; ", ""), Span(numbers, "soft")]])
        for number, (setting, fit, numbers) in enumerate(rows, 1)
    ]
    yield Table([Column(""), Column(""), Column("")], cells, media=TERMINAL)
    if len(advice.rows) > len(rows):
        more = counted(len(advice.rows) - len(rows), "more setup")
        yield Sentence(f"and {more}: --all", "soft", media=TERMINAL)
    if advice.missing:
        yield Sentence(advice.missing, media=TERMINAL)
    yield from (blocks.Command(*command, media=TERMINAL) for command in advice.commands)
