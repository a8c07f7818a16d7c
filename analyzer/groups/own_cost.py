"""The own share of a group: what the nodes of ping and relay take of a round trip, whatever lies between them.

Each session measures it on its own device at the rate of the run, before its node opens: the way of a short message from publish
to callback within one node (`client_library_floor`), and the time of keeping an event (`recorder_cost`).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import polars as pl

if TYPE_CHECKING:
    from dds_trace.tracefile import Session

EVENTS_IN_RELAY = 2
"""Events that are kept while a message is in the relay, T3 and T4; T1 and T2 lie at the ends of the round trip."""


def own_cost_ns(ping: Session, relay: Session | None) -> float | None:
    """Return the time of a round trip that both nodes take themselves, in ns; None where a side did not measure it."""
    if relay is None:
        return None
    parts = [
        _median_ns(ping, "client_library_floor", "median_ns"),
        _median_ns(relay, "client_library_floor", "median_ns"),
        _median_ns(relay, "recorder_cost", "record_median_ns"),
    ]
    there, back, record = parts
    if there is None or back is None:
        return None
    return there + back + EVENTS_IN_RELAY * (record or 0.0)


def own_share() -> pl.Expr:
    """Return the expression of the column `own_share` from `own_cost_ns` and `rtt_p50_ns`."""
    return pl.when(pl.col("rtt_p50_ns") > 0).then(pl.col("own_cost_ns") / pl.col("rtt_p50_ns"))


def _median_ns(session: Session, part: str, name: str) -> float | None:
    """Return a number of a session's field; None for what a foreign trace may hold there instead."""
    held = session.extra.get(part)
    value = held.get(name) if isinstance(held, dict) else None
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not math.isfinite(value):
        return None
    return float(value) if value >= 0 else None
