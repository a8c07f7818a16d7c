"""The four metrics of a round trip, as the paper has them, from the five time stamps of `docs/trace-format.md`.

Each is a polars expression over the columns of `roundtrips`, so a missing stamp makes every metric that needs
it null, never 0. A difference is taken on one device's clock only.
"""

from __future__ import annotations

import polars as pl

_t0, _t1, _t2 = pl.col("scheduled_ns"), pl.col("publish_ns"), pl.col("receive_ns")
_t3, _t4 = pl.col("relay_in_ns"), pl.col("relay_out_ns")

RTT_NS = _t2 - _t1
INTERMEDIATE_NS = _t4 - _t3
LATENCY_NS = (RTT_NS - INTERMEDIATE_NS) // 2  # rounds down, also below zero
RESPONSE_NS = _t2 - _t0

METRICS: dict[str, pl.Expr] = {
    "rtt": RTT_NS,
    "intermediate": INTERMEDIATE_NS,
    "latency": LATENCY_NS,
    "response": RESPONSE_NS,
}
"""Metric -> its formula, in ns (i64, null where an input is null); column `<metric>_ns` of the frames."""


def with_metrics(stamps: pl.DataFrame) -> pl.DataFrame:
    """`stamps` with the columns `rtt_ns`, `intermediate_ns`, `latency_ns` and `response_ns`.

    Args:
        stamps: `scheduled_ns`, `publish_ns`, `receive_ns`, `relay_in_ns`, `relay_out_ns` (i64, null if missing).
    """
    return stamps.with_columns(formula.alias(f"{metric}_ns") for metric, formula in METRICS.items())
