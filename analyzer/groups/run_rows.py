"""Each run in one row: when it sent, what came back and how long that took."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from .batch import first_known, present

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from ..pairing.roundtrips import RoundTrips
    from .batch import Batch

ROWS_AT_ONCE = 4_000_000

RUN_SCHEMA: dict[str, type[pl.DataType]] = {
    "group": pl.UInt32,
    "run_id": pl.UInt64,
    "origin_ns": pl.Int64,
    "last_ns": pl.Int64,
    "published": pl.UInt32,
    "received": pl.UInt32,
    "p50_ns": pl.Float64,
    "max_ns": pl.Int64,
}
_READ = ("scheduled_ns", "publish_ns", "outcome", "latency_ns", "rtt_ns")


def run_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """Summarize the round trips of each run in each group.

    Returns:
        Columns of `RUN_SCHEMA`, a row for each run of each group: `origin_ns` (planned send time of its first message on the
        ping's clock, else T1), `last_ns` (T1 of its last message), `published` and `received` messages, times the relays of
        the group, `p50_ns` and `max_ns` of the latency of what came back, of the round trip where no relay stamped; null where
        nothing did.
    """
    run_ids = [exchange.run.run_id for exchange in batch.exchanges]
    keys = list(zip(batch.group_of_exchange.tolist(), run_ids, strict=True))
    first = [number for number, key in enumerate(keys) if number == 0 or key != keys[number - 1]]
    bounds = roundtrips.bounds[[*first, len(keys)]].tolist()
    return _summarize(roundtrips.measured, [keys[number] for number in first], bounds)


def run_rows(of_groups: pl.DataFrame, roundtrips: pl.LazyFrame) -> pl.DataFrame:
    """Put the rows of each run together.

    Args:
        of_groups: columns of `RUN_SCHEMA`, of all groups.
        roundtrips: read for the runs whose relays are of several groups, which share a median; not more than `ROWS_AT_ONCE` at
            a time, unless one run has more.

    Returns:
        Columns of `RUN_SCHEMA` but `group`, one row a run, by `run_id`.
    """
    is_whole = pl.col("run_id").is_unique()
    parts = [of_groups.filter(is_whole)]
    for runs in _runs_at_once(of_groups.filter(~is_whole)):
        is_read = pl.col("run_id").is_in(runs["run_id"].implode())
        rows = roundtrips.filter(is_read).select("run_id", *_READ).collect().sort("run_id")
        bounds = [0, *rows.group_by("run_id", maintain_order=True).len()["len"].cum_sum()]
        parts.append(_summarize(rows, [(0, run_id) for run_id in runs["run_id"]], bounds))
    return pl.concat(parts).drop("group").sort("run_id")


def _runs_at_once(of_groups: pl.DataFrame) -> Iterator[pl.DataFrame]:
    """Yield the runs whose round trips are read together, by `run_id`."""
    runs = of_groups.group_by("run_id").agg(pl.col("published").cast(pl.Int64).sum()).sort("run_id")
    rows_before = runs["published"].cum_sum() - runs["published"]
    yield from (part for _, part in runs.group_by(rows_before // ROWS_AT_ONCE, maintain_order=True))


def _summarize(
    roundtrips: pl.DataFrame, keys: Sequence[tuple[int, int]], bounds: Sequence[int]
) -> pl.DataFrame:
    """Return columns of `RUN_SCHEMA` from the rows of runs that stand together.

    Args:
        roundtrips: columns of `_READ`.
        keys: group and run_id of each.
        bounds: rows `bounds[i]` to `bounds[i + 1]` (not included) are those of run i.
    """
    sent_ns, is_back = roundtrips["publish_ns"].to_numpy(), (roundtrips["outcome"] == "completed").to_numpy()
    planned_ns = first_known(roundtrips, "scheduled_ns", "publish_ns").to_numpy()
    times = first_known(roundtrips, "latency_ns", "rtt_ns")
    rows = []
    for (group, run_id), first, after in zip(keys, bounds, bounds[1:], strict=False):
        if first == after:
            continue
        here = slice(first, after)
        ordered_ns = np.sort(present(times[here]))
        count = len(ordered_ns)
        middle_ns, max_ns = None, None
        if count:
            middle_ns = (int(ordered_ns[(count - 1) // 2]) + int(ordered_ns[count // 2])) / 2
            max_ns = int(ordered_ns[-1])
        rows.append(
            (
                group,
                run_id,
                int(planned_ns[here].min()),
                int(sent_ns[here].max()),
                after - first,
                int(np.count_nonzero(is_back[here])),
                middle_ns,
                max_ns,
            )
        )
    return pl.DataFrame(rows, schema=RUN_SCHEMA, orient="row")
