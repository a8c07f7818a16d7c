"""Who recorded and what was read: the tables at the end of a report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from reports.groups import vendor_label
from reports.text import format_count, visible

if TYPE_CHECKING:
    from analyzer.analysis import Analysis


@dataclass(frozen=True, slots=True)
class RecordTable:
    """A titled table of strings, each `visible` and not yet escaped for a medium."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def record_tables(analysis: Analysis) -> tuple[RecordTable, ...]:
    """Sessions with the surroundings that their recorders found, and the files."""
    sessions = RecordTable(
        "Recording sessions",
        ("Device", "Role", "Vendor", "Backend", "RMW", "Domain", "Link", "Dropped events", "End", "Host"),
        tuple(
            (
                visible(one.device),
                visible(one.role),
                vendor_label(one.vendor),
                visible(one.backend),
                visible(one.rmw or "-"),
                str(one.domain_id),
                visible(one.connectivity),
                format_count(one.dropped_events),
                "clean" if one.state == "closed" else "cut off",
                ", ".join(f"{visible(name)} {visible(value)}" for name, value in one.host.items()),
            )
            for one in analysis.sessions
        ),
    )
    sources = RecordTable(
        "Files",
        ("File", "Status", "Events", "Detail"),
        tuple(
            (visible(one.path), visible(one.status), format_count(one.events), visible(one.detail))
            for one in analysis.sources
        ),
    )
    return tuple(table for table in (sessions, sources) if table.rows)
