"""The table of size by setup for each device pair and link."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import polars as pl

from dds_trace.analyzer.analysis import Analysis, Details
from dds_trace.analyzer.model.names import device_pair
from dds_trace.analyzer.statistics.intervals import MIN_RUNS
from dds_trace.analyzer.verdicts.answers import CaseAnswer
from dds_trace.analyzer.verdicts.cases import Contender
from dds_trace.base.printable import printable
from dds_trace.base.units import format_duration, format_rate, format_ratio, format_size

from ..blocks import EVERYWHERE, MARKS, OPEN, Column, Row, Span, Stack, Table, Words
from .facets import Facets
from .groups import LOST, METRIC_LABELS, VendorLabels, data_type_label, data_type_rank, time_words
from .numbers import ALL_MESSAGES, TYPICAL_RUN, Intervals
from .verdicts import MODES, contender_labels, place_of

Late = Mapping[int, tuple[int, int, int]]
"""Group -> late messages, judged ones, and the ones that may be late."""


HOW_TO_READ = (
    "Of a typical run where there are three or more, each with enough messages for the percentile, else of all messages; lost "
    "messages count as later than any other. To lost: of all messages this percentile is lost, in the middle run it is the time. "
    "Bold: proven to be the lowest of its row and domain, by a test of the runs. A dash: too few messages for this percentile."
)


@dataclass(frozen=True, slots=True)
class SizeCell:
    p50: str
    p99: str
    leads_p50: bool
    leads_p99: bool
    lost: str
    group: int | None = None
    p50_ns: float | None = field(default=None, compare=False)
    p99_ns: float | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class SizeRow:
    size: str
    rate: str
    cells: tuple[SizeCell | None, ...]


@dataclass(frozen=True, slots=True)
class Threshold:
    outcome: str
    why: str


@dataclass(frozen=True, slots=True)
class PlaceRows:
    place: str
    thresholds: tuple[Threshold | None, ...]
    rows: tuple[SizeRow, ...]
    further: tuple[SizeRow, ...]
    devices: str = ""
    link: str = ""


@dataclass(frozen=True, slots=True)
class SizeTable:
    modes: tuple[tuple[str, int], ...]
    choices: tuple[str, ...]
    deadline: str
    rates: str
    places: tuple[PlaceRows, ...]
    whose: str


def size_table(analysis: Analysis, vendors: VendorLabels) -> SizeTable | None:
    answers = analysis.details.answers
    if not answers:
        return None
    labels = contender_labels(answers, vendors)
    columns = sorted(
        {(answer.domain_mode, setup.name) for answer in answers for setup in answer.contenders},
        key=lambda column: (column[0] != "same", column[0], labels[column[1]], column[1]),
    )
    rates = _shown_rates(answers)
    late = late_by_group(analysis)
    answers_at: dict[str, list[CaseAnswer]] = {}
    for answer in sorted(answers, key=_order):
        answers_at.setdefault(place_of(answer), []).append(answer)
    modes = Counter(mode for mode, _ in columns)
    return SizeTable(
        modes=tuple((MODES.get(mode, printable(mode)), count) for mode, count in modes.items()),
        choices=tuple(labels[name] for _, name in columns),
        deadline=_deadline_words(analysis.details),
        rates=f"at {format_rate(next(iter(rates.values())))}"
        if len(set(rates.values())) == 1
        else ", ".join(f"{data_type_label(data_type)} at {format_rate(rate)}" for data_type, rate in rates.items()),
        places=tuple(_place_rows(name, cases, columns, rates, late) for name, cases in answers_at.items()),
        whose=TYPICAL_RUN if any(answer.fewest_runs >= MIN_RUNS for answer in answers) else ALL_MESSAGES,
    )


def _shown_rates(answers: Iterable[CaseAnswer]) -> dict[str, float]:
    counts_of: dict[str, Counter[float]] = {}
    for answer in answers:
        counts_of.setdefault(answer.data_type, Counter())[answer.rate_hz] += 1
    chosen = {}
    for data_type, counts in counts_of.items():
        rates = sorted(rate for rate, count in counts.items() if count == max(counts.values()))
        chosen[data_type] = rates[(len(rates) - 1) // 2]
    return chosen


def _place_rows(
    name: str, cases: Sequence[CaseAnswer], columns: Sequence[tuple[str, str]], rates: Mapping[str, float], late: Late
) -> PlaceRows:
    by_message: dict[tuple[str, int, float], list[CaseAnswer]] = {}
    for case in cases:
        by_message.setdefault((case.data_type, case.payload_bytes, case.rate_hz), []).append(case)
    rows: list[SizeRow] = []
    further: list[SizeRow] = []
    for (data_type, payload_bytes, rate_hz), answers_of in by_message.items():
        cells = {(case.domain_mode, setup.name): _cell(case, setup) for case in answers_of for setup in case.contenders}
        row = SizeRow(
            f"{data_type_label(data_type)} {format_size(payload_bytes)}",
            format_rate(rate_hz),
            tuple(cells.get(column) for column in columns),
        )
        (rows if rate_hz == rates[data_type] else further).append(row)
    thresholds = tuple(_threshold(cases, column, late) for column in columns) if late else ()
    devices = device_pair(cases[0].ping_device, cases[0].relay_device)
    return PlaceRows(name, thresholds, tuple(rows), tuple(further), devices, name.removeprefix(f"{devices}, "))


def _to_lost(time_ns: float | None, lost: float, quantile: float) -> str:
    is_range = time_ns is not None and math.isfinite(time_ns) and lost > 1 - quantile
    return f"{time_words(time_ns)} to {LOST}" if is_range else time_words(time_ns)


def _cell(case: CaseAnswer, setup: Contender) -> SizeCell:
    return SizeCell(
        p50=_to_lost(setup.p50_ns, setup.lost, 0.5),
        p99=_to_lost(setup.p99_ns, setup.lost, 0.99),
        leads_p50=case.leader_p50 == setup.name,
        leads_p99=case.leader_p99 == setup.name,
        lost=f"{format_ratio(setup.lost)} lost" if setup.received.value is not None and setup.lost > 0 else "",
        group=setup.group,
        p50_ns=setup.p50_ns,
        p99_ns=setup.p99_ns,
    )


def _deadline_words(details: Details) -> str:
    if details.deadline_ns is None or not details.freshness.height:
        return ""
    metric = METRIC_LABELS.get(details.deadline_metric, printable(details.deadline_metric)).lower()
    return f"{metric} within {format_duration(details.deadline_ns)}"


def late_share(missed: int, judged: int, unsure: int) -> float:
    return missed / max(1, judged + unsure)


def late_by_group(analysis: Analysis) -> Late:
    details = analysis.details
    if not _deadline_words(details):
        return {}
    counts = details.freshness.group_by("group").agg(pl.col("missed", "judged", "unsure").sum())
    return {group: (missed, judged, unsure) for group, missed, judged, unsure in counts.iter_rows()}


def _threshold(cases: Sequence[CaseAnswer], column: tuple[str, str], late: Late) -> Threshold | None:
    mode, name = column
    judged = [
        (case, [sum(numbers) for numbers in zip(*of_groups, strict=True)])
        for case in cases
        for setup in case.contenders
        if (case.domain_mode, setup.name) == (mode, name)
        and (of_groups := [late[group] for group in setup.groups if group in late])
    ]
    if not judged:
        return None
    all_results = "" if len(judged) == 1 else f" of {len(judged)} results"
    missing = [(case, late_share(*counts)) for case, counts in judged if counts[0]]
    if missing:
        worst, share = max(missing, key=lambda pair: pair[1])
        lateness = f"{format_size(worst.payload_bytes)} at {format_rate(worst.rate_hz)}: {format_ratio(share)} late"
        return Threshold("fail", f"{len(missing)}{all_results}, worst {lateness}" if all_results else lateness)
    unknown = sum(bool(unsure) or not count for _, (_, count, unsure) in judged)
    if not unknown:
        return Threshold("pass", "")
    return Threshold("not known", f"for {unknown}{all_results}" if all_results else "")


def _order(answer: CaseAnswer) -> tuple[object, ...]:
    where = answer.ping_device, answer.relay_device or "", answer.connectivity, answer.conditions
    return *where, *data_type_rank(answer.data_type), answer.payload_bytes, answer.rate_hz


def size_block(sizes: SizeTable, *, is_further: bool = False) -> Table:
    heads = [mode for mode, count in sizes.modes for _ in range(count)]
    choices = zip(sizes.choices, heads, strict=True)
    columns = [Column("Size", width=15), *(Column(name, width=20, head=head) for name, head in choices)]
    rows = []
    for site in sizes.places:
        if site.thresholds and not is_further:
            rows.append(Row([sizes.deadline, *map(_outcome, site.thresholds)], part=site.place))
        for row in site.further if is_further else site.rows:
            name = f"{row.size} at {row.rate}" if is_further else row.size
            rows.append(Row([name, *(_times(cell, row) for cell in row.cells)], part=site.place))
    rates = "at the other rates" if is_further else sizes.rates
    caption = [Span(f"Latency of {sizes.whose} ({rates}), median", ""), Span(" / p99", "p99")]
    return Table(columns, rows, caption, look="sizes", parted=EVERYWHERE)


def _outcome(threshold: Threshold | None) -> Words:
    if threshold is None:
        return ""
    mark = MARKS.get(threshold.outcome, OPEN)
    return [mark, Span(f" {threshold.outcome}", mark.tone), Span(f": {threshold.why}" if threshold.why else "", "")]


TINTS = (1.05, 1.25, 1.6, 2.5)
"""Factors over a row's lowest median from which a page shades a cell."""


