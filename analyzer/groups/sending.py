"""The frame `sending`: whether the ping of each run kept its schedule."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ..model.metrics import frame_schema
from ..pairing.roundtrips import RoundTrips
from ..statistics.percentiles import quantile_of
from .batch import Batch, filled, is_present

Int64 = NDArray[np.int64]


LATE_NS = 5_000_000
"""T1 - T0 of a late send: a wake-up that misses a timer tick at 250 Hz takes 4 ms."""

STILL_NS = 1_000_000_000
"""Time without a due message in which a ping stood still: ten times the default `max_blocking_time` of DDS."""

_LAST_SHARE = 10
"""A run's lag is the median of its last tenth, which one late message does not move."""

_LEAST_MESSAGES = 3
"""Fewest messages of that tenth, so that one late message does not decide."""

SENDING_SCHEMA = frame_schema(
    "group:u32 run_id:u64 relay_id:u32 messages:u64 elapsed_ns:i64 behind_ns:i64 late:u64 late_max_ns:i64 "
    "late_p99_ns:f64 still:u32 still_ns:i64 still_end_ns:i64"
)


def sending_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """Describe for each run and relay how its messages were sent.

    `elapsed_ns`, `behind_ns`: see `schedule_lag`; `late` messages with T1 - T0 above `LATE_NS` and `late_max_ns` without those
    that a stand-still delayed; `still` stand-stills, the longest of `still_ns` until `still_end_ns`, ping's clock.
    """
    rows: list[dict[str, object]] = []
    scheduled = roundtrips.measured["scheduled_ns"]
    is_planned, scheduled_ns = is_present(scheduled), filled(scheduled)
    all_sent_ns = roundtrips.measured["publish_ns"].to_numpy()
    for number, exchange in enumerate(batch.exchanges):
        here = slice(*roundtrips.bounds[number : number + 2].tolist())
        sent_ns, planned = all_sent_ns[here], is_planned[here]
        due_ns, left_ns = scheduled_ns[here][planned], sent_ns[planned]
        stood = find_stand_stills(due_ns, left_ns)
        waited_ns = left_ns - due_ns
        free_ns = waited_ns[~stood.delayed]
        is_live = str(exchange.run.extra.get("data_source", "")).startswith("topic:")  # its rate is a guess
        elapsed_ns, lag_ns = (None, None) if is_live else schedule_lag(sent_ns, exchange.run.rate_hz)
        rows.append(
            {
                "group": int(batch.group_of_exchange[number]),
                "run_id": exchange.run.run_id,
                "relay_id": exchange.relay_id,
                "messages": len(sent_ns),
                "elapsed_ns": elapsed_ns,
                "behind_ns": lag_ns,
                "late": int(np.count_nonzero(free_ns > LATE_NS)),
                "late_max_ns": int(free_ns.max()) if len(free_ns) else None,
                "late_p99_ns": quantile_of(np.sort(waited_ns), 0.99) if len(waited_ns) else None,
                "still": len(stood.lasted_ns),
                "still_ns": max(stood.lasted_ns, default=None),
                "still_end_ns": stood.longest_end_ns,
            }
        )
    return pl.DataFrame(rows, schema=SENDING_SCHEMA)


@dataclass(frozen=True, slots=True, eq=False)
class StandStills:
    """The times of `STILL_NS` or longer in which a ping sent nothing though a message was due.

    `delayed`: whether each message left late because of one, until the ping had caught up.
    """

    lasted_ns: tuple[int, ...]
    longest_end_ns: int | None
    delayed: NDArray[np.bool_]


def find_stand_stills(scheduled_ns: Int64, sent_ns: Int64) -> StandStills:
    """Find the stand-stills of a run from T0 and T1 of its messages, in order."""
    delayed = np.zeros(len(sent_ns), np.bool_)
    due_ns = scheduled_ns.copy()
    due_ns[1:] = np.maximum(due_ns[1:], sent_ns[:-1])
    stood = np.flatnonzero(sent_ns - due_ns >= STILL_NS)
    for start in stood.tolist():
        on_time = np.flatnonzero(sent_ns[start:] - scheduled_ns[start:] <= LATE_NS)
        delayed[start : start + int(on_time[0]) if len(on_time) else None] = True
    lasted_ns = (sent_ns - due_ns)[stood]
    longest_end_ns = int(sent_ns[stood[lasted_ns.argmax()]]) if len(stood) else None
    return StandStills(tuple(lasted_ns.tolist()), longest_end_ns, delayed)


def schedule_lag(sent_ns: Int64, rate_hz: float) -> tuple[int | None, int | None]:
    """Return the planned time from the first message to the last tenth, and how much later it was sent; None if unknown."""
    if len(sent_ns) < _LEAST_MESSAGES or rate_hz <= 0:
        return None, None
    last = max(_LEAST_MESSAGES, len(sent_ns) // _LAST_SHARE)
    planned_ns = np.arange(len(sent_ns) - last, len(sent_ns)).astype(np.float64) * (1e9 / rate_hz)
    lag_ns = np.sort((sent_ns[-last:] - sent_ns[0]) - planned_ns)
    return round(quantile_of(planned_ns, 0.5)), round(quantile_of(lag_ns, 0.5))
