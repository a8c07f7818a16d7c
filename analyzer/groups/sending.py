"""The frame `sending`: whether each run's ping kept to its schedule, as one late message must not decide."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..pairing.roundtrips import RoundTrips
    from .batch import Batch

    Int64 = NDArray[np.int64]

LATE_NS = 5_000_000
"""T1 - T0 from which on a send is late. A wake-up takes well under 1 ms, and one that misses its timer tick 4 ms at 250 Hz:
what is later waited for a blocked publish, or for a processor."""

_LAST_SHARE = 10
"""The last tenth of a run tells how far it fell behind: its median, so that one late message says nothing."""

_LEAST_MESSAGES = 3

SENDING_SCHEMA: dict[str, type[pl.DataType]] = {
    "group": pl.UInt32,
    "run_id": pl.UInt64,
    "relay_id": pl.UInt32,
    "messages": pl.UInt64,
    "elapsed_ns": pl.Int64,
    "behind_ns": pl.Int64,
    "late": pl.UInt64,
    "late_max_ns": pl.Int64,
}


def sending_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """Tell for each run and relay how its messages were sent.

    Returns:
        Columns of `SENDING_SCHEMA`. `messages` published; `elapsed_ns`: time from the first to the
        last ones at the asked rate, and `behind_ns` by how much later they were sent; null below three messages or
        without a rate;
        `late`: messages with T1 - T0 above `LATE_NS`; `late_max_ns`: the largest T1 - T0, null without T0.
    """
    rows: list[dict[str, object]] = []
    for number, exchange in enumerate(batch.exchanges):
        first, after = roundtrips.bounds[number : number + 2].tolist()
        part = roundtrips.measured.slice(first, after - first)
        waited_ns = (part["publish_ns"] - part["scheduled_ns"]).drop_nulls()
        elapsed_ns, late_ns = held_schedule(part["publish_ns"].to_numpy(), exchange.run.rate_hz)
        rows.append(
            {
                "group": int(batch.group_of_exchange[number]),
                "run_id": exchange.run.run_id,
                "relay_id": exchange.relay_id,
                "messages": len(part),
                "elapsed_ns": elapsed_ns,
                "behind_ns": late_ns,
                "late": int((waited_ns > LATE_NS).sum()),
                "late_max_ns": waited_ns.max(),
            }
        )
    return pl.DataFrame(rows, schema=SENDING_SCHEMA)


def held_schedule(sent_ns: Int64, rate_hz: float) -> tuple[int | None, int | None]:
    """Return the time from the first to the last messages of a run at the asked rate, and by how much later they were sent.

    Args:
        sent_ns: T1 of each message, in order.
        rate_hz: messages a second that were asked for.
    """
    if len(sent_ns) < _LEAST_MESSAGES or rate_hz <= 0:
        return None, None
    last = max(_LEAST_MESSAGES, len(sent_ns) // _LAST_SHARE)
    planned_ns = np.arange(len(sent_ns)) * (1e9 / rate_hz)
    behind_ns = (sent_ns - sent_ns[0]) - planned_ns
    return round(float(np.median(planned_ns[-last:]))), round(float(np.median(behind_ns[-last:])))