def _times(cell: SizeCell | None, row: SizeRow) -> Words:
    if cell is None:
        return ""
    tones = [
        f"tint-{_tint(cell, row)}",
        *(["strong"] if cell.leads_p50 else []),
        *(["bad"] if cell.p50 == LOST else []),
    ]
    tail = "p99 strong" if cell.leads_p99 else "p99"
    lines = [[Span(cell.p50, " ".join(tones), cell.group), Span(" / ", "p99"), Span(cell.p99, tail)]]
    return Stack([*lines, *([[Span(cell.lost, "bad lost")]] if cell.lost else [])])


def _tint(cell: SizeCell, row: SizeRow) -> int:
    times = [other.p50_ns for other in row.cells if other and other.p50_ns and math.isfinite(other.p50_ns)]
    return bisect_right(TINTS, cell.p50_ns / min(times)) if times and cell.p50_ns is not None else 0


MOST_BLOCKS, MOST_ROWS = 6, 18
LONGEST_HEADS = 40
"""Letters of all links that are columns; longer ones are above their rows."""


@dataclass(frozen=True, slots=True)
class Dot:
    cell: SizeCell
    at: float | None
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class DotRow:
    setup: str
    choice: int | None
    dots: tuple[Dot | None, ...]


@dataclass(frozen=True, slots=True)
class Glance:
    message: str
    columns: tuple[str, ...]
    blocks: tuple[tuple[str, tuple[DotRow, ...]], ...]
    left_out: int
    ticks: tuple[tuple[float, str], ...]


