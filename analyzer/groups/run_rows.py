"""Each run in one row: when it sent, what came back and how long that took."""

from __future__ import annotations

import polars as pl


def run_rows(roundtrips: pl.LazyFrame) -> pl.DataFrame:
    """Summarize the round trips of each run.

    Returns:
        One row a run: `run_id` (u64), `origin_ns` (i64, planned send time of its first message on the ping's clock, else T1),
        `last_ns` (i64, T1 of its last message), `published` and `received` (u32), `p50_ns` (f64) and `max_ns` (i64) of the latency of
        what came back, of the round trip where no relay stamped; null where nothing did.
    """
    time = pl.coalesce("latency_ns", "rtt_ns")
    return (
        roundtrips.group_by("run_id")
        .agg(
            pl.coalesce("scheduled_ns", "publish_ns").min().alias("origin_ns"),
            pl.max("publish_ns").alias("last_ns"),
            pl.len().alias("published"),
            (pl.col("outcome") == "completed").sum().alias("received"),
            time.median().alias("p50_ns"),
            time.max().alias("max_ns"),
        )
        .sort("run_id")
        .collect()
    )
