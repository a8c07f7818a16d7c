"""The instants of messages in UTC, as far as their devices knew it.

UTC follows from a session's reading of both clocks at its start; it is as wrong as the device's clock was then.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import polars as pl
from numpy.typing import NDArray

from dds_trace.tracefile.format.descriptions import Session

from ..model.columns import UTC_COLUMNS
from .exchanges import Exchange
from .pair import MISSING

_SANE_NS = 1 << 61
"""Instants and offsets beyond (73 years) are damaged; two others add up within an int64."""

_STA_UNSYNC = 0x40
"""Bit of the clock's status: nothing has synchronized it (adjtimex(2))."""


def utc_columns(exchanges: Sequence[Exchange], bounds: NDArray[np.int64], measured: pl.DataFrame) -> list[pl.Series]:
    """Return `columns.UTC_COLUMNS` of some exchanges' rows, null where the instant is missing or not of its session."""
    sessions: dict[str, list[Session | None]] = {
        "publish_ns": [exchange.ping for exchange in exchanges],
        "relay_in_ns": [exchange.relay for exchange in exchanges],
    }
    columns = []
    for column, (name, sessions_of_exchanges) in zip(UTC_COLUMNS, sessions.items(), strict=True):
        instants_ns = measured[name].fill_null(MISSING).to_numpy()
        utc_ns = np.full(len(instants_ns), MISSING)
        for session, first, after in zip(sessions_of_exchanges, bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
            if session is None or abs(session.wall_ns(0)) >= _SANE_NS:
                continue
            part = instants_ns[first:after]
            is_valid = (part >= session.monotonic_anchor_ns) & (part < _SANE_NS)
            np.add(part, session.wall_ns(0), out=utc_ns[first:after], where=is_valid)
        columns.append(null_where_missing(column.name, utc_ns).cast(column.dtype))
    return columns


def null_where_missing(name: str, values: NDArray[np.int64]) -> pl.Series:
    series = pl.Series(name, values)
    missing = values == MISSING
    return series.set(pl.Series(missing), None) if missing.any() else series


def is_synchronized(session: Session) -> bool | None:
    """Return whether the kernel's clock was synchronized at the start of the session; None if unknown."""
    clock = session.extra.get("clock")
    begin = clock.get("begin") if isinstance(clock, dict) else None
    status = begin.get("status") if isinstance(begin, dict) else None
    return not status & _STA_UNSYNC if isinstance(status, int) else None


def utc_text(wall_ns: int) -> str:
    """Return an instant in ns since 1970 as ISO 8601 with nine decimals, limited to int64."""
    limited_ns = max(-(2**63) + 1, min(2**63 - 1, wall_ns))
    return f"{np.datetime64(limited_ns, 'ns')}Z"
