"""Tables of all results of an analysis, of what bridges and the wire cost, and of the clocks."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from dds_trace.analyzer.statistics.intervals import MIN_RUNS, messages_to_end
from dds_trace.analyzer.statistics.percentiles import PERCENTILES, STATISTICS
from dds_trace.base.units import MISSING, counted, format_duration, format_rate, format_ratio, format_size

from ..blocks import EVERYWHERE, MARKDOWN, TERMINAL, Block, Column, Heading, Medium, Row, Sentence, Table
from .contents import Contents
from .groups import METRIC_LABELS, STATISTIC_LABELS, Group, data_type_label, drift_words, format_count, times_words
from .numbers import Cost

MOST_GROUPS = 150
"""Rows of a table in Markdown."""
SPARK_CELLS = 12
_BLOCKS = " ▁▂▃▄▅▆▇█"
_NOTE = (
    f"Runs: with a *, numbers hold within one run; a verdict needs {MIN_RUNS} that are long enough. Bur.: the bursts that p99 rests on; "
    f"one or two runs give it an upper bound from {messages_to_end(0.99)} messages on."
)
_INTERVAL_NOTE = (
    "95 %: a typical run's received messages and their confidence interval where there are three or more, else the interval within one run; a dash is an "
    "end that the sample does not support."
)
OWN_SHARE_NOTE = (
    "Own share: what the nodes of ping and relay themselves take of the median round trip, as each measured it at the run's rate "
    "before it started; a dash where a side measured none."
)
_TIMES = tuple(statistic.name for statistic in STATISTICS if statistic.is_tabled)
_WITH_INTERVALS = {percentile.name for percentile in PERCENTILES}


def results(book: Contents) -> Iterator[Block]:
    metric = book.values.default_metric
    values = [value for curve in book.curves.values_ns[metric] for value in curve if value > 0]
    ends_ns = (min(values, default=1), max(values, default=1))
    yield Heading("Results", media=MARKDOWN)
    groups = sorted(book.groups.groups, key=lambda group: (group.series, group.cell))
    if not groups:
        yield Sentence("No measurement was found.", media=MARKDOWN)
        return
    rows = [
        _group_row(book, group, ends_ns, EVERYWHERE if number < MOST_GROUPS else TERMINAL)
        for number, group in enumerate(groups)
    ]
    yield Table(_columns(), rows, f"{METRIC_LABELS[metric]} of all messages that were received")
    yield from _left_out(len(groups), "`summary.parquet`")
    if values:
        low, high = map(format_duration, ends_ns)
        yield Sentence(f"Each sparkline spans {low} to {high} (log scale).", "soft", media=TERMINAL)
        yield Sentence(_NOTE, "soft")
    if book.intervals.rows.get(metric):
        yield Sentence(_INTERVAL_NOTE, "soft", media=MARKDOWN)
    if any(share is not None for share in book.values.plain["own_share"]):
        yield Sentence(OWN_SHARE_NOTE, "soft", media=MARKDOWN)


def _columns() -> list[Column]:
    def shown(name: str, width: int, *, right: bool = True) -> Column:
        return Column(name, width=width, right=right, is_cut=True)

    columns = [shown("Data", 7, right=False), shown("Size", 7), shown("Rate", 7), Column("Setup", media=MARKDOWN)]
    columns += [shown("Runs", 4), shown("Received", 9)]
    columns += [Column(name, right=True, media=MARKDOWN) for name in ("Unsent", "Own share")]
    for name in _TIMES:
        columns += [Column(name, right=True, media=MARKDOWN) if name == "p90" else shown(name, 7)]
        columns += [Column("Typical run, received, 95 %", media=MARKDOWN)] if name in _WITH_INTERVALS else []
        columns += [shown("Bur.", 4)] if name == "p99" else []
    return [*columns, Column("Distribution", width=SPARK_CELLS, is_cut=True, media=TERMINAL)]


def _group_row(book: Contents, group: Group, ends_ns: tuple[int, int], media: Medium) -> Row:
    values, intervals, index = book.values, book.intervals, group.index
    metric, runs = values.default_metric, values.plain["runs"][index]
    bursts = intervals.tail_episodes(metric, "p99", index)
    cells = [
        *_message_cells(book, group),
        MISSING
        if runs is None
        else f"{runs:.0f}" + ("*" if runs < MIN_RUNS or intervals.is_within_runs(metric, "p50", index) else ""),
        format_ratio(values.plain["received_ratio"][index]),
        format_count(values.plain["unsent"][index]),
        format_ratio(values.plain["own_share"][index]),
    ]
    for name in _TIMES:
        ends, typical_ns = intervals.ends(metric, name, index), intervals.typical(metric, name, index)
        typical, low, high = times_words([typical_ns, *ends])
        cells.append(format_duration(values.times_ns[metric][name][index]))
        cells += (
            [MISSING if ends == (None, None) else f"{'' if typical_ns is None else f'{typical}, '}{low} to {high}"]
            if name in _WITH_INTERVALS
            else []
        )
        cells += [MISSING if bursts is None else str(bursts)] if name == "p99" else []
    cells.append(_sparkline(book.curves.values_ns[metric][index], ends_ns))
    return Row(cells, part=book.groups.labels[group.series], media=media)


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
HOW_TO_READ_COSTS = (
    "Latency of a typical run through the bridge less the one in the same domain, its 95 % interval, and the ratio of the two, with "
    "the runs and the shares received of the same domain and of the bridge; a lost message counts as later than any other. Without an interval the "
    "samples show no more than the difference; with fewer than three runs a side all is within one run."
)
_MESSAGE_COLUMNS = ("Data", "Size", "Rate", "Setup")


def _message_cells(book: Contents, group: Group) -> tuple[str, str, str, str]:
    cell = book.groups.cell_of(group)
    label = book.groups.labels[group.series]
    return data_type_label(cell.data_type), format_size(cell.payload_bytes), format_rate(cell.rate_hz), label


def _markdown_table(names: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "") -> Table:
    return Table([*map(Column, names)], [*map(Row, rows[:MOST_GROUPS])], caption, media=MARKDOWN)


def _left_out(count: int, where: str) -> Iterator[Block]:
    if count > MOST_GROUPS:
        yield Sentence(
            f"{counted(count - MOST_GROUPS, 'more result is', 'more results are')} in {where}.", media=MARKDOWN
        )


def costs(book: Contents) -> Iterator[Block]:
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


def wire(book: Contents) -> Iterator[Block]:
    costs = {row["group"]: row for row in book.analysis.details.wire.iter_rows(named=True)}
    rows = [_wire_row(book, group, row) for group in book.groups.in_order if (row := costs.get(group.index))]
    if rows:
        columns = (
            *("Bytes per payload byte", "Sent again", "Messages sent again"),
            *("TCP", "First message after", "Incomplete"),
        )
        yield Heading("What a message costs on the wire", media=MARKDOWN)
        yield _markdown_table((*_MESSAGE_COLUMNS, *columns), rows)
        yield from _left_out(len(rows), "the JSON report")


def _added(cost: Cost | None) -> str:
    if cost is None:
        return MISSING
    times_ns = (cost.difference_ns, cost.low_ns, cost.high_ns)
    texts = zip(times_ns, times_words(times_ns), strict=True)
    added, low, high = (f"+{words}" if value and value > 0 else words for value, words in texts)
    within = "" if MISSING in (low, high) else f" [{low}, {high}]"
    ratio = "" if cost.ratio is None else f", x{cost.ratio:.3g}"
    return f"{added}{within}{ratio}"


def _wire_row(book: Contents, group: Group, row: Mapping[str, Any]) -> tuple[str, ...]:
    ratio, rtt_ns = row["bytes_per_payload_byte"], row["tcp_rtt_p50_ns"]
    messages = f"{row['again_messages']:,} of {counted(row['messages'], 'message')}"
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


def clocks(book: Contents) -> Iterator[Block]:
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
