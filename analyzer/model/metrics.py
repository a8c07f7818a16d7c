"""The metrics of a round trip; columns, statistics, gates and reports follow from a row."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import polars as pl


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a frame."""

    name: str
    dtype: type[pl.DataType] | pl.DataType
    unit: str
    meaning: str


def schema_of(columns: Iterable[Column]) -> dict[str, type[pl.DataType] | pl.DataType]:
    """Map names to types, in order."""
    return {column.name: column.dtype for column in columns}


_DTYPES = {"bool": pl.Boolean, "f64": pl.Float64, "i64": pl.Int64, "str": pl.String, "u32": pl.UInt32, "u64": pl.UInt64}


def frame_schema(columns: str) -> dict[str, type[pl.DataType]]:
    """Return the schema of `group:u32 p50_ns:f64 ...`."""
    pairs = (column.split(":") for column in columns.split())
    return {name: _DTYPES[dtype] for name, dtype in pairs}


@dataclass(frozen=True, slots=True)
class Metric:
    """A time of every message, in ns.

    `name` is as in columns and gates. The formula is null where a stamp is missing, and each difference in it is on one
    clock. `tail` says what its largest values must not be taken for.
    """

    name: str
    label: str
    formula: pl.Expr
    meaning: str
    tail: str = ""

    @property
    def column(self) -> Column:
        """Its column."""
        return Column(f"{self.name}_ns", pl.Int64, "ns", f"{self.meaning}; null where an input is missing")


_t0, _t1, _t2 = pl.col("scheduled_ns"), pl.col("publish_ns"), pl.col("receive_ns")
_t3, _t4 = pl.col("relay_in_ns"), pl.col("relay_out_ns")
_latency = ((_t2 - _t1) - (_t4 - _t3)) // 2  # rounds down, also below zero

METRICS: Mapping[str, Metric] = {
    metric.name: metric
    for metric in (
        Metric("rtt", "Round trip", _t2 - _t1, "T2 - T1"),
        Metric("intermediate", "Time in relay", _t4 - _t3, "T4 - T3"),
        Metric(
            "latency",
            "Latency",
            _latency,
            "(rtt - intermediate) // 2, the mean of both ways: its tail is no one-way tail",
            tail="the mean of both ways of a message, so this tail is below the tail of one way (outbound_ns, return_ns)",
        ),
        Metric("response", "Response", _t2 - _t0, "T2 - T0"),
    )
}
"""By name, in the order of columns."""


TOPIC_METRICS: Mapping[str, str] = {"one_way": "One way", "age": "Age"}
"""Name -> label: publishing to reception, and header's stamp to reception."""


def with_metrics(stamps: pl.DataFrame) -> pl.DataFrame:
    """Append every metric to stamps (i64 ns, null if missing)."""
    return stamps.with_columns(metric.formula.alias(metric.column.name) for metric in METRICS.values())
