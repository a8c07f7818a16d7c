"""Frames of a batch beyond rows and summary: intervals, one way, breakdown, freshness. Each row is of one group."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from ..model.metrics import METRICS
from ..pairing.one_way import knots_of
from ..pairing.pair import MISSING
from ..statistics.intervals import percentile_interval
from ..statistics.percentiles import PERCENTILES, summarize_values
from .breakdown import (
    STAMP_COLUMNS,
    break_down,
    response_against_latency,
    summarize_breakdown,
)
from .freshness import outage_table, summarize_freshness

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from dds_trace.tracefile import EventColumns

    from ..pairing.roundtrips import RoundTrips
    from .batch import Batch

INTERVAL_SCHEMA: dict[str, type[pl.DataType]] = {
    "group": pl.UInt32,
    "metric": pl.String,
    "percentile": pl.String,
    "quantile": pl.Float64,
    "estimate_ns": pl.Float64,
    "low_ns": pl.Float64,
    "high_ns": pl.Float64,
    "method": pl.String,
    "confidence": pl.Float64,
    "messages": pl.UInt64,
    "independent": pl.UInt64,
}
ONE_WAY_SCHEMA: dict[str, type[pl.DataType]] = {
    "group": pl.UInt32,
    "metric": pl.String,
    "messages": pl.UInt64,
    "mean_ns": pl.Float64,
    "min_ns": pl.Float64,
    **{f"{p.name}_ns": pl.Float64 for p in PERCENTILES},
    "max_ns": pl.Float64,
    "bound_p50_ns": pl.Float64,
    "bound_max_ns": pl.Float64,
}

ONE_WAY_METRICS = ("outbound", "return")


def interval_frame(batch: Batch) -> pl.DataFrame:
    """Every percentile of every metric with its 95 % interval by order statistics.

    Returns:
        Columns of `INTERVAL_SCHEMA`, five rows per group and metric that has a value (`METRICS`, `outbound`,
        `return`). `estimate_ns` is the summary's percentile; `low_ns`, `high_ns` are null where the sample does not
        support that end, all three where it does not support the percentile. `method` is `order_statistics`, null
        without both ends. `independent`: how many independent messages the sample is worth.
    """
    rows = [row for group, part in _groups(batch) for row in interval_rows(group, part.get_column)]
    return pl.DataFrame(rows, schema=INTERVAL_SCHEMA)


def interval_rows(group: int, column: Callable[[str], pl.Series]) -> Iterator[dict[str, Any]]:
    """The rows of `interval_frame` for one group, whose columns are fetched one by one."""
    for metric in (*METRICS, *ONE_WAY_METRICS):
        values = column(f"{metric}_ns").drop_nulls().to_numpy()
        if not len(values):
            continue
        ordered = np.sort(values)
        for percentile in PERCENTILES:
            found = percentile_interval(values, percentile.quantile, ordered=ordered)
            yield {
                "group": group,
                "metric": metric,
                "percentile": percentile.name,
                "quantile": percentile.quantile,
                "estimate_ns": found.value,
                "low_ns": found.lower,
                "high_ns": found.upper,
                "method": "order_statistics" if found.is_two_sided else None,
                "confidence": found.confidence,
                "messages": found.samples,
                "independent": found.independent,
            }


def one_way_frame(batch: Batch) -> pl.DataFrame:
    """The way out and the way back of each group whose messages have all four stamps.

    Returns:
        Columns of `ONE_WAY_SCHEMA`, rows `outbound` and `return`: percentiles as in the summary, and how far a
        message's one-way time may be off (`bound_p50_ns`, `bound_max_ns`; 0 on one clock).
    """
    rows = [row for group, part in _groups(batch) for row in one_way_rows(group, part.get_column)]
    return pl.DataFrame(rows, schema=ONE_WAY_SCHEMA)


def one_way_rows(group: int, column: Callable[[str], pl.Series]) -> Iterator[dict[str, Any]]:
    """The rows of `one_way_frame` for one group, whose columns are fetched one by one."""
    bounds = column("clock_bound_ns").drop_nulls()
    for metric in ONE_WAY_METRICS if len(bounds) else ():
        statistics = summarize_values(column(f"{metric}_ns").drop_nulls().sort().to_numpy())
        yield (
            {"group": group, "metric": metric, "messages": len(bounds)}
            | {f"{name}_ns": value for name, value in statistics.items() if name != "std"}
            | {"bound_p50_ns": bounds.median(), "bound_max_ns": bounds.max()}
        )


def freshness_frame(batch: Batch) -> pl.DataFrame:
    """What a control loop felt: `group` u32, then the columns of `freshness.FRESHNESS_SCHEMA`, a row per run and relay."""
    found = summarize_freshness(_rows(batch), batch.wanted.deadline_ns)
    return _with_group(batch, found)


def outage_frame(batch: Batch) -> pl.DataFrame:
    """`group` u32, then the columns of `freshness.outage_table`, a row per outage."""
    return _with_group(batch, outage_table(_rows(batch), batch.wanted.deadline_ns))


def breakdown_frame(batch: Batch) -> pl.DataFrame:
    """Where the time goes: `group` u32, then the columns of `breakdown.summarize_breakdown`, a row per part.

    Percentiles of parts of a group do not add up, so a group that is here in part has no rows.
    """
    if not batch.whole:
        return summarize_breakdown(break_down(_rows(batch).head(0)), ["group"])
    exchanges = batch.roundtrips.exchanges
    rows = _rows(batch).with_columns(_stamps(batch.roundtrips))
    ping_wall = {e.run.run_id: e.ping.wall_anchor_ns - e.ping.monotonic_anchor_ns for e in exchanges}
    relay_wall = {
        e.relay_id: e.relay.wall_anchor_ns - e.relay.monotonic_anchor_ns for e in exchanges if e.relay
    }
    return summarize_breakdown(break_down(rows, ping_wall, relay_wall), ["group"])


def _stamps(roundtrips: RoundTrips) -> Iterator[pl.Series]:
    """Make the columns `breakdown.STAMP_COLUMNS` from the events of T2 and T3 that each row was paired from."""
    for stage, instant, names in (
        ("t3", "relay_in_ns", STAMP_COLUMNS[:2]),
        ("t2", "receive_ns", STAMP_COLUMNS[2:]),
    ):
        paired_ns = roundtrips.measured[instant].fill_null(MISSING).to_numpy()
        stamps = {name: np.zeros(len(paired_ns), np.int64) for name in names}
        exchanges = zip(
            roundtrips.exchanges, roundtrips.published, roundtrips.bounds[:-1].tolist(), strict=True
        )
        for exchange, published, first in exchanges:
            events: EventColumns = getattr(exchange, stage)
            if not (events.source_ns.any() or events.received_ns.any()):
                continue
            row = published.rows(events.sequence)
            paired = np.flatnonzero(row >= 0)
            paired = paired[paired_ns[first + row[paired]] == events.monotonic_ns[paired]]
            paired = paired[::-1]  # of two events that are the same the first counts: it is put there last
            for name, values in zip(names, (events.source_ns, events.received_ns), strict=True):
                stamps[name][first + row[paired]] = values[paired]
        for name, values in stamps.items():
            yield pl.Series(name, values).set(pl.Series(values == 0), None)


def response_frame(batch: Batch) -> pl.DataFrame:
    """What a schedule that was not held hides: `group` u32, then those of `breakdown.response_against_latency`.

    A group that is here in part has no row, as in `breakdown_frame`.
    """
    rows = _rows(batch)
    return response_against_latency(rows if batch.whole else rows.head(0), ["group"])


def knot_frame(batch: Batch) -> pl.DataFrame:
    """What the runs know best of the clocks, a row per run, relay and window: columns of `one_way.KNOT_SCHEMA`."""
    roundtrips = batch.roundtrips
    return knots_of(roundtrips.exchanges, batch.group_of_exchange.tolist(), roundtrips.clock_fits)


def _rows(batch: Batch) -> pl.DataFrame:
    """Rows with the parameters that the frames here take; no others, as texts take more memory than numbers."""
    roundtrips = batch.roundtrips
    exchange = roundtrips.exchange_of_row()
    return roundtrips.measured.with_columns(
        pl.Series("group", batch.group_of_row()),
        *(roundtrips.described[n].gather(exchange) for n in ("run_id", "relay_id", "bridge", "rate_hz")),
    )


def _groups(batch: Batch) -> Iterator[tuple[int, pl.DataFrame]]:
    """Each group and its measured rows; none of a group that is here in part."""
    if not batch.whole:
        return
    groups, bounds = batch.group_of_exchange, batch.roundtrips.bounds
    for group in dict.fromkeys(groups.tolist()):
        members = (groups == group).nonzero()[0]
        first, after = int(bounds[members[0]]), int(bounds[members[-1] + 1])
        yield group, batch.roundtrips.measured.slice(first, after - first)


def _with_group(batch: Batch, of_runs: pl.DataFrame) -> pl.DataFrame:
    """The same with the group of each run and relay first, by group."""
    described = batch.roundtrips.described.select("run_id", "relay_id").with_columns(
        pl.Series("group", batch.group_of_exchange)
    )
    return (
        of_runs.join(described, on=["run_id", "relay_id"], how="left", maintain_order="left")
        .sort("group", maintain_order=True)
        .select("group", *of_runs.columns)
    )
