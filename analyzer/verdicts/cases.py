"""Parts of a campaign that are judged together, and the latencies of the messages in them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol

import numpy as np
import polars as pl

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from ..model.parameters import ParameterValue

    Setting = Mapping[str, ParameterValue]
    """Parameter column -> value, of some columns."""

MOST_COMPARED_ROWS = 4_000_000
"""Rows of one kind of message that are compared: they are in memory at once, with what sorting them takes."""


class GroupRows(Protocol):
    """The round trips of a campaign, of which those of a few groups at a time are read."""

    @property
    def groups(self) -> pl.DataFrame:
        """One row per group: the parameter columns, and `published`, the number of its round trips."""

    @property
    def has_rows(self) -> bool:
        """Whether round trips were kept; False of a sketch, which has groups only."""

    def frame(self, groups: pl.DataFrame, columns: Sequence[str] = ...) -> pl.DataFrame:
        """Read columns (by default all) of the round trips of some rows of `groups`, group by group."""


def partition_groups(groups: pl.DataFrame, columns: Sequence[str]) -> list[pl.DataFrame]:
    """Cut groups into parts that agree in some parameter columns; parts are sorted by these.

    Args:
        groups: `GroupRows.groups`, or some of its rows.
        columns: parameter columns.
    """
    ordered = groups.sort(*columns, maintain_order=True)
    return ordered.partition_by(*columns, maintain_order=True) if len(ordered) else []


def is_too_large(groups: pl.DataFrame) -> bool:
    """Tell whether some rows of `GroupRows.groups` have more than `MOST_COMPARED_ROWS` round trips together."""
    return int(groups["published"].sum()) > MOST_COMPARED_ROWS


def parts_of(roundtrips: pl.DataFrame, columns: Sequence[str]) -> Iterator[tuple[Setting, pl.DataFrame]]:
    """Cut round trips by the values of some columns.

    Yields:
        The values and their rows, by run and relay and in the order of time; parts are sorted by their values, null
        first.
    """

    def order(part: tuple[Setting, pl.DataFrame]) -> list[tuple[bool, ParameterValue]]:
        return [(value is not None, value) for value in part[0].values()]

    parts = [
        (part.select(columns).row(0, named=True), part)
        for part in roundtrips.partition_by(*columns, maintain_order=True)
    ]
    for setting, part in sorted(parts, key=order):
        yield setting, part.sort("run_id", "relay_id", "publish_ns")


def delivered_latencies(roundtrips: pl.DataFrame) -> NDArray[np.float64]:
    """Return the latency of each message in ns, infinite if it was lost; empty if no latency is known.

    A reply that came back without the relay's stamps took at most half of its round trip. It counts with that: left
    out, it would give the lost ones more weight than they have.

    Args:
        roundtrips: `outcome`, `latency_ns` and `rtt_ns`, in the order of the result.
    """
    if roundtrips["latency_ns"].null_count() == len(roundtrips):
        return np.empty(0, np.float64)
    lost = pl.col("outcome") != "completed"
    at_most = pl.coalesce(pl.col("latency_ns").cast(pl.Float64), pl.col("rtt_ns") / 2)
    latencies = roundtrips.select(pl.when(lost).then(math.inf).otherwise(at_most)).to_series()
    return latencies.drop_nulls().to_numpy()
