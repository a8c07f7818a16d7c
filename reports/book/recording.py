"""Who recorded and what was read: the tables at the end of a report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..text import format_count, visible
from .groups import vendor_label

if TYPE_CHECKING:
    from dds_trace.analyzer.analysis import Analysis
    from dds_trace.tracefile import Session

MOST_ROWS = 200
"""Of a table; a campaign of 500 cells has two sessions and two files a cell, and the JSON report has them all."""

_FLEETING = "wifi"
"""The part of a fingerprint that is never twice the same; the figure of the load has it over time."""


@dataclass(frozen=True, slots=True)
class RecordTable:
    """A titled table of strings, each `visible` and not yet escaped for a medium.

    Attributes:
        count: what there is of it in all.
        left_out: rows beyond `MOST_ROWS`.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    count: int
    left_out: int


def record_tables(analysis: Analysis) -> tuple[RecordTable, ...]:
    """Sessions with the surroundings that their recorders found, and the files."""
    return tuple(table for table in (_sessions(analysis), _sources(analysis)) if table.rows)


def _sessions(analysis: Analysis) -> RecordTable:
    """A row for all sessions that were alike; a sweep starts a process a cell."""
    alike: dict[tuple[str, ...], list[Session]] = {}
    for one in analysis.sessions:
        surroundings = (
            f"{visible(name)} {visible(value)}" for name, value in one.host.items() if name != _FLEETING
        )
        key = (
            visible(one.device),
            visible(one.role),
            vendor_label(one.vendor),
            visible(one.backend),
            visible(one.rmw or "-"),
            str(one.domain_id),
            visible(one.connectivity),
            "clean" if one.state == "closed" else "cut off",
            ", ".join(surroundings),
        )
        alike.setdefault(key, []).append(one)
    rows = [
        (*key[:-2], format_count(len(held)), format_count(sum(one.dropped_events for one in held)), *key[-2:])
        for key, held in alike.items()
    ]
    columns = (
        "Device",
        "Role",
        "Vendor",
        "Backend",
        "RMW",
        "Domain",
        "Link",
        "Sessions",
        "Dropped events",
        "End",
        "Host",
    )
    return _table("Recording sessions", columns, rows, len(analysis.sessions))


def _sources(analysis: Analysis) -> RecordTable:
    """The files, those that were not simply read first."""
    ordered = sorted(analysis.sources, key=lambda one: one.status == "read")
    rows: list[tuple[str, ...]] = [
        (visible(one.path), visible(one.status), format_count(one.events), visible(one.detail))
        for one in ordered
    ]
    return _table("Files", ("File", "Status", "Events", "Detail"), rows, len(rows))


def _table(title: str, columns: tuple[str, ...], rows: list[tuple[str, ...]], count: int) -> RecordTable:
    return RecordTable(title, columns, tuple(rows[:MOST_ROWS]), count, max(0, len(rows) - MOST_ROWS))
