"""The body of each distribution: which share of the messages was in time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ...book.curves import any_curve
from ..figure import Figure, LeftOut

if TYPE_CHECKING:
    from dds_trace.analyzer.analysis import Analysis

NAME = "ecdf"
TITLE = "Share of messages in time (ECDF)"
HOW_TO_READ = (
    "Pick a deadline on the horizontal axis: the curve says which share of the messages that came back met it; "
    "a steep curve is a predictable one."
)


@dataclass(frozen=True, slots=True)
class Ecdf:
    """Whether there are curves; see `PercentileCurve`."""

    any_drawn: bool


def ecdf_info(analysis: Analysis) -> Ecdf:
    """Looks for a group with two messages at least."""
    return Ecdf(any_curve(analysis))


def ecdf_figure(info: Ecdf) -> Figure | LeftOut:
    """One curve per series of the chosen cell."""
    if not info.any_drawn:
        return LeftOut(NAME, TITLE, "no group has two messages that came back.")
    return Figure(NAME, TITLE, HOW_TO_READ, "ecdf", {})
