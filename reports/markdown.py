"""Markdown report: short enough for a pull request, with every string from a trace escaped."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from dds_trace.analyzer.statistics.intervals import messages_to_end
from dds_trace.base.files import write_whole
from dds_trace.base.units import MISSING, counted, format_duration, format_rate, format_size

from .book.book import Book
from .book.groups import (
    LATENCY_MEANING,
    METRIC_LABELS,
    STATISTIC_LABELS,
    Group,
    data_type_label,
    drift_words,
    format_added_ns,
    format_ratio,
    markdown,
)
from .book.numbers import Values
from .book.recommendation import COLUMNS
from .book.sizes import HOW_TO_READ, SizeCell
from .figures.costs import Cost, bridge_cost_info

FILE_NAME = "report.md"
MOST_GROUPS = 150
COST_STATISTICS = ("p50", "p90", "p99")
HOW_TO_READ_COSTS = (
    "Latency of a typical run through the bridge less the one in the same domain, its 95 % interval, and the ratio of the two, with "
    "the runs and the shares received of the same domain and of the bridge; a lost message is infinitely late. Without an interval the "
    "samples show no more than the difference; with fewer than three runs a side all is within one run."
)
SHOWN_STATISTICS = ("p50", "p90", "p99", "max")


def render(book: Book) -> str:
    overview, answer = book.overview, book.answer
    parts = [
        f"# Latency report: {markdown(overview.title)}",
        *_advice(book),
        f"**{markdown(answer.headline)}**",
        _list(markdown(point) for point in answer.points),
        *_sizes(book),
        _list(markdown(remark) for remark in answer.remarks),
        markdown(answer.rule),
        *(
            part
            for table in book.topic_tables
            for part in (f"## {table.title}", _table(table.columns, table.rows), table.how)
        ),
        "## What was measured",
        _list(f"{markdown(fact.label)}: {markdown(fact.value)}" for fact in overview.facts),
        markdown(LATENCY_MEANING),
        "## Findings",
        _findings(book),
        "## Results",
        _groups(book),
        *_section("What a bridge costs", _bridge_costs(book)),
        *_section("What a message costs on the wire", _wire_costs(book)),
        *_section("Clocks", _clocks(book)),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def write(book: Book, folder: Path) -> Path:
    return write_whole(folder / FILE_NAME, render(book))


def _advice(book: Book) -> list[str]:
    advice = book.advice
    if advice is None:
        return []
    table = [_table(COLUMNS, advice.rows)] if advice.rows else []
    commands = [f"on {markdown(device)}:\n\n    {command}" for device, command in advice.commands]
    return [f"**{markdown(advice.sentence)}** Job: {markdown(advice.job)}", *table, markdown(advice.missing), *commands]


def _sizes(book: Book) -> Iterator[str]:
    table = book.sizes
    if table is None:
        return
    for site in table.places:
        rows = [(markdown(row.size), *map(_size_cell, row.cells)) for row in site.rows]
        if site.thresholds:
            outcomes = ("" if threshold is None else markdown(threshold.text) for threshold in site.thresholds)
            rows.insert(0, (markdown(table.deadline), *outcomes))
        heads = ("Size", *map(markdown, table.choices))
        yield f"{markdown(table.caption)}, on {markdown(site.place)}:"
        yield "\n".join(f"| {' | '.join(cells)} |" for cells in (heads, ("---",) * len(heads), *rows))
    yield HOW_TO_READ


def _size_cell(cell: SizeCell | None) -> str:
    if cell is None:
        return ""
    times = " / ".join(f"**{markdown(text)}**" if leads else markdown(text) for text, leads in cell.times)
    return f"{times}, {cell.lost}" if cell.lost else times


def _findings(book: Book) -> str:
    kinds = book.findings
    if not kinds:
        return "Nothing doubtful was found."
    rows = [
        (kind.severity_word, kind.heading, kind.listed[0].where, kind.listed[0].what, kind.listed[0].action)
        for kind in kinds
    ]
    parts = [_table(("Severity", "Finding", "Where", "What", "What to do"), rows)]
    for kind in kinds:
        if len(kind.listed) > 1:
            listed = _list(
                f"{markdown(observation.where)}: {markdown(observation.what)}" for observation in kind.listed
            )
            parts.append(f"<details><summary>{markdown(kind.heading)}</summary>\n\n{listed}\n\n</details>")
    return "\n\n".join(parts)


OWN_SHARE_NOTE = (
    "Own share: what the nodes of ping and relay themselves take of the median round trip, as each measured it at the run's rate "
    "before it started; a dash where a side measured none."
)
_INTERVAL_NOTE = (
    "In brackets: 95 % confidence intervals, of a typical run where there are three or more, else within one run; a dash is "
    f"an end that the sample does not support, as of p99 in one or two runs below {messages_to_end(0.99)} messages."
)

_MESSAGE_COLUMNS = ("Data", "Size", "Rate", "Setup")


def _message_cells(book: Book, group: Group) -> tuple[str, str, str, str]:
    cell = book.groups.cell_of(group)
    label = book.groups.labels[group.series]
    return data_type_label(cell.data_type), format_size(cell.payload_bytes), format_rate(cell.rate_hz), label


def _groups(book: Book) -> str:
    groups, values = book.groups.in_order, book.values
    if not groups:
        return "No measurement was found."
    metric = values.default_metric
    intervals = book.intervals
    rows = [
        (
            *_message_cells(book, group),
            format_ratio(values.plain["own_share"][group.index]),
            _received(values, group.index),
            _runs(book, group.index),
            *(
                _with_interval(values.times_ns[metric][name][group.index], intervals.ends(metric, name, group.index))
                + (f" (rests on {counted(bursts, 'burst')})" if bursts is not None else "")
                for name in SHOWN_STATISTICS
                for bursts in [intervals.tail_episodes(metric, name, group.index)]
            ),
        )
        for group in groups[:MOST_GROUPS]
    ]
    names = (f"{METRIC_LABELS[metric]} {STATISTIC_LABELS[name]}" for name in SHOWN_STATISTICS)
    hidden = len(groups) - len(rows)
    has_own_share = any(share is not None for share in values.plain["own_share"])
    notes = (
        _INTERVAL_NOTE if intervals.low_ns.get(metric) or intervals.high_ns.get(metric) else "",
        OWN_SHARE_NOTE if has_own_share else "",
        f"{counted(hidden, 'more result is', 'more results are')} in `summary.parquet`." if hidden else "",
    )
    table = _table((*_MESSAGE_COLUMNS, "Own share", "Received", "Runs", *names), rows)
    title = f"{METRIC_LABELS[metric]} of all messages that were received:"
    return "\n\n".join([title, table, *filter(None, notes)])


def _received(values: Values, group: int) -> str:
    unsent = values.plain["unsent"][group]
    return format_ratio(values.plain["received_ratio"][group]) + (f", {unsent:.0f} unsent" if unsent else "")


def _runs(book: Book, group: int) -> str:
    basis = book.intervals.basis(book.values.default_metric, "p50", group)
    runs = book.values.plain["runs"][group]
    return basis if basis != MISSING or runs is None else f"{runs:.0f}"


def _with_interval(value_ns: int | None, ends: tuple[int | None, int | None]) -> str:
    low, high = ends
    shown = format_duration(value_ns)
    return shown if low is None and high is None else f"{shown} [{format_duration(low)}, {format_duration(high)}]"


def _bridge_costs(book: Book) -> str:
    cells = bridge_cost_info(book).cells
    if not cells:
        return ""
    rows = []
    for index, bridged in list(cells.items())[:MOST_GROUPS]:
        first = next(iter(bridged.costs.values()))  # runs and shares are the same for every statistic
        load = bridged.bridge_cpu_percent
        rows.append(
            (
                *_message_cells(book, book.groups.groups[index]),
                first.runs,
                first.received,
                *(_added(bridged.costs.get(name)) for name in COST_STATISTICS),
                MISSING if load is None else f"{load:.0f} %",
            )
        )
    names = (f"Added, {STATISTIC_LABELS[name]}" for name in COST_STATISTICS)
    table = _table((*_MESSAGE_COLUMNS, "Runs", "Received", *names, "Bridge CPU"), rows)
    return "\n\n".join([table, HOW_TO_READ_COSTS, *_more(len(cells) - len(rows))])


def _more(hidden: int) -> list[str]:
    return [f"{counted(hidden, 'more result is', 'more results are')} in the JSON report."] if hidden > 0 else []


def _added(cost: Cost | None) -> str:
    if cost is None:
        return MISSING
    within = ""
    if cost.low_ns is not None and cost.high_ns is not None:
        within = f" [{format_added_ns(cost.low_ns)}, {format_added_ns(cost.high_ns)}]"
    ratio = "" if cost.ratio is None else f", x{cost.ratio:.3g}"
    return f"{format_added_ns(cost.difference_ns)}{within}{ratio}"


def _wire_costs(book: Book) -> str:
    costs = {row["group"]: row for row in book.analysis.details.wire.iter_rows(named=True)}
    rows = []
    for group in book.groups.in_order:
        row = costs.get(group.index)
        if row is None:
            continue
        ratio, rtt_ns = row["bytes_per_payload_byte"], row["tcp_rtt_p50_ns"]
        messages = f"{row['again_messages']} of {counted(row['messages'], 'message')}"
        segments = counted(row["tcp_retransmitted_segments"], "segment")
        rows.append(
            (
                *_message_cells(book, group),
                MISSING if ratio is None else f"{ratio:.3g}",
                format_ratio(row["again_bytes_share"]),
                messages if row["messages"] else "not seen",
                "" if rtt_ns is None else f"{segments} again, round trip {format_duration(rtt_ns)}",
                format_duration(row["match_p50_ns"]),
                "" if row["complete"] else f"{counted(row['kernel_drops'], 'packet')} dropped by the kernel",
            )
        )
    columns = (
        *("Bytes per payload byte", "Sent again", "Messages sent again"),
        *("TCP", "First message after", "Incomplete"),
    )
    table = _table((*_MESSAGE_COLUMNS, *columns), rows[:MOST_GROUPS])
    return "\n\n".join([table, *_more(len(rows) - MOST_GROUPS)])


def _clocks(book: Book) -> str:
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
    return _table(("Devices", "Offset", "Drift", "Step before"), rows[:MOST_GROUPS])


def _section(title: str, text: str) -> tuple[str, ...]:
    return (f"## {title}", text) if text else ()


def _table(columns: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [f"| {' | '.join(markdown(cell) for cell in row)} |" for row in rows]
    if not lines:
        return ""
    return "\n".join([f"| {' | '.join(columns)} |", f"|{' --- |' * len(columns)}", *lines])


def _list(items: Iterable[str]) -> str:
    return "\n".join(f"- {item}" for item in items)
