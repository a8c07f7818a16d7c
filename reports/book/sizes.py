"""The table below the headline: size by choice for each pair of devices and link, with p50, p99 and losses.

Its numbers are those of the analyzer's answers: a lost message is infinitely late, and a time is marked as best only where
the test of the runs says so at that percentile.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import polars as pl

from dds_trace.analyzer.model.parameters import CASE_COLUMNS, CONTENDER_COLUMNS
from dds_trace.analyzer.verdicts.cases import CONDITIONS, with_conditions
from dds_trace.base.printable import printable
from dds_trace.base.units import MISSING, counted, format_duration, format_rate, format_size

from .groups import DATA_TYPES, METRIC_LABELS, data_type_label, format_ratio
from .verdicts import MODES, contender_labels, place_label

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from dds_trace.analyzer.analysis import Analysis, Details
    from dds_trace.analyzer.verdicts.answers import CaseAnswer
    from dds_trace.analyzer.verdicts.cases import Contender

    from .groups import VendorLabels

    Case = tuple[object, ...]
    """Values of `CASE_COLUMNS`, then the conditions."""

HOW_TO_READ = (
    "Latency, median / p99, from three runs on those of a typical run; a lost message counts as infinitely late. Bold: clearly the "
    "lowest of its row and domain, by a test of the runs. A dash: too few messages for this percentile."
)


@dataclass(frozen=True, slots=True)
class SizeCell:
    """Times of one choice for one size and rate.

    Attributes:
        p50: median as text, `lost` if more than half of the messages were lost.
        p99: p99 likewise; a dash where the sample does not support it.
        leads_p50: whether the median is clearly below that of each other choice.
        leads_p99: the same of the p99.
        lost: share of the messages that were lost, as in `14 % lost`; empty if none was.
        group: index of its group; None where it is of several.
    """

    p50: str
    p99: str
    leads_p50: bool
    leads_p99: bool
    lost: str
    group: int | None = None


@dataclass(frozen=True, slots=True)
class SizeRow:
    """One size and rate; `cells` has None for a choice that was not measured there."""

    size: str
    rate: str
    cells: tuple[SizeCell | None, ...]


@dataclass(frozen=True, slots=True)
class Threshold:
    """Outcome of the deadline for one choice at one place.

    Attributes:
        outcome: `pass`, `fail` or `not known`.
        why: how many combinations miss it, and the worst of them; empty for a pass.
    """

    outcome: str
    why: str


@dataclass(frozen=True, slots=True)
class PlaceRows:
    """The rows of one pair of devices and link.

    Attributes:
        place: devices, link and conditions.
        thresholds: one per choice, None where it was not measured; empty without a deadline.
        rows: sizes at the rate that the table shows.
        further: sizes at all other rates.
    """

    place: str
    thresholds: tuple[Threshold | None, ...]
    rows: tuple[SizeRow, ...]
    further: tuple[SizeRow, ...]


@dataclass(frozen=True, slots=True)
class SizeTable:
    """Sizes by choice, for each place.

    Attributes:
        modes: domain modes in words with the number of their columns.
        choices: names of the columns, choices of the same domain first.
        deadline: the deadline in words; empty without one.
        rates: the rates that the rows show, as in `at 10 Hz`.
        places: rows of each place.
    """

    modes: tuple[tuple[str, int], ...]
    choices: tuple[str, ...]
    deadline: str
    rates: str
    places: tuple[PlaceRows, ...]

    @property
    def has_further(self) -> bool:
        """Whether other rates than the shown ones were measured."""
        return any(place.further for place in self.places)


def size_table(analysis: Analysis, vendors: VendorLabels) -> SizeTable | None:
    """Lay the answers out by place, size and choice; None without any."""
    answers = analysis.details.answers
    if not answers:
        return None
    labels = contender_labels(answers, vendors)
    columns = _columns(answers, labels)
    shown = _shown_rates(answers)
    late, groups = _late_of(analysis), _groups_of(analysis)
    of_place: dict[str, list[CaseAnswer]] = {}
    for answer in sorted(answers, key=_order):
        place = place_label(answer.ping_device, answer.relay_device, answer.connectivity, answer.conditions)
        of_place.setdefault(place, []).append(answer)
    modes = Counter(mode for mode, _ in columns)
    return SizeTable(
        modes=tuple((MODES.get(mode, printable(mode)), count) for mode, count in modes.items()),
        choices=tuple(labels[name] for _, name in columns),
        deadline=_deadline_words(analysis.details),
        rates=_rates_words(shown),
        places=tuple(
            _place_rows(place, cases, columns, shown, late, groups) for place, cases in of_place.items()
        ),
    )


def _columns(answers: Sequence[CaseAnswer], labels: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return domain mode and contender of each column, the same domain first, then in the order of the labels."""
    known = dict.fromkeys((answer.domain_mode, one.name) for answer in answers for one in answer.contenders)
    return sorted(known, key=lambda column: (column[0] != "same", column[0], labels[column[1]]))


