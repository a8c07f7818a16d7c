"""The instants of messages in UTC, as far as the devices that recorded them knew it.

A session reads its device's two clocks at one instant, when it starts, and all that it records is told by the monotonic one. So the
wall clock of an event is that of this one reading: the same for all events of the session, whatever NTP or an operator does
to the wall clock later. It is as far from UTC as the device's clock was then, which no trace can tell; a session says whether its
kernel held the clock to be synchronized (`adjtimex`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from ..model.columns import UTC_COLUMNS
from .pair import MISSING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from dds_trace.tracefile.format.descriptions import Session

    from .exchanges import Exchange

_SANE_NS = 1 << 61
"""Instants and offsets beyond (73 years) are damage, and have no UTC; the sum of two others fits into an int64."""

_STA_UNSYNC = 0x40
"""Bit of the kernel's clock status: nothing has synchronized it (adjtimex(2))."""


def utc_columns(
    exchanges: Sequence[Exchange], bounds: NDArray[np.int64], stamps: Mapping[str, NDArray[np.int64]]
) -> list[pl.Series]:
    """Return the columns `columns.UTC_COLUMNS` of the rows of some exchanges.

    Null where the instant is missing, and where it lies before its session's start: then that session is not the one
    that recorded it, or the device has started again in between.

    Args:
        exchanges: in the order of their rows.
        bounds: exchange i has the rows `bounds[i]` to `bounds[i + 1]` (not included).
        stamps: `publish_ns` and `relay_in_ns` of each row, `pair.MISSING` where there is none.
    """
    sessions: dict[str, list[Session | None]] = {
        "publish_ns": [exchange.ping for exchange in exchanges],
        "relay_in_ns": [exchange.relay for exchange in exchanges],
    }
    columns = []
    for column, (name, of_exchange) in zip(UTC_COLUMNS, sessions.items(), strict=True):
        instants_ns = stamps[name]
        utc_ns = np.full(len(instants_ns), MISSING)
        for session, first, after in zip(of_exchange, bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
            if session is None or abs(session.wall_ns(0)) >= _SANE_NS:
                continue
            here = instants_ns[first:after]
            known = (here >= session.monotonic_anchor_ns) & (here < _SANE_NS)
            np.add(here, session.wall_ns(0), out=utc_ns[first:after], where=known)
        series = pl.Series(column.name, utc_ns)
        missing = utc_ns == MISSING
        if missing.any():
            series = series.set(pl.Series(missing), None)
        columns.append(series.cast(column.dtype))
    return columns


def is_synchronized(session: Session) -> bool | None:
    """Return whether the kernel held a session's wall clock to be synchronized when it began; None where nobody knows."""
    clock = session.extra.get("clock")
    begin = clock.get("begin") if isinstance(clock, dict) else None
    status = begin.get("status") if isinstance(begin, dict) else None
    return not status & _STA_UNSYNC if isinstance(status, int) else None


def utc_text(wall_ns: int) -> str:
    """Return an instant in ns since 1970 as ISO 8601 with nine decimals; the last one that an int64 holds if it is later."""
    held_ns = max(-(2**63) + 1, min(2**63 - 1, wall_ns))
    return f"{np.datetime64(held_ns, 'ns')}Z"
