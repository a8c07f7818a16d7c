"""The frame `sending`: whether the ping of each run kept its schedule."""

from __future__ import annotations

import polars as pl

from dds_trace.base.units import SECOND_NS

from ..model.metrics import frame_schema
from ..pairing.roundtrips import RoundTrips
from .batch import Batch, described_exchanges

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

    `elapsed_ns` is the planned time from the first message to the last tenth, `behind_ns` how much later that was sent, both null for
    a live topic, whose rate is a guess; `late` messages with T1 - T0 above `LATE_NS` and `late_max_ns` without those that a stand-still
    delayed, until the ping had caught up; `still` stand-stills, the longest of `still_ns` until `still_end_ns`, ping's clock.
    """
    rows = roundtrips.measured.lazy().select(
        pl.lit(pl.Series(roundtrips.exchange_of_row()).set_sorted()).alias("exchange"), "scheduled_ns", "publish_ns"
    )
    frame = (
        described_exchanges(batch)
        .lazy()
        .join(_schedule_lag(rows, batch).collect().lazy(), on="exchange", how="left")
        .join(_late(rows), on="exchange", how="left")
        .sort("exchange")
        .with_columns(pl.col("messages", "late", "still").fill_null(0))
        .select(pl.col(name).cast(kind) for name, kind in SENDING_SCHEMA.items())
    )
    return frame.collect()


def _late(rows: pl.LazyFrame) -> pl.LazyFrame:
    due_ns, sent_ns, delayed = pl.col("scheduled_ns"), pl.col("publish_ns"), pl.col("delayed")
    waited_ns, still_ns = pl.col("waited_ns"), pl.col("still_ns")
    stood = still_ns >= STILL_NS
    scheduled = rows.drop_nulls("scheduled_ns").with_columns(waited_ns=sent_ns - due_ns)
    waits = scheduled.group_by("exchange").agg(most_ns=waited_ns.max(), late_p99_ns=waited_ns.quantile(0.99, "linear"))
    waits = waits.with_columns(is_late=pl.col("most_ns") > LATE_NS).collect().lazy()
    lates = (
        scheduled.join(waits.filter("is_late"), on="exchange", how="semi", maintain_order="left")
        .with_columns(still_ns=sent_ns - pl.max_horizontal(due_ns, sent_ns.shift().over("exchange")))
        .with_columns(delayed=pl.when(stood).then(pl.lit(1)).when(waited_ns <= LATE_NS).then(pl.lit(0)))
        .with_columns(delayed.forward_fill().over("exchange").fill_null(0) == 1)
        .group_by("exchange")
        .agg(
            late=(~delayed & (waited_ns > LATE_NS)).sum(),
            late_max_ns=waited_ns.filter(~delayed).max(),
            still=stood.sum(),
            still_end_ns=sent_ns.filter(stood & (still_ns == still_ns.max())).first(),
            still_ns=still_ns.filter(stood).max(),
        )
    )
    late_max_ns = pl.when("is_late").then("late_max_ns").otherwise("most_ns").alias("late_max_ns")
    return waits.join(lates, on="exchange", how="left").with_columns(late_max_ns)


def _schedule_lag(rows: pl.LazyFrame, batch: Batch) -> pl.LazyFrame:
    periods_ns = [
        None
        if exchange.run.rate_hz <= 0 or str(exchange.run.extra.get("data_source", "")).startswith("topic:")
        else SECOND_NS / exchange.run.rate_hz
        for exchange in batch.exchanges
    ]
    sent_ns, messages, index = pl.col("publish_ns"), pl.len().cast(pl.Int64), pl.int_range(pl.len())
    is_last = index >= messages - pl.max_horizontal(_LEAST_MESSAGES, messages // _LAST_SHARE)
    # Of the last tenth only: of a long run each column of all messages is 40 MB.
    planned_ns = index.filter(is_last).cast(pl.Float64) * pl.col("period_ns").first()
    lag_ns = sent_ns.filter(is_last) - sent_ns.first() - planned_ns
    return (
        rows.with_columns(period_ns=pl.lit(pl.Series(periods_ns, dtype=pl.Float64)).gather("exchange"))
        .group_by("exchange")
        .agg(messages=pl.len(), elapsed_ns=planned_ns.median().round(), behind_ns=lag_ns.median().round())
        .with_columns(pl.when(pl.col("messages") >= _LEAST_MESSAGES).then(pl.col("elapsed_ns", "behind_ns")))
    )