def _shown_rates(answers: Iterable[CaseAnswer]) -> dict[str, float]:
    """Choose for each data type the rate of most answers; of equally frequent ones that nearest to the middle."""
    of_type: dict[str, Counter[float]] = {}
    for answer in answers:
        of_type.setdefault(answer.data_type, Counter())[answer.rate_hz] += 1
    chosen = {}
    for data_type, counts in of_type.items():
        rates = sorted(rate for rate, count in counts.items() if count == max(counts.values()))
        chosen[data_type] = rates[(len(rates) - 1) // 2]
    return chosen


def _rates_words(shown: Mapping[str, float]) -> str:
    if len(set(shown.values())) == 1:
        return f"at {format_rate(next(iter(shown.values())))}"
    return ", ".join(
        f"{data_type_label(data_type)} at {format_rate(rate)}" for data_type, rate in shown.items()
    )


def _place_rows(
    place: str,
    cases: Sequence[CaseAnswer],
    columns: Sequence[tuple[str, str]],
    shown: Mapping[str, float],
    late: Mapping[tuple[Case, str], tuple[int, int, int]],
    groups: Mapping[tuple[Case, Case], int | None],
) -> PlaceRows:
    of_message: dict[tuple[str, int, float], list[CaseAnswer]] = {}
    for case in cases:
        of_message.setdefault((case.data_type, case.payload_bytes, case.rate_hz), []).append(case)
    rows: list[SizeRow] = []
    further: list[SizeRow] = []
    for (data_type, payload_bytes, rate_hz), of_modes in of_message.items():
        cells = {
            (case.domain_mode, one.name): _cell(case, one, groups)
            for case in of_modes
            for one in case.contenders
        }
        (rows if rate_hz == shown[data_type] else further).append(
            SizeRow(
                f"{data_type_label(data_type)} {format_size(payload_bytes)}",
                format_rate(rate_hz),
                tuple(cells.get(column) for column in columns),
            )
        )
    thresholds = tuple(_threshold(cases, column, late) for column in columns) if late else ()
    return PlaceRows(place, thresholds, tuple(rows), tuple(further))


def _groups_of(analysis: Analysis) -> dict[tuple[Case, Case], int | None]:
    """Return the group of each case and choice; None where several groups are one of them."""
    cases = with_conditions(analysis.summary).select(*CASE_COLUMNS, CONDITIONS).rows()
    choices = analysis.summary.select(CONTENDER_COLUMNS).rows()
    groups: dict[tuple[Case, Case], int | None] = {}
    for group, key in enumerate(zip(cases, choices, strict=True)):
        groups[key] = None if key in groups else group
    return groups


def _cell(case: CaseAnswer, one: Contender, groups: Mapping[tuple[Case, Case], int | None]) -> SizeCell:
    key = *(getattr(case, field) for field in CASE_COLUMNS), case.conditions
    lost = 1.0 - (1.0 if one.received.value is None else one.received.value)
    return SizeCell(
        p50=_time(one.p50_ns),
        p99=_time(one.p99_ns),
        leads_p50=case.leader_p50 == one.name,
        leads_p99=case.leader_p99 == one.name,
        lost=f"{format_ratio(lost)} lost" if lost > 0 else "",
        group=groups.get((key, tuple(one.setting[column] for column in CONTENDER_COLUMNS))),
    )


def _time(value_ns: float | None) -> str:
    if value_ns is None:
        return MISSING
    return "lost" if math.isinf(value_ns) else format_duration(value_ns)


def _deadline_words(details: Details) -> str:
    if details.deadline_ns is None or not details.freshness.height:
        return ""
    metric = METRIC_LABELS.get(details.deadline_metric, printable(details.deadline_metric)).lower()
    return f"{metric} within {format_duration(details.deadline_ns)}"


def _late_of(analysis: Analysis) -> dict[tuple[Case, str], tuple[int, int, int]]:
    """Count for each case and contender the messages that missed the deadline, were judged, and cannot be judged.

    A message that never left has missed it.
    """
    details = analysis.details
    if not _deadline_words(details):
        return {}
    counts = (
        details.freshness.group_by("group")
        .agg(pl.col("missed", "judged", "unsure").sum())
        .join(analysis.summary.with_row_index("group").select("group", "unsent"), on="group")
        .with_columns(pl.col("missed", "judged") + pl.col("unsent").fill_null(0))
    )
    of_group = {
        row["group"]: (row["missed"], row["judged"], row["unsure"]) for row in counts.iter_rows(named=True)
    }
    keys = with_conditions(analysis.summary).select(*CASE_COLUMNS, CONDITIONS).rows()
    choices = analysis.summary.select(CONTENDER_COLUMNS).rows()
    names = {
        tuple(one.setting[column] for column in CONTENDER_COLUMNS): one.name
        for answer in details.answers
        for one in answer.contenders
    }
    late: dict[tuple[Case, str], tuple[int, int, int]] = {}
    for group, (case, choice) in enumerate(zip(keys, choices, strict=True)):
        if choice in names and group in of_group:
            held = late.get((case, names[choice]), (0, 0, 0))
            missed, judged, unsure = of_group[group]
            late[case, names[choice]] = (held[0] + missed, held[1] + judged, held[2] + unsure)
    return late


def _threshold(
    cases: Sequence[CaseAnswer],
    column: tuple[str, str],
    late: Mapping[tuple[Case, str], tuple[int, int, int]],
) -> Threshold | None:
    """Judge the deadline of one choice: it passes if messages of each size and rate were judged and none is late."""
    mode, name = column
    judged: list[tuple[CaseAnswer, tuple[int, int, int]]] = []
    for case in cases:
        key = *(getattr(case, field) for field in CASE_COLUMNS), case.conditions
        if case.domain_mode == mode and (key, name) in late:
            judged.append((case, late[key, name]))
    if not judged:
        return None
    missing = [(case, missed / (of + unsure)) for case, (missed, of, unsure) in judged if missed]
    if missing:
        worst, share = max(missing, key=lambda one: one[1])
        where = f"{format_size(worst.payload_bytes)} at {format_rate(worst.rate_hz)}"
        return Threshold(
            "fail",
            f"{len(missing)} of {counted(len(judged), 'combination')}, worst {where}: {format_ratio(share)} late",
        )
    unknown = sum(bool(unsure) or not of for _, (_, of, unsure) in judged)
    return (
        Threshold("not known", f"in {unknown} of {counted(len(judged), 'combination')}")
        if unknown
        else Threshold("pass", "")
    )


def _order(answer: CaseAnswer) -> tuple[object, ...]:
    known = [*DATA_TYPES, answer.data_type]
    where = answer.ping_device, answer.relay_device or "", answer.connectivity, answer.conditions
    return *where, known.index(answer.data_type), answer.data_type, answer.payload_bytes, answer.rate_hz
