"""Messages that were due and never left: how many, and as rows, so that whoever judges counts them as lost."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import polars as pl

from dds_trace.tracefile.units.durations import SECOND_NS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from dds_trace.tracefile import Run


MOST_MESSAGES = 1 << 53
"""Largest number that a description's count of messages can mean: sums of many stay within an int64."""

UNSENT = "unsent"
"""Outcome of a row that stands for a message that never left; no row of `roundtrips.parquet` has it."""

MOST_ROWS = 1_000_000
"""Rows that stand for the unsent messages of one run at the most: a run of so many is lost either way."""


@dataclass(frozen=True, slots=True)
class Ends:
    """The first and the last counted message of a run that were published.

    Attributes:
        first: sequence of the first.
        scheduled_ns: its T0; None if the run had no schedule.
        last: sequence of the last.
        last_ns: the last T1 or T2.
    """

    first: int
    scheduled_ns: int | None
    last: int
    last_ns: int


def due_unsent(run: Run, ends: Ends | None) -> int:
    """Return the number of counted messages whose T0 had passed when the run ended and that were never published.

    The run ended when its ping stopped sending (`ended_ns` of the run); if it did not tell, at the last T1 or T2. Messages
    of a live topic have no plan: those that the ping skipped never left.

    Args:
        run: its description.
        ends: None of a run without a published message.
    """
    skipped = run.extra.get("skipped_messages")
    if isinstance(skipped, int):
        return min(max(skipped, 0), MOST_MESSAGES)
    if ends is None or ends.scheduled_ns is None or run.rate_hz <= 0 or _is_live(run):
        return 0
    told = run.extra.get("ended_ns")
    ended_ns = told if isinstance(told, int) else ends.last_ns
    total = run.warmup_messages + run.planned_messages
    due = ends.first + 1 + int((ended_ns - ends.scheduled_ns) * run.rate_hz / SECOND_NS)
    left = max(ends.last + 1, run.published, run.warmup_messages)
    return min(max(0, min(due, total) - left), MOST_MESSAGES)


def _is_live(run: Run) -> bool:
    return str(run.extra.get("data_source", "")).startswith("topic:")


def unsent_by_run(roundtrips: pl.LazyFrame, runs: Iterable[Run]) -> dict[int, int]:
    """Return run_id -> messages that never left, of the runs that have any.

    Args:
        roundtrips: rows of `docs/trace-format.md`.
        runs: descriptions of the runs.
    """
    by_id = {run.run_id: run for run in runs}
    ends = (
        roundtrips.group_by("run_id")
        .agg(
            pl.col("sequence").min().alias("first"),
            pl.col("scheduled_ns").sort_by("sequence").first(),
            pl.col("sequence").max().alias("last"),
            pl.max_horizontal(pl.col("publish_ns").max(), pl.col("receive_ns").max()).alias("last_ns"),
        )
        .collect()
    )
    unsent = {
        row["run_id"]: due_unsent(
            by_id[row["run_id"]], Ends(row["first"], row["scheduled_ns"], row["last"], row["last_ns"])
        )
        for row in ends.iter_rows(named=True)
        if row["run_id"] in by_id
    }
    return {run_id: count for run_id, count in unsent.items() if count}


def with_unsent(roundtrips: pl.DataFrame, unsent: Mapping[int, int]) -> pl.DataFrame:
    """Append a row for each message that never left, behind the last row of its run and relay.

    Args:
        roundtrips: `run_id`, `relay_id`, `publish_ns`, `outcome`, and any metrics and parameters.
        unsent: run_id -> how many.

    Returns:
        The rows, and those of outcome `UNSENT`, whose metrics and stamps are null but for `publish_ns`, that of the last.
    """
    last = roundtrips.filter(pl.col("run_id").is_in(list(unsent))) if unsent else roundtrips.head(0)
    if last.is_empty():
        return roundtrips
    counts = pl.DataFrame(
        {"run_id": list(unsent), "_unsent": [min(count, MOST_ROWS) for count in unsent.values()]},
        schema={"run_id": roundtrips.schema["run_id"], "_unsent": pl.UInt32},
    )
    unknown = [name for name in roundtrips.columns if name.endswith("_ns") and name != "publish_ns"]
    rows = (
        last.sort("publish_ns", maintain_order=True)
        .group_by("run_id", "relay_id", maintain_order=True)
        .last()
        .join(counts, on="run_id", how="left", maintain_order="left")
        .with_columns(pl.lit(UNSENT).alias("outcome"), *(pl.lit(None).alias(name) for name in unknown))
    )
    names = roundtrips.columns
    repeated = rows.select(pl.col(names).repeat_by("_unsent")).explode(names)
    return pl.concat([roundtrips, repeated.cast(dict(roundtrips.schema))])  # type: ignore[arg-type]
