"""Verdicts by kind of data: the analyzer's answers (`dds_trace.analyzer.verdicts.answers`) under the names of a report.

The analyzer has judged which intervals overlap; nothing is judged here.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from dds_trace.analyzer import find_headlines
from dds_trace.analyzer.model.names import tell_apart, where_alike
from dds_trace.tracefile.units.counts import counted
from dds_trace.tracefile.visible import visible

from .groups import DATA_TYPES, data_type_label

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from dds_trace.analyzer import CaseAnswer, Headline
    from dds_trace.analyzer.model.parameters import ParameterValue

    from .groups import VendorLabels

CLEARLY = (
    "A cell is one data type, size and rate. One is called clearly fastest only where its p99 (its median, where a sample is too "
    "small for that) lies below that of each of the others by a test of their runs at 95 %, adjusted for their number; lost "
    "messages count as infinitely late, and who receives significantly less never leads. With fewer than three runs, and where the "
    "tests do not tell, the answer is inconclusive. Plain sockets are the floor beneath every middleware and no contender."
)

MODES = {"same": "same domain", "different": "different domains"}

# Columns that extend the labels of contenders with equal labels, the most telling first.
_FURTHER = (
    "backend",
    "relay_backend",
    "rmw",
    "reliability",
    "durability",
    "history",
    "depth",
    "serialization",
)


@dataclass(frozen=True, slots=True)
class WinCount:
    """Number of cells in which a contender was clearly faster than every other; `vendor` determines its colour."""

    contender: str
    vendor: str
    cells: int


@dataclass(frozen=True, slots=True)
class DataVerdict:
    """Result for one kind of data, over all cells in which at least two contenders were measured.

    Attributes:
        data: data type, domain mode, and the link if several were measured, as in `Binary, same domain`.
        mode: domain mode in words.
        cells: number of compared cells.
        wins: winners, the one with most cells first.
        inconclusive: number of cells without a clear winner.
    """

    data: str
    mode: str
    cells: int
    wins: tuple[WinCount, ...]
    inconclusive: int

    @property
    def sentence(self) -> str:
        """DataVerdict in one sentence."""
        if not self.wins:
            return f"inconclusive in all {cells_label(self.cells)}." if self.cells > 1 else "inconclusive."
        parts = [
            f"{win.contender} is clearly fastest in {win.cells} of {cells_label(self.cells)}"
            for win in self.wins
        ]
        if self.inconclusive:
            parts.append(f"{self.inconclusive} inconclusive")
        return "; ".join(parts) + "."


def verdicts_info(answers: Sequence[CaseAnswer], vendors: VendorLabels) -> tuple[DataVerdict, ...]:
    """Give one verdict per kind of data with two contenders, in the usual order of data types and domain modes."""
    contenders = {one.name: one for answer in answers for one in answer.contenders}
    labels = contender_labels(answers, vendors)
    several_links = len({answer.connectivity for answer in answers}) > 1
    verdicts = []
    for headline in sorted(find_headlines(answers), key=_order):
        if not headline.cases:
            continue
        mode = MODES.get(headline.domain_mode, visible(headline.domain_mode))
        link = [visible(headline.connectivity)] if several_links else []
        verdicts.append(
            DataVerdict(
                data=", ".join([data_type_label(headline.data_type), mode, *link]),
                mode=mode,
                cells=headline.cases,
                wins=tuple(
                    WinCount(labels[lead.name], str(contenders[lead.name].setting["vendor"]), lead.cases)
                    for lead in headline.leads
                ),
                inconclusive=headline.inconclusive,
            )
        )
    return tuple(verdicts)


def contender_labels(answers: Sequence[CaseAnswer], vendors: VendorLabels) -> dict[str, str]:
    """Label each contender by vendor and bridge, and by more columns where labels would be equal.

    Returns:
        Name in the answers -> label.
    """
    settings = {one.name: one.setting for answer in answers for one in answer.contenders}
    parts = [(where_alike, partial(_value, column)) for column in _FURTHER]
    return dict(
        zip(settings, tell_apart(list(settings.values()), partial(_label, vendors), parts), strict=True)
    )


def cells_label(count: int) -> str:
    """Count cells in words: `1 cell`, `12 cells`."""
    return counted(count, "cell")


def _label(vendors: VendorLabels, setting: Mapping[str, ParameterValue]) -> str:
    relay_vendor = setting["relay_vendor"]
    pair = vendors.of_pair(str(setting["vendor"]), None if relay_vendor is None else str(relay_vendor))
    return pair if setting["bridge"] == "none" else f"{pair} via {visible(setting['bridge'])}"


def _value(column: str, setting: Mapping[str, ParameterValue]) -> str:
    value = setting[column]
    return visible(f"depth {value}" if column == "depth" else value)


def _order(headline: Headline) -> tuple[int, str, bool, str]:
    known = [*DATA_TYPES, headline.data_type]
    place = known.index(headline.data_type)
    return place, headline.data_type, headline.domain_mode != "same", headline.connectivity
