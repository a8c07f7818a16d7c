"""Messages that were due and never left, as rows that verdicts count as lost."""

from __future__ import annotations

from collections.abc import Mapping

import polars as pl

MOST_MESSAGES = 1 << 53
"""Largest count of a description: sums stay within an int64."""

UNSENT = "unsent"
"""Outcome that `roundtrips.parquet` never has."""

MOST_ROWS = 1_000_000
"""For one run, which is lost either way."""


def with_unsent(roundtrips: pl.DataFrame, unsent: Mapping[int, int]) -> pl.DataFrame:
    """Append a row `UNSENT` for each message that never left (by run_id).

    `publish_ns` is that of the last row of the run and relay; other times are null.
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
