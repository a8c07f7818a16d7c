"""What the measurement itself costs, beside the results: the recorder's share, and the floor of the client library."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.tracefile.units.durations import format_duration

from ..text import visible
from .groups import VENDORS, known_first, vendor_label

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dds_trace.analyzer.analysis import Analysis
    from dds_trace.tracefile import Session


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