def glance_info(table: SizeTable | None, intervals: Intervals, facets: Facets) -> Glance | None:
    if table is None:
        return None
    blocks: dict[str, dict[str, SizeRow]]
    if len(table.places) > 1:
        counts = Counter((row.size, row.rate) for site in table.places for row in site.rows)
        alike = [message for message, count in counts.items() if count == max(counts.values())]
        size, rate = alike[(len(alike) - 1) // 2]
        blocks = _by_place(table.places, size, rate)
        message = f"{size} at {rate}"
    else:
        blocks = {row.size: {"": row} for site in table.places for row in site.rows}
        message = table.rates
    most = max(1, min(MOST_BLOCKS, MOST_ROWS // len(table.choices)))
    last = len(blocks) - 1
    chosen = {round(index * last / max(1, most - 1)) for index in range(most)} if last >= most else range(last + 1)
    shown = {name: rows for index, (name, rows) in enumerate(blocks.items()) if index in chosen}
    columns = tuple(dict.fromkeys(link for rows in shown.values() for link in rows))
    reached = [
        ns
        for rows in shown.values()
        for row in rows.values()
        for cell in row.cells
        if cell
        for ns in _ends(cell, intervals)
    ]
    if not reached:
        return None
    low, high = math.log(min(reached)), math.log(max(reached))

    def percent(ns: float) -> float:
        return round(2 + 96 * (math.log(ns) - low) / (high - low or 1), 1)

    def dot(cell: SizeCell | None) -> Dot | None:
        if cell is None:
            return None
        ends = _ends(cell, intervals)
        return Dot(cell, *map(percent, ends)) if ends else Dot(cell, None, 0.0, 0.0)

    blocks_drawn = []
    for name, rows in shown.items():
        dots = []
        for column, setup in enumerate(table.choices):
            cells = [rows[link].cells[column] if link in rows else None for link in columns]
            groups = [cell.group for cell in cells if cell and cell.group is not None]
            if any(cells):
                choice = facets.option("choice", groups[0]) if groups else None
                dots.append(DotRow(setup, choice, tuple(map(dot, cells))))
        blocks_drawn.append((name, tuple(dots)))
    ticks = tuple((percent(ns), format_duration(ns)) for ns in _scale(min(reached), max(reached), 4 // len(columns)))
    return Glance(message, columns, tuple(blocks_drawn), len(blocks) - len(shown), ticks)


def _scale(low_ns: float, high_ns: float, most: int) -> list[float]:
    """Return round times of a log scale, from the coarsest steps that have two within it, else its ends."""
    powers = range(math.floor(math.log10(low_ns)), math.ceil(math.log10(high_ns)) + 1)
    for steps in ((1,), (1, 3), (1, 2, 5)):
        times_ns = [step * 10.0**power for power in powers for step in steps if low_ns <= step * 10.0**power <= high_ns]
        if len(times_ns) > 1:
            return times_ns[:: math.ceil(len(times_ns) / max(most, 1))]
    return [*dict.fromkeys((low_ns, high_ns))]


def _by_place(places: Sequence[PlaceRows], size: str, rate: str) -> dict[str, dict[str, SizeRow]]:
    blocks: dict[str, dict[str, SizeRow]] = {}
    are_columns = len("".join({site.link for site in places})) <= LONGEST_HEADS
    for site in places:
        name, column = (site.devices, site.link) if are_columns else (f"{site.devices}, {site.link}", "")
        for row in site.rows:
            if (row.size, row.rate) == (size, rate):
                blocks.setdefault(name, {})[column] = row
    return blocks


def _ends(cell: SizeCell, intervals: Intervals) -> tuple[float, ...]:
    at = cell.p50_ns
    if at is None or not math.isfinite(at) or at <= 0:
        return ()
    low, high = (None, None) if cell.group is None else intervals.ends("latency", "p50", cell.group)
    return at, min(low or at, at), max(high or at, at)
