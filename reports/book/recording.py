"""Who recorded, what was read, and what measuring cost."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.tracefile.units.durations import format_duration
from dds_trace.tracefile.visible import visible

from ..text import format_count
from .groups import VENDORS, known_first, vendor_label

if TYPE_CHECKING:
    from collections.abc import Sequence

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


@dataclass(frozen=True, slots=True)
class OwnCost:
    """What the sessions of one vendor and backend measured when they began; of several the slowest, None if unknown.

    Attributes:
        record_median_ns: to keep one event, with `record_p99_ns`.
        floor_median_ns: a message of a few bytes from a node to itself, with `floor_p99_ns`: nothing that is measured
            through this client library can be faster.
        floor_messages: the fewest messages that a floor rests on.
    """

    vendor: str
    backend: str
    record_median_ns: int | None
    record_p99_ns: int | None
    floor_median_ns: int | None
    floor_p99_ns: int | None
    floor_messages: int | None


def own_costs(analysis: Analysis) -> tuple[OwnCost, ...]:
    """One per vendor and backend whose sessions measured anything, vendors in their usual order."""
    together: dict[tuple[str, str], list[Session]] = {}
    for session in analysis.sessions:
        together.setdefault((session.vendor, session.backend), []).append(session)
    order = known_first({vendor for vendor, _ in together}, VENDORS)
    found = []
    for vendor, backend in sorted(together, key=lambda pair: (order.index(pair[0]), pair[1])):
        sessions = together[vendor, backend]
        cost = OwnCost(
            vendor,
            backend,
            max(_numbers(sessions, "recorder_cost", "record_median_ns"), default=None),
            max(_numbers(sessions, "recorder_cost", "record_p99_ns"), default=None),
            max(_numbers(sessions, "client_library_floor", "median_ns"), default=None),
            max(_numbers(sessions, "client_library_floor", "p99_ns"), default=None),
            min(_numbers(sessions, "client_library_floor", "messages"), default=None),
        )
        if cost.record_median_ns is not None or cost.floor_median_ns is not None:
            found.append(cost)
    return tuple(found)


def recorder_words(costs: Sequence[OwnCost]) -> str:
    """As in `keeping an event took 2.1 us (p99 4 us)`, by vendor where there are several; empty if unknown."""
    said = [(cost, _span(cost.record_median_ns, cost.record_p99_ns)) for cost in costs]
    return _words("keeping an event took", said)


def floor_words(costs: Sequence[OwnCost]) -> str:
    """As in `a message from a node to itself took 400 us (p99 1.2 ms)`, likewise."""
    said = [(cost, _span(cost.floor_median_ns, cost.floor_p99_ns)) for cost in costs]
    return _words("a message from a node to itself took", said)


def _words(what: str, said: Sequence[tuple[OwnCost, str]]) -> str:
    known = [(cost, span) for cost, span in said if span]
    if not known:
        return ""
    if len(said) == 1:
        return f"{what} {known[0][1]}"
    backends = Counter(cost.vendor for cost, _ in said)
    names = [
        vendor_label(cost.vendor) + (f" ({visible(cost.backend)})" if backends[cost.vendor] > 1 else "")
        for cost, _ in known
    ]
    return f"{what}: " + "; ".join(f"{name} {span}" for name, (_, span) in zip(names, known, strict=True))


def _span(median_ns: int | None, p99_ns: int | None) -> str:
    if median_ns is None:
        return ""
    return format_duration(median_ns) + ("" if p99_ns is None else f" (p99 {format_duration(p99_ns)})")


def _numbers(sessions: Sequence[Session], part: str, name: str) -> list[int]:
    """The values of one field, of the sessions that have it: a trace may hold what it likes there."""
    parts = [held for session in sessions if isinstance(held := session.extra.get(part), dict)]
    values = [held.get(name) for held in parts]
    return [
        round(value)
        for value in values
        if isinstance(value, (int, float))
        and not isinstance(value, bool)
        and math.isfinite(value)
        and value >= 0
    ]
