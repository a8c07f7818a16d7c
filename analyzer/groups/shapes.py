"""The frame `shapes`: the latency over the time of each run: a warm-up, a trend, two modes."""

from __future__ import annotations

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ..model.metrics import frame_schema
from ..pairing.exchanges import Exchange
from ..pairing.pair import chosen_of
from ..pairing.roundtrips import RoundTrips
from ..run_statistics.bursts import share_inflation
from ..run_statistics.modes import find_modes, find_trend, find_warm_up
from ..statistics.percentiles import quantile_of
from .batch import Batch, filled

Int64 = NDArray[np.int64]


OWN_NS = 28_000
"""Difference of latency that may be the recorder's own: four events, each up to 7 us."""

SHAPE_SCHEMA = frame_schema(
    "group:u32 run_id:u64 relay_id:u32 p50_ns:i64 warm_up_messages:u64 warm_up_s:f64 warm_up_ratio:f64 "
    "trend_ratio:f64 modes_low_ns:f64 modes_high_ns:f64 modes_share:f64"
)


def shape_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """Describe the latency (without the relay's trace, the round trips) of each run and relay over time.

    Null unless significant and larger than `OWN_NS`: messages, time and level of the warm-up over the others' level; `trend_ratio`
    level at the end over the start's; the two modes and the share of the smaller one.
    """
    rows: list[dict[str, object]] = []
    # Filled for all runs at once: per run, the conversion takes longer than the median.
    columns = {name: filled(roundtrips.column(name)) for name in {_metric_of(exchange) for exchange in batch.exchanges}}
    sent_ns = roundtrips.measured["publish_ns"].to_numpy()
    for number, exchange in enumerate(batch.exchanges):
        exchange_rows = slice(*roundtrips.bounds[number : number + 2].tolist())
        latency_ns = columns[_metric_of(exchange)][exchange_rows]
        came = latency_ns > 0
        rows.append(
            {
                "group": int(batch.group_of_exchange[number]),
                "run_id": exchange.run.run_id,
                "relay_id": exchange.relay_id,
                **shape_of(chosen_of(came, latency_ns), chosen_of(came, sent_ns[exchange_rows])),
            }
        )
    return pl.DataFrame(rows, schema=SHAPE_SCHEMA, strict=False)


def _metric_of(exchange: Exchange) -> str:
    return "latency_ns" if exchange.relay_recorded else "rtt_ns"


def shape_of(latency_ns: Int64, sent_ns: Int64) -> dict[str, float]:
    shape: dict[str, float] = {}
    if not len(latency_ns):
        return shape
    ordered_ns = np.sort(latency_ns)
    shape["p50_ns"] = p50_ns = quantile_of(ordered_ns, 0.5)
    warm_up = find_warm_up(latency_ns)
    if warm_up is not None and warm_up.is_sure() and abs(warm_up.ratio - 1) * p50_ns >= OWN_NS:
        shape["warm_up_messages"], shape["warm_up_ratio"] = warm_up.messages, warm_up.ratio
        shape["warm_up_s"] = float(sent_ns[warm_up.messages] - sent_ns[0]) / 1e9
    trend = find_trend(latency_ns)
    if trend is not None and trend.is_sure() and abs(trend.change) * p50_ns >= OWN_NS:
        shape["trend_ratio"] = 1 + trend.change
    modes = find_modes(ordered_ns, share_inflation(np.flatnonzero(latency_ns > p50_ns), len(latency_ns)))
    if modes is not None and modes.high - modes.low >= OWN_NS:
        shape["modes_low_ns"], shape["modes_high_ns"] = modes.low, modes.high
        shape["modes_share"] = modes.share
    return shape
