"""Counts of each exchange: messages, losses, impossible times, spans of time."""

from __future__ import annotations

import numpy as np
import polars as pl
from numpy.typing import NDArray

from dds_trace.tracefile.format.descriptions import Run
from dds_trace.tracefile.format.events import EventColumns

from .pair import LOSSES, MISSING, OUTCOMES, Outcome, PairedMessages, Published, chosen_of

COUNT_SCHEMA: dict[str, type[pl.DataType]] = {
    "published": pl.Int64,
    "received": pl.Int64,
    **dict.fromkeys(LOSSES, pl.Int64),
    "duplicates": pl.Int64,
    "duplicated": pl.Int64,
    "second_source": pl.Int64,
    "unclear": pl.Int64,
    "reordered": pl.Int64,
    "relay_gaps": pl.Int64,
    "early": pl.Int64,
    "unscheduled": pl.Int64,
    "negative_rtt": pl.Int64,
    "negative_intermediate": pl.Int64,
    "negative_latency": pl.Int64,
    "publish_span_ns": pl.Int64,
    "relay_span_ns": pl.Int64,
    "reply_span_ns": pl.Int64,
    "relayed": pl.Int64,
    "replied": pl.Int64,
    "orphans": pl.Int64,
    "with_warmup": pl.Int64,
    "repeated": pl.Int64,
    "least_payload_bytes": pl.Int64,
    "most_payload_bytes": pl.Int64,
    "unsent": pl.Int64,
    "in_flight": pl.Int64,
    "absent": pl.Int64,
    "outlived": pl.Int64,
    "longest_gap_ns": pl.Int64,
    "sent": pl.Int64,
    "reached": pl.Int64,
    "resized": pl.Int64,
    "least_reply_bytes": pl.Int64,
    "most_reply_bytes": pl.Int64,
}
"""Columns of the frame `counts`, one row per exchange; all i64.

`published`, `received`, `lost_*`, `duplicates`, `reordered`: as in the summary. `duplicated`: messages with duplicates; `second_source`,
`unclear`: these of `PairedMessages`. `relay_gaps`: replies without T3 or T4.
`early`: replies with T2 below T4, which one clock cannot read.
`unscheduled`: messages without T0. `negative_*`: times below zero. `publish_span_ns`, `relay_span_ns`, `reply_span_ns`: first
to last T1, first T3 to last T4, first to last T2, null without both. `relayed`, `replied`: messages with T3, with T2.
`orphans`: T2, T3 and T4 of counted messages without T1. `with_warmup`: messages of the run with a T1, warm-up included;
`repeated`: T1 beyond the first of their message; `least_payload_bytes`, `most_payload_bytes`: of its T1. `unsent`: messages
due and never published. `in_flight`: messages without a row: the ping was killed before their fate was known.
`absent`: messages without a row as the relay was not there (all three `roundtrips.py`). `outlived`: lost messages that left
between two arrivals that are further apart than a reliable history keeps a message; `longest_gap_ns`: the longest such time.
`sent`, `reached`: messages with T1, and of these with T3, also those that were not to be sent back, as the first two spans have them.
`resized`: T2 of another size than was sent, or requested of a call; `least_reply_bytes`, `most_reply_bytes`: of these.
"""


