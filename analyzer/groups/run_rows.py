"""Each run in one row: when it sent, what came back and how long that took."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

ROWS_AT_ONCE = 4_000_000


def run_rows(roundtrips: pl.LazyFrame, lengths: Sequence[int]) -> pl.DataFrame:
    """Summarize the round trips of each run.

    Args:
        roundtrips: group by group.
        lengths: rows of each group: not more than `ROWS_AT_ONCE` are in memory, unless one group has more.

    Returns:
        One row a run: `run_id` (u64), `origin_ns` (i64, planned send time of its first message on the ping's clock, else T1),
        `last_ns` (i64, T1 of its last message), `published` and `received` (u32), `p50_ns` (f64) and `max_ns` (i64) of the latency of
        what came back, of the round trip where no relay stamped; null where nothing did.
    """
    if sum(lengths) <= ROWS_AT_ONCE:
        return _summarize(roundtrips).sort("run_id")
    parts = pl.concat([_summarize(roundtrips.slice(first, count)) for first, count in _spans(lengths)])
    # A run whose relays are of several groups may be in several parts.
    again = parts.filter(pl.col("run_id").is_duplicated())["run_id"].unique()
    if len(again):
        is_again = pl.col("run_id").is_in(again.implode())
        parts = pl.concat([parts.filter(~is_again), _summarize(roundtrips.filter(is_again))])
    return parts.sort("run_id")


def _spans(lengths: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Yield first row and number of rows of groups that are summarized together."""
    first = count = 0
    for length in lengths:
        if count and count + length > ROWS_AT_ONCE:
            yield first, count
            first, count = first + count, 0
        count += length
    yield first, count


def _summarize(roundtrips: pl.LazyFrame) -> pl.DataFrame:
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
        .collect()
    )
