"""Who recorded, what was read, and what measuring cost."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.analyzer.model.applied import (
    SHARED_MEMORY,
    UNKNOWN,
    congestion_controls,
    payload_path,
    udp_receive_buffer_bytes,
)
from dds_trace.tracefile.units.durations import format_duration
from dds_trace.tracefile.visible import visible

from ..text import format_count
from .groups import VENDORS, known_first, vendor_labels

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dds_trace.analyzer.analysis import Analysis
    from dds_trace.tracefile import Session

    from .groups import VendorLabels


MOST_ROWS = 200
"""Most rows of a table. A campaign of 500 cells has 1,000 sessions and files; the JSON report lists them all."""

_FLEETING = "wifi"
"""Part of a fingerprint that differs between any two sessions; the figure of the load shows it over time."""


@dataclass(frozen=True, slots=True)
class RecordTable:
    """Table of strings that are `visible` but not escaped for a format.

    Attributes:
        count: number of sessions or files, including those left out.
        left_out: number of rows beyond `MOST_ROWS`.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    count: int
    left_out: int


def record_tables(analysis: Analysis) -> tuple[RecordTable, ...]:
    """Tabulate the sessions with their environment, and the files."""
    return tuple(table for table in (_sessions(analysis), _sources(analysis)) if table.rows)


def _sessions(analysis: Analysis) -> RecordTable:
    """Tabulate the sessions; those that were alike share a row, because a sweep starts one process per cell."""
    alike: dict[tuple[str, ...], list[Session]] = {}
    vendors = vendor_labels(analysis)
    for one in analysis.sessions:
        surroundings = [
            f"{visible(name)} {visible(value)}" for name, value in one.host.items() if name != _FLEETING
        ]
        key = (
            visible(one.device),
            visible(one.role),
            vendors.of(one.vendor),
            visible(one.backend),
            visible(one.rmw or "-"),
            str(one.domain_id),
            visible(one.connectivity),
            "clean" if one.state == "closed" else "cut off",
            ", ".join([*surroundings, *_applied_words(one)]),
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


def _applied_words(session: Session) -> list[str]:
    """Describe what the process was seen to use; nothing of an older session, which does not tell."""
    path = payload_path(session)
    if path is None:
        return []
    ways = {SHARED_MEMORY: "shared memory", UNKNOWN: "an unknown way"}
    buffer_bytes = udp_receive_buffer_bytes(session)
    buffers = (
        [] if buffer_bytes is None else [f"UDP receive buffer as granted {format_count(buffer_bytes)} B"]
    )
    controls = [f"TCP by {visible(name)}" for name in congestion_controls(session)]
    return [f"payload carried by {ways.get(path, visible(path))}", *controls, *buffers]


def _sources(analysis: Analysis) -> RecordTable:
    """Tabulate the files, those with a problem first."""
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
    """Cost of measuring with one vendor and backend: the slowest of its sessions, None if no session measured it.

    Attributes:
        record_median_ns: median time to record one event; `record_p99_ns` likewise.
        floor_median_ns: median time of a short message from a node to itself, the floor of every latency through this
            client library; `floor_p99_ns` likewise.
        floor_messages: smallest number of messages behind a floor.
    """

    vendor: str
    backend: str
    record_median_ns: int | None
    record_p99_ns: int | None
    floor_median_ns: int | None
    floor_p99_ns: int | None
    floor_messages: int | None


def own_costs(analysis: Analysis) -> tuple[OwnCost, ...]:
    """Collect the costs of each vendor and backend whose sessions measured them."""
    together: dict[tuple[str, str], list[Session]] = {}
    for session in analysis.sessions:
        together.setdefault((session.vendor, session.backend), []).append(session)
    order = known_first({vendor for vendor, _ in together}, VENDORS)
    costs = []
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
            costs.append(cost)
    return tuple(costs)


def recorder_words(costs: Sequence[OwnCost], vendors: VendorLabels) -> str:
    """Describe the recorder's cost, by vendor if there are several: `keeping an event took 2.1 us (p99 4 us)`."""
    said = [(cost, _span(cost.record_median_ns, cost.record_p99_ns)) for cost in costs]
    return _words("keeping an event took", said, vendors)


def floor_words(costs: Sequence[OwnCost], vendors: VendorLabels) -> str:
    """Describe the client library's floor: `a message from a node to itself took 400 us (p99 1.2 ms)`."""
    said = [(cost, _span(cost.floor_median_ns, cost.floor_p99_ns)) for cost in costs]
    return _words("a message from a node to itself took", said, vendors)


def _words(what: str, said: Sequence[tuple[OwnCost, str]], vendors: VendorLabels) -> str:
    known = [(cost, span) for cost, span in said if span]
    if not known:
        return ""
    if len(said) == 1:
        return f"{what} {known[0][1]}"
    backends = Counter(cost.vendor for cost, _ in said)
    names = [
        vendors.of(cost.vendor) + (f" ({visible(cost.backend)})" if backends[cost.vendor] > 1 else "")
        for cost, _ in known
    ]
    return f"{what}: " + "; ".join(f"{name} {span}" for name, (_, span) in zip(names, known, strict=True))


def _span(median_ns: int | None, p99_ns: int | None) -> str:
    if median_ns is None:
        return ""
    return format_duration(median_ns) + ("" if p99_ns is None else f" (p99 {format_duration(p99_ns)})")


def _numbers(sessions: Sequence[Session], part: str, name: str) -> list[int]:
    """Collect the finite, non-negative values of one field of the sessions; foreign traces may hold anything there."""
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
