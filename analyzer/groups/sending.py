"""The frame `sending`: whether each run's ping kept to its schedule, as one late message must not decide."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from ..statistics.percentiles import quantile_of
from .batch import filled, is_present

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..pairing.roundtrips import RoundTrips
    from .batch import Batch

    Int64 = NDArray[np.int64]

LATE_NS = 5_000_000
"""T1 - T0 from which on a send is late. A wake-up takes well under 1 ms, and one that misses its timer tick 4 ms at 250 Hz:
what is later waited for a blocked publish, or for a processor."""

STILL_NS = 1_000_000_000
"""Time without a message, though one was due, from which on a ping stood still: ten times what a reliable writer blocks by
default (`max_blocking_time`, 100 ms in the DDS specification), and no scheduler keeps a ready thread waiting so long."""

_LAST_SHARE = 10
"""The last tenth of a run tells how far it fell behind: its median, so that one late message says nothing."""

_LEAST_MESSAGES = 3
"""Messages of that tenth at least, so that their median leaves one late message out."""

SENDING_SCHEMA: dict[str, type[pl.DataType]] = {
    "group": pl.UInt32,
    "run_id": pl.UInt64,
    "relay_id": pl.UInt32,
    "messages": pl.UInt64,
    "elapsed_ns": pl.Int64,
    "behind_ns": pl.Int64,
    "late": pl.UInt64,
    "late_max_ns": pl.Int64,
    "late_p99_ns": pl.Float64,
    "still": pl.UInt32,
    "still_ns": pl.Int64,
    "still_end_ns": pl.Int64,
}


def sending_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """Tell for each run and relay how its messages were sent.

    Returns:
        Columns of `SENDING_SCHEMA`. `messages` published; `elapsed_ns`: time from the first to the
        last ones at the asked rate, and `behind_ns` by how much later they were sent; null below three messages or
        without a rate;
        `late`: messages with T1 - T0 above `LATE_NS`, but for those that a stand-still held up; `late_max_ns`: the largest
        T1 - T0 of all that none held up, and `late_p99_ns` the 99th percentile of all, null without T0; `still`: times that the ping stood
        still for `STILL_NS` or longer, the longest of which took `still_ns` and ended at `still_end_ns`, ping's
        monotonic clock; null without one.
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
        free_ns = waited_ns[~stood.held_up]
        elapsed_ns, late_ns = held_schedule(sent_ns, exchange.run.rate_hz)
        rows.append(
            {
                "group": int(batch.group_of_exchange[number]),
                "run_id": exchange.run.run_id,
                "relay_id": exchange.relay_id,
                "messages": len(sent_ns),
                "elapsed_ns": elapsed_ns,
                "behind_ns": late_ns,
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
    """The times in which a ping sent nothing though a message was due.

    Attributes:
        lasted_ns: how long each took.
        longest_end_ns: when the longest one ended, ping's monotonic clock; None without one.
        held_up: whether each message left late for one of them, until the ping had caught up, bool.
    """

    lasted_ns: tuple[int, ...]
    longest_end_ns: int | None
    held_up: NDArray[np.bool_]


def find_stand_stills(scheduled_ns: Int64, sent_ns: Int64) -> StandStills:
    """Return the times of `STILL_NS` or longer in which nothing was sent though a message was due.

    Args:
        scheduled_ns: T0 of each message.
        sent_ns: T1 of each message, in order.
    """
    held_up = np.zeros(len(sent_ns), np.bool_)
    due_ns = scheduled_ns.copy()
    due_ns[1:] = np.maximum(due_ns[1:], sent_ns[:-1])
    stood = np.flatnonzero(sent_ns - due_ns >= STILL_NS)
    for position in stood.tolist():
        on_time = np.flatnonzero(sent_ns[position:] - scheduled_ns[position:] <= LATE_NS)
        held_up[position : position + int(on_time[0]) if len(on_time) else None] = True
    lasted_ns = (sent_ns - due_ns)[stood]
    longest_end_ns = int(sent_ns[stood[lasted_ns.argmax()]]) if len(stood) else None
    return StandStills(tuple(lasted_ns.tolist()), longest_end_ns, held_up)


def held_schedule(sent_ns: Int64, rate_hz: float) -> tuple[int | None, int | None]:
    """Return the time from the first to the last messages of a run at the asked rate, and by how much later they were sent.

    Args:
        sent_ns: T1 of each message, in order.
        rate_hz: messages a second that were asked for.
    """
    if len(sent_ns) < _LEAST_MESSAGES or rate_hz <= 0:
        return None, None
    last = max(_LEAST_MESSAGES, len(sent_ns) // _LAST_SHARE)
    planned_ns = np.arange(len(sent_ns) - last, len(sent_ns)).astype(np.float64) * (1e9 / rate_hz)
    behind_ns = np.sort((sent_ns[-last:] - sent_ns[0]) - planned_ns)
    return round(quantile_of(planned_ns, 0.5)), round(quantile_of(behind_ns, 0.5))
