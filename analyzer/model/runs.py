"""Runs of a frame of round trips, losses included."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import blake2b

import numpy as np
import polars as pl
from numpy.typing import NDArray

from dds_trace.tracefile.format.descriptions import Run as RunDescription

from ..run_statistics.runs import Run

MOST_MESSAGES = 1 << 53
"""Largest count of a description: sums stay within an int64."""

UNSENT = "unsent"
"""Outcome that `roundtrips.parquet` never has."""

MOST_ROWS = 1_000_000
"""For one run, which is lost either way."""


def tap_run_id(topic: str, sender: str, session_id: int) -> int:
    words = f"{topic} {sender} {session_id:016x}"
    return int.from_bytes(blake2b(words.encode(), digest_size=8).digest(), "little")


def with_unsent(roundtrips: pl.DataFrame, unsent: Mapping[int, int]) -> pl.DataFrame:
    """Append a row `UNSENT` for each message that never left (by run_id), at the last `publish_ns` of run and relay."""
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


PASS_LABEL = "pass"  # noqa: S105 - no password
"""Label with the number of a sweep's pass."""

_TWICE_AT_MOST = {"latency": "rtt_ns"}


@dataclass(frozen=True, eq=False)
class RunRows:
    """The round trips of one run in the order of T1."""

    run_id: int
    rows: pl.DataFrame

    def delivered(self, metric: str) -> Run:
        """Return a metric of every message in ns: infinite if lost, half of the round trip without the relay's stamps."""
        at_most = self._floats(f"{metric}_ns")
        if self.is_whole(metric):
            return Run(at_most, self.rows["publish_ns"].to_numpy())
        if metric in _TWICE_AT_MOST:
            at_most = np.where(np.isnan(at_most), self._floats(_TWICE_AT_MOST[metric]) / 2, at_most)
        value = np.where(self.received, at_most, math.inf)
        has_value = ~np.isnan(value)
        return Run(value[has_value], self.rows["publish_ns"].to_numpy()[has_value])

    def is_whole(self, metric: str) -> bool:
        return bool(self.received.all()) and not self.rows[f"{metric}_ns"].null_count()

    def survivors(self, metric: str) -> Run:
        value, sent_ns = self.rows[f"{metric}_ns"], self.rows["publish_ns"]
        if value.null_count():
            has_value = value.is_not_null()
            value, sent_ns = value.filter(has_value), sent_ns.filter(has_value)
        return Run(value.to_numpy(), sent_ns.to_numpy())

    def _floats(self, name: str) -> NDArray[np.float64]:
        column: NDArray[np.float64] = self.rows[name].cast(pl.Float64).to_numpy()
        return column

    @property
    def sent_ns(self) -> pl.Series:
        return self.rows.filter(pl.col("outcome") != UNSENT)["publish_ns"]

    @cached_property
    def received(self) -> NDArray[np.bool_]:
        return (self.rows["outcome"] == "completed").to_numpy()

    @property
    def is_lost(self) -> bool:
        return not self.received.any()


def split_runs(rows: pl.DataFrame) -> tuple[RunRows, ...]:
    parts = rows.partition_by("run_id", maintain_order=True)
    # Rows of several relays are not in the order of T1.
    return tuple(
        RunRows(
            int(part["run_id"][0]),
            part if part["publish_ns"].is_sorted() else part.sort("publish_ns", maintain_order=True),
        )
        for part in parts
    )


def delivered_runs(runs: Sequence[RunRows], metric: str) -> list[Run]:
    """Return a metric of each run, a loss infinitely late; no values if no reply has the metric."""
    has_metric = any(run.rows[f"{metric}_ns"].null_count() < len(run.rows) for run in runs)
    if has_metric or all(run.is_lost for run in runs):
        return [run.delivered(metric) for run in runs]
    return [Run(np.empty(0)) for _ in runs]


def pass_numbers(runs: Iterable[RunDescription]) -> dict[int, int]:
    return {
        run.run_id: int(text) for run in runs if (text := run.labels.get(PASS_LABEL, "")).isascii() and text.isdigit()
    }
