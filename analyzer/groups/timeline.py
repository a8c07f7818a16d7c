"""The frames `run_times` (a row per run) and `timeline` (round trips over the run's time, few enough to draw)."""

from __future__ import annotations

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ..model.metrics import frame_schema
from ..pairing.pair import OUTCOMES, Outcome
from ..pairing.roundtrips import RoundTrips
from .batch import Batch, described_exchanges, filled

ROWS_AT_ONCE = 4_000_000

RUN_SCHEMA = frame_schema(
    "group:u32 run_id:u64 origin_ns:i64 last_ns:i64 published:u32 received:u32 p50_ns:f64 max_ns:i64"
)
_OF_RUNS = [pl.col(name).cast(kind) for name, kind in RUN_SCHEMA.items()]
_READ = ("scheduled_ns", "publish_ns", "outcome", "latency_ns", "rtt_ns")


def run_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """Summarize the round trips of each run in each group, in columns of `RUN_SCHEMA`.

    `origin_ns` is the first T0 (else T1), `last_ns` the last T1; counts are times the relays; times are latencies, round trips
    without the relay's stamps.
    """
    # Relays of a run follow each other: ascending numbers are grouped without a copy.
    runs = described_exchanges(batch).with_columns(run=pl.struct("group", "run_id").rle_id())
    run = pl.Series("run", roundtrips.per_row(runs["run"].to_numpy())).set_sorted()
    summarized = _summarize(roundtrips.select(_READ).with_columns(run), "run")
    names = runs.unique("run", maintain_order=True).select("run", "group", "run_id")
    return summarized.join(names, on="run", maintain_order="left").select(_OF_RUNS)


def run_rows(run_times: pl.DataFrame, roundtrips: pl.LazyFrame) -> pl.DataFrame:
    """Return one row a run, by `run_id`; a run with relays in several groups needs a common median, so its rows are read."""
    is_whole = pl.col("run_id").is_unique()
    parts = [run_times.filter(is_whole)]
    runs = run_times.filter(~is_whole).group_by("run_id").agg(pl.col("published").cast(pl.Int64).sum()).sort("run_id")
    rows_before = runs["published"].cum_sum() - runs["published"]
    for _, read in runs.group_by(rows_before // ROWS_AT_ONCE, maintain_order=True):
        rows = roundtrips.filter(pl.col("run_id").is_in(read["run_id"].implode()))
        summarized = _summarize(rows.select("run_id", *_READ).collect(), "run_id")
        parts.append(summarized.with_columns(group=0).select(_OF_RUNS))
    return pl.concat(parts).drop("group").sort("run_id")


def _summarize(rows: pl.DataFrame, run: str) -> pl.DataFrame:
    time_ns = pl.coalesce("latency_ns", "rtt_ns")
    return rows.group_by(run, maintain_order=True).agg(
        origin_ns=pl.coalesce("scheduled_ns", "publish_ns").min(),
        last_ns=pl.col("publish_ns").max(),
        published=pl.len(),
        received=(pl.col("outcome") == "completed").sum(),
        p50_ns=time_ns.median(),
        max_ns=time_ns.max(),
    )


_ALL_POINTS = 100_000
_POINTS_OF_EXCHANGE = (200, 4_000)

_POINTS_PER_STRETCH = 4
"""Points of a stretch: lowest, highest, the first loss, one of another kind."""

_MOST_NS = np.iinfo(np.int64).max

_DRAWN = ("sequence", "scheduled_ns", "publish_ns", "latency_ns", "rtt_ns", "outcome")


def timeline_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """Choose rows to draw; all exchanges of the campaign share the points.

    Each of equal stretches of an exchange keeps its lowest and highest latency (round trip without the relay's trace) and the
    first message of every kind of loss. `elapsed_s` is T0 (else T1) since the run's first counted message.
    """
    recorded = np.array([exchange.relay_recorded for exchange in batch.exchanges])
    rows = _rows_to_draw(roundtrips, recorded, points_of_exchange(batch.all_exchanges))
    exchange = roundtrips.exchange_of_row()[rows]
    drawn = roundtrips.select(_DRAWN)[rows].with_columns(
        pl.Series("group", batch.group_of_exchange[exchange]),
        *(roundtrips.described[name].gather(exchange) for name in ("run_id", "relay_id")),
        pl.Series("exchange", exchange),
    )
    planned_ns = pl.coalesce("scheduled_ns", "publish_ns")
    # The first counted message of an exchange is always among the rows kept.
    elapsed_ns = planned_ns - planned_ns.first().over("exchange")
    return drawn.select(
        "group",
        "run_id",
        "relay_id",
        "sequence",
        (elapsed_ns / 1e9).alias("elapsed_s"),
        "latency_ns",
        "rtt_ns",
        pl.col("outcome").cast(pl.String),
    )


def points_of_exchange(all_exchanges: int) -> int:
    low, high = _POINTS_OF_EXCHANGE
    rounded = 1 << max(all_exchanges - 1, 0).bit_length()
    return min(max(_ALL_POINTS // rounded, low), high)


def _rows_to_draw(roundtrips: RoundTrips, recorded: NDArray[np.bool_], share: int) -> NDArray[np.int64]:
    rows, first = np.diff(roundtrips.bounds), roundtrips.bounds[:-1]
    if (rows <= share).all():
        return np.arange(roundtrips.measured.height)

    # Stretches are numbered over all exchanges; in an exchange with few rows every row is one.
    stretches = np.where(rows <= share, rows, share // _POINTS_PER_STRETCH)
    offset = np.cumsum(stretches) - stretches
    exchange = np.repeat(np.arange(len(rows)), stretches)
    number = np.arange(len(exchange)) - offset[exchange]
    # Row i of an exchange is in stretch `i * stretches // rows`.
    starts = first[exchange] - -number * rows[exchange] // stretches[exchange]
    lost = np.flatnonzero(roundtrips.outcome != OUTCOMES.index(Outcome.COMPLETED))
    kind = np.searchsorted(starts, lost, side="right") * len(OUTCOMES) + roundtrips.outcome[lost]
    first_lost = np.unique(kind, return_index=True)[1]
    times = roundtrips.column("latency_ns")
    if not recorded.all():
        times = times.zip_with(pl.Series(roundtrips.per_row(recorded)), roundtrips.column("rtt_ns"))
    drawn = [first[rows > 0], lost[first_lost]]
    for extreme, none_ns in ((np.minimum, _MOST_NS), (np.maximum, -_MOST_NS)):
        times_ns = filled(times, none_ns)
        extremes_ns = np.repeat(extreme.reduceat(times_ns, starts), np.diff(starts, append=len(times_ns)))
        indices = np.flatnonzero((times_ns == extremes_ns) & (extremes_ns != none_ns))
        stretch = np.searchsorted(starts, indices, side="right")
        drawn.append(indices[np.diff(stretch, prepend=0) > 0])  # the first of equal ones
    return np.unique(np.concatenate(drawn))
