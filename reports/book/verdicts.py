"""Verdicts by kind of data: the analyzer's answers (`dds_trace.analyzer.verdicts.answers`) under the names of a report.

The analyzer has judged which intervals overlap; nothing is judged here.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from dds_trace.analyzer.model.names import tell_apart, where_alike
from dds_trace.analyzer.model.setting import parse_setting
from dds_trace.analyzer.statistics.intervals import MIN_RUNS
from dds_trace.analyzer.verdicts.answers import find_headlines
from dds_trace.base.printable import printable
from dds_trace.base.units import counted

from .groups import DATA_TYPES, data_type_label, device_pair, way_words

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from dds_trace.analyzer.model.parameters import ParameterValue
    from dds_trace.analyzer.verdicts.answers import CaseAnswer, Headline

    from .groups import VendorLabels

CLEARLY = (
    "Compared is within one combination of data, size and rate, on the same devices and link. A choice is called fastest only where "
    "its p99 (its median, where a sample is too small for that) lies below that of each of the others by a test of their runs at "
    "95 %, adjusted for their number; lost messages count as infinitely late, and who receives significantly less never leads. With "
    "fewer than three runs, and where the tests do not tell, there is no clear winner. Plain sockets are no middleware and no "
    "contender."
)

WITHIN_ONE_RUN = (
    f"Compared is within one combination of data, size and rate. With fewer than {MIN_RUNS} runs of each nothing is told apart: "
    "runs of equal settings differ by more than the messages within one run can show."
)
"""The rule of a campaign whose every comparison has too few runs."""

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
        data: data type and domain mode, as in `Binary, same domain`.
        mode: domain mode in words.
        cells: number of compared cells.
        wins: winners, the one with most cells first.
        inconclusive: number of cells without a clear winner.
        place: devices, link and conditions, as in `pi-3 → pi-4, wired`: each is judged for itself.
        within_one_run: cells among the inconclusive ones in which a contender has fewer than three runs.
    """

    data: str
    mode: str
    cells: int
    wins: tuple[WinCount, ...]
    inconclusive: int
    place: str = ""
    within_one_run: int = 0


def verdicts_info(answers: Sequence[CaseAnswer], vendors: VendorLabels) -> tuple[DataVerdict, ...]:
    """Give one verdict per kind of data, devices and link with two contenders, in the usual order."""
    contenders = {one.name: one for answer in answers for one in answer.contenders}
    labels = contender_labels(answers, vendors)
    verdicts = []
    for headline in sorted(find_headlines(answers), key=_order):
        if not headline.cases:
            continue
        mode = MODES.get(headline.domain_mode, printable(headline.domain_mode))
        verdicts.append(
            DataVerdict(
                data=f"{data_type_label(headline.data_type)}, {mode}",
                mode=mode,
                cells=headline.cases,
                wins=tuple(
                    WinCount(labels[lead.name], str(contenders[lead.name].setting["vendor"]), lead.cases)
                    for lead in headline.leads
                ),
                inconclusive=headline.inconclusive,
                place=place_label(
                    headline.ping_device, headline.relay_device, headline.connectivity, headline.conditions
                ),
                within_one_run=headline.within_one_run,
            )
        )
    return tuple(verdicts)


_CONDITION_WORDS = {
    "link": "emulated link {}",
    "flows": "{} runs at once",
    "relays": "{} relays",
    "data": "data from {}",
}
"""Key of a condition -> its words."""


def conditions_label(conditions: str) -> str:
    """Put conditions of a setting into words: `emulated link wifi-54(loss=1), 2 runs at once`; empty for none."""
    told = parse_setting(conditions).items()
    return printable(", ".join(_CONDITION_WORDS.get(key, f"{key} {{}}").format(value) for key, value in told))


def place_label(ping_device: str, relay_device: str | None, connectivity: str, conditions: str = "") -> str:
    """Name where something was measured, as in `pi-3 → pi-4, wired, 2 runs at once`."""
    parts = (device_pair(ping_device, relay_device), printable(connectivity), conditions_label(conditions))
    return ", ".join(part for part in parts if part)


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


def combinations(count: int) -> str:
    """Count combinations of data, size and rate in words: `1 combination`, `12 combinations`."""
    return counted(count, "combination")


def _label(vendors: VendorLabels, setting: Mapping[str, ParameterValue]) -> str:
    relay_vendor = setting["relay_vendor"]
    pair = vendors.of_pair(str(setting["vendor"]), None if relay_vendor is None else str(relay_vendor))
    return pair if setting["bridge"] == "none" else f"{pair} {way_words(str(setting['bridge']))}"


def _value(column: str, setting: Mapping[str, ParameterValue]) -> str:
    value = setting[column]
    return printable(f"depth {value}" if column == "depth" else value)


def _order(headline: Headline) -> tuple[object, ...]:
    known = [*DATA_TYPES, headline.data_type]
    place = known.index(headline.data_type)
    relay = headline.relay_device
    where = headline.connectivity, headline.ping_device, relay is None, relay or "", headline.conditions
    return place, headline.data_type, headline.domain_mode != "same", *where
