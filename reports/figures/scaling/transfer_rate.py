"""The paper's transfer rate, against what the ping was asked to send."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ...book.groups import data_type_label
from ...book.values import values_info
from ..figure import Figure, LeftOut
from ..panels import Panel, panels_info, panels_plan

if TYPE_CHECKING:
    from dds_trace.analyzer.analysis import Analysis

NAME = "transfer_rate"
TITLE = "Transfer rate against offered load"
HOW_TO_READ = (
    "Marks on the dashed diagonal carried all that was offered (size times rate); where marks leave it to the right, "
    "the way was full."
)


@dataclass(frozen=True, slots=True)
class TransferRate:
    """One panel per data type; x is the offered load in bytes per second. Only groups with a transfer rate."""

    panels: tuple[Panel, ...]


def transfer_rate_info(analysis: Analysis) -> TransferRate:
    """Every group, over payload bytes times rate."""
    rates = values_info(analysis).plain["transfer_rate_bytes_per_s"]
    return TransferRate(
        panels_info(
            analysis,
            key=lambda cell, _: cell.data_type,
            title=lambda cell, _: data_type_label(cell.data_type),
            x=lambda cell: cell.payload_bytes * cell.rate_hz,
            drawn=lambda group: rates[group] is not None,
        )
    )


def transfer_rate_figure(info: TransferRate) -> Figure | LeftOut:
    """Marks on two log axes with the diagonal."""
    if not info.panels:
        return LeftOut(NAME, TITLE, "no group has the two messages that a transfer rate takes.")
    return Figure(NAME, TITLE, HOW_TO_READ, "load", panels_plan(info.panels))