def count_messages(
    published: Published,
    paired: PairedMessages,
    *,
    unsent: int = 0,
    in_flight: int = 0,
    absent: int = 0,
    history_ns: float | None = None,
) -> dict[str, int | None]:
    t0, t1, t2 = published.scheduled_ns, published.publish_ns, paired.receive_ns
    t3, t4 = paired.relay_in_ns, paired.relay_out_ns
    replied, relayed, returned = t2 != MISSING, t3 != MISSING, t4 != MISSING
    through = relayed & returned
    rtt_ns, intermediate_ns = t2 - t1, t4 - t3
    replies_ns = chosen_of(replied, t2)
    gaps = [
        _beyond_history(t1, arrivals_ns, paired.outcome == OUTCOMES.index(loss), history_ns)
        for arrivals_ns, loss in ((t3, Outcome.LOST_OUTBOUND), (t2, Outcome.LOST_RETURN))
    ]
    outcomes = dict(zip(OUTCOMES, np.bincount(paired.outcome, minlength=len(OUTCOMES)).tolist(), strict=True))
    return {
        "published": len(published),
        "received": outcomes[Outcome.COMPLETED],
        **{loss: outcomes[Outcome(loss)] for loss in LOSSES},
        "duplicates": int(paired.duplicates.sum()),
        "duplicated": np.count_nonzero(paired.duplicates),
        "second_source": np.count_nonzero(paired.second_source),
        "unclear": np.count_nonzero(paired.unclear),
        "reordered": np.count_nonzero(paired.reordered),
        "relay_gaps": np.count_nonzero(replied & ~through),
        "early": np.count_nonzero(replied & returned & (t2 < t4)),
        "unscheduled": np.count_nonzero(t0 == MISSING),
        "negative_rtt": np.count_nonzero(replied & (rtt_ns < 0)),
        "negative_intermediate": np.count_nonzero(through & (intermediate_ns < 0)),
        "negative_latency": np.count_nonzero(replied & through & (rtt_ns - intermediate_ns < 0)),
        "publish_span_ns": _span_ns(t1, t1),
        "relay_span_ns": _span_ns(chosen_of(relayed, t3), chosen_of(returned, t4)),
        "reply_span_ns": _span_ns(replies_ns, replies_ns),
        "relayed": np.count_nonzero(relayed),
        "replied": np.count_nonzero(replied),
        "orphans": paired.orphans,
        "with_warmup": published.with_warmup,
        "repeated": published.repeated,
        "least_payload_bytes": published.payload_range_bytes[0],
        "most_payload_bytes": published.payload_range_bytes[1],
        "unsent": unsent,
        "in_flight": in_flight,
        "absent": absent,
        "outlived": sum(lost for lost, _ in gaps),
        "longest_gap_ns": max(longest_ns for _, longest_ns in gaps),
        "sent": len(published),
        "reached": np.count_nonzero(relayed),
    }


def count_all(t1: EventColumns, t3: EventColumns, warmup_messages: int) -> dict[str, int | None]:
    first = np.uint64(warmup_messages)
    t1, t3 = t1.take(t1.sequence >= first), t3.take(t3.sequence >= first)
    return {
        "sent": len(np.unique(t1.sequence)),
        "reached": len(np.intersect1d(t1.sequence, t3.sequence)),
        "publish_span_ns": _span_ns(t1.monotonic_ns, t1.monotonic_ns),
        "relay_span_ns": _span_ns(t3.monotonic_ns, t3.monotonic_ns),
    }


def count_sizes(t1: EventColumns, t2: EventColumns, run: Run) -> dict[str, int | None]:
    """Count replies of a size of their own; in traces of earlier versions none, as their T2 repeat the size that was sent."""
    requested = run.extra.get("reply_bytes")
    if isinstance(requested, int):
        is_other = t2.payload_bytes != requested
    elif not len(t1) or (t1.payload_bytes == t1.payload_bytes[0]).all():
        is_other = t2.payload_bytes != t1.payload_bytes[:1]
    else:
        order = np.argsort(t1.sequence, kind="stable")
        row = order[np.minimum(np.searchsorted(t1.sequence[order], t2.sequence), len(t1) - 1)]
        is_other = (t1.sequence[row] == t2.sequence) & (t1.payload_bytes[row] != t2.payload_bytes)
    others = t2.payload_bytes[is_other & (t2.sequence >= np.uint64(run.warmup_messages))]
    return {
        "resized": len(others),
        "least_reply_bytes": int(others.min()) if len(others) else None,
        "most_reply_bytes": int(others.max()) if len(others) else None,
    }


def _beyond_history(
    sent_ns: NDArray[np.int64], arrivals_ns: NDArray[np.int64], is_lost: NDArray[np.bool_], history_ns: float | None
) -> tuple[int, int]:
    if history_ns is None or not is_lost.any():
        return 0, 0
    arrived = np.flatnonzero(arrivals_ns != MISSING)
    gaps_ns = np.diff(arrivals_ns[arrived])
    longer = gaps_ns > history_ns
    # By the sender's clock: a message in a receiver's hands as it stood still has its arrival after it, ahead of what was lost.
    begins_ns, lost_ns = sent_ns[arrived[:-1]][longer], sent_ns[is_lost]
    first, last = (np.searchsorted(lost_ns, ns, "right") for ns in (begins_ns, begins_ns + gaps_ns[longer]))
    last = np.maximum.accumulate(last)
    lost = last - np.maximum(first, np.concatenate(([0], last[:-1])))
    return int(lost.sum()), int(gaps_ns[longer][lost > 0].max(initial=0))


def _span_ns(starts_ns: NDArray[np.int64], ends_ns: NDArray[np.int64]) -> int | None:
    if not (len(starts_ns) and len(ends_ns)):
        return None
    # An array wraps silently: damaged stamps may be too far apart for an int64.
    return int((ends_ns.max(keepdims=True) - starts_ns.min())[0])
