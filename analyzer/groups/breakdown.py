"""Where the time of a message goes, from its planned sending to the reply in the callback.

    T0 ..waiting.. T1 ..transport.. R3 ..delivery.. T3 ..relay.. T4 ..transport.. R2 ..delivery.. T2
                   |------- outbound_ns ----------|             |--------- return_ns --------|

R3 and R2 are the middleware's reception stamps, wall clock of the device that received; where they are missing only
the whole `outbound_ns` and `return_ns` are known. The parts add up to `response_ns` exactly.

Clocks are never mixed without a bound. Between two devices it is the clock fit's. Between the wall clock and the
monotonic clock of one device: NTP slews both alike, so they differ by a constant until somebody sets the wall
clock (clock_gettime(2)). The session's anchor says the constant; the stamps check it, because a message is not
delivered before the middleware received it (`received <= T3`), nor stamped by the middleware before it was handed
over (`source >= T4`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from dds_trace.tracefile import Stage

from ..pairing.roundtrips import MIDDLEWARE_STAMPS
from .batch import grouped_rows

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..pairing.roundtrips import RoundTrips
    from .batch import Batch

STAGES = (
    "waiting_ns",
    "outbound_transport_ns",
    "relay_delivery_ns",
    "relay_ns",
    "return_transport_ns",
    "ping_delivery_ns",
)
"""The parts of a response in the order of time; each a column of `break_down`'s frame."""

_USED = (
    "group",
    "run_id",
    "relay_id",
    "bridge",
    "scheduled_ns",
    "publish_ns",
    "relay_in_ns",
    "relay_out_ns",
    "receive_ns",
    "outbound_ns",
    "intermediate_ns",
    "return_ns",
    "clock_bound_ns",
)
"""Columns of a batch's rows that its parts are made of, beside `STAMP_COLUMNS`: the others would be copied for nothing."""

_COARSE = ("waiting_ns", "outbound_ns", "relay_ns", "return_ns")
"""The parts where the middleware's reception stamps are missing."""

_SUMMARIZED = tuple(dict.fromkeys((*STAGES, *_COARSE, "clock_bound_ns", "delivery_bound_ns")))
"""Columns of `break_down`'s frame that `summarize_breakdown` needs beside those of the group."""

_DELIVERIES = ("_relay_delivery", "_relay_write", "_ping_delivery", "_ping_write")

_SLICE_ROWS = 1 << 19

STAMP_COLUMNS = (*MIDDLEWARE_STAMPS[Stage.T3], *MIDDLEWARE_STAMPS[Stage.T2])
"""`source_ns` and `received_ns` of T3 and of T2, i64, ns since 1970, null or 0 where the trace has none."""


def breakdown_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """Summarize where the time goes: `group` u32, then the columns of `summarize_breakdown`, a row per part.

    Percentiles of parts of a group do not add up, so a group that is here in part has no rows.
    """
    rows = (
        grouped_rows(batch, roundtrips, ["run_id", "relay_id", "bridge"])
        .select(_USED)
        .with_columns(roundtrips.stamps)
    )
    if not batch.whole:
        return summarize_breakdown(break_down(rows.head(0)), ["group"])
    ping_wall = {e.run.run_id: e.ping.wall_anchor_ns - e.ping.monotonic_anchor_ns for e in batch.exchanges}
    relay_wall = {
        e.relay_id: e.relay.wall_anchor_ns - e.relay.monotonic_anchor_ns for e in batch.exchanges if e.relay
    }
    parts = break_down(rows, ping_wall, relay_wall).select("group", *_SUMMARIZED)
    del rows  # of a large group a hundred megabytes of identities, which the summary has no use for
    return summarize_breakdown(parts, ["group"])


def response_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """Summarize what a schedule that was not held hides: `group` u32, then those of `response_against_latency`.

    A group that is here in part has no row, as in `breakdown_frame`.
    """
    rows = grouped_rows(batch, roundtrips, ["rate_hz"])
    return response_against_latency(rows if batch.whole else rows.head(0), ["group"])


def break_down(
    roundtrips: pl.DataFrame,
    ping_wall: Mapping[int, int] | None = None,
    relay_wall: Mapping[int, int] | None = None,
) -> pl.DataFrame:
    """Split every message's response into its parts.

    Args:
        roundtrips: frame of `docs/trace-format.md`, with the columns `STAMP_COLUMNS` where the trace has such stamps.
        ping_wall: run_id -> wall clock minus monotonic clock of the ping in ns; parts that need the offset of a run
            that is missing here are null.
        relay_wall: relay_id -> the same of the relay.

    Returns:
        The input with, all i64 ns and null where a stamp is missing: `waiting_ns` (T0 to T1: a schedule that was
        not held), `outbound_transport_ns` (T1 to R3), `relay_delivery_ns` (R3 to T3), `relay_ns` (T3 to T4),
        `return_transport_ns` (T4 to R2), `ping_delivery_ns` (R2 to T2), and `delivery_bound_ns`: how far the
        anchors of the wall clocks may be off, judged by the stamps of the message's run and relay (null where
        only one side can be judged: no source stamps, or a bridge that writes its own). A run that contradicts
        its anchor (wall clock set meanwhile) has null parts. The transports also carry `clock_bound_ns`.
    """
    offsets = _offset("run_id", pl.UInt64, ping_wall), _offset("relay_id", pl.UInt32, relay_wall)
    # Slice by slice: of each message many columns are made that nobody needs behind it.
    slices = list(roundtrips.iter_slices(_SLICE_ROWS)) or [roundtrips]
    anchors = _anchors(pl.concat([_shortest(_with_deliveries(rows, *offsets)) for rows in slices]))
    parts = pl.concat([_parts(_with_deliveries(rows, *offsets), anchors) for rows in slices], rechunk=True)
    return roundtrips.hstack(parts).with_columns(relay_ns=pl.col("intermediate_ns"))


def _with_deliveries(roundtrips: pl.DataFrame, ping: pl.Expr, relay: pl.Expr) -> pl.DataFrame:
    """Return the rows with the names of `_DELIVERIES`, from stamps of the wall clocks and these offsets to the monotonic ones."""
    missing = [pl.lit(0, pl.Int64).alias(name) for name in STAMP_COLUMNS if name not in roundtrips.columns]
    stamps = {name: pl.when(pl.col(name) != 0).then(pl.col(name)) for name in STAMP_COLUMNS}
    direct = pl.when(pl.col("bridge") == "none")
    return roundtrips.with_columns(missing).with_columns(
        _relay_delivery=pl.col("relay_in_ns") - (stamps["relay_received_ns"] - relay),
        _ping_delivery=pl.col("receive_ns") - (stamps["reply_received_ns"] - ping),
        # How long after T4 (T1) the middleware stamped the message, by the same anchor.
        _relay_write=direct.then(stamps["reply_source_ns"] - relay - pl.col("relay_out_ns")),
        _ping_write=direct.then(stamps["relay_source_ns"] - ping - pl.col("publish_ns")),
    )


def _parts(delivered: pl.DataFrame, anchors: pl.DataFrame) -> pl.DataFrame:
    """Return the columns that `break_down` adds, but for that of another name."""
    keys = ["run_id", "relay_id"]
    of_row = delivered.select(keys).join(
        anchors, on=keys, how="left", nulls_equal=True, maintain_order="left"
    )
    relay = pl.when("_relay_sound").then("_relay_delivery")
    ping = pl.when("_ping_sound").then("_ping_delivery")
    return delivered.hstack(of_row.drop(keys)).select(
        relay_delivery_ns=relay,
        ping_delivery_ns=ping,
        waiting_ns=pl.col("publish_ns") - pl.col("scheduled_ns"),
        outbound_transport_ns=pl.col("outbound_ns") - relay,
        return_transport_ns=pl.col("return_ns") - ping,
        delivery_bound_ns=pl.when(relay.is_not_null() & ping.is_not_null()).then("_anchor_bound"),
    )


def _shortest(delivered: pl.DataFrame) -> pl.DataFrame:
    """Return the least of the deliveries and writes of each run and relay."""
    return delivered.group_by("run_id", "relay_id").agg(pl.col(*_DELIVERIES).min())


def _anchors(shortest: pl.DataFrame) -> pl.DataFrame:
    """Judge the anchors of each run and relay by the shortest of its deliveries and of its writes.

    Args:
        shortest: rows of `_shortest`, several of a run and relay if it is in several slices.

    Returns:
        `run_id`, `relay_id`, `_relay_sound` and `_ping_sound`: whether its stamps agree with the anchor: nothing arrives or
        leaves before its time; `_anchor_bound`: how far the anchors may be off, as one that were later than the shortest
        delivery would make that negative, likewise early.
    """
    relay, relay_write, ping, ping_write = map(pl.col, _DELIVERIES)
    return _shortest(shortest).select(
        "run_id",
        "relay_id",
        _relay_sound=(relay >= 0) & (relay_write.fill_null(0) >= 0),
        _ping_sound=(ping >= 0) & (ping_write.fill_null(0) >= 0),
        _anchor_bound=_larger(_larger(relay, relay_write), _larger(ping, ping_write)),
    )


def _larger(one: pl.Expr, other: pl.Expr) -> pl.Expr:
    """Return the larger of two, null if either is null."""
    return pl.when(one.is_not_null() & other.is_not_null()).then(pl.max_horizontal(one, other))


def _offset(key: str, dtype: type[pl.DataType], offsets: Mapping[int, int] | None) -> pl.Expr:
    if not offsets:
        return pl.lit(None, pl.Int64)
    keys, values = pl.Series(list(offsets), dtype=dtype), pl.Series(list(offsets.values()), dtype=pl.Int64)
    return pl.col(key).replace_strict(keys, values, default=None)


def summarize_breakdown(parts: pl.DataFrame, group_columns: Sequence[str]) -> pl.DataFrame:
    """Summarize the parts: one row per group and part, for a stacked figure.

    Args:
        parts: frame of `break_down`.
        group_columns: columns that make a group.

    Returns:
        The group's columns, `part` str (a name of `STAGES`, or `outbound_ns` and `return_ns` where the middleware's
        reception stamps are missing), `order` u32 (0, 1, ... in time), `messages` u64, `mean_ns`, `p50_ns`,
        `p99_ns` f64, `bound_ns` f64 (mean bound from the clocks, 0 for parts on one clock). Only messages with
        every part of their chain count, so that the means add up to the mean response; percentiles never add up.
    """
    detailed = pl.all_horizontal(pl.col(list(STAGES)).is_not_null())
    coarse = pl.all_horizontal(pl.col(list(_COARSE)).is_not_null())
    bounds = {name: pl.lit(0.0) for name in ("waiting_ns", "relay_ns")}
    bounds |= {name: pl.col("clock_bound_ns").mean() for name in ("outbound_ns", "return_ns")}
    bounds |= {name: pl.col("delivery_bound_ns").mean() for name in ("relay_delivery_ns", "ping_delivery_ns")}
    both = pl.col("clock_bound_ns") + pl.col("delivery_bound_ns")
    bounds |= {name: both.mean() for name in ("outbound_transport_ns", "return_transport_ns")}
    keys = list(group_columns)
    shown = _kept(
        parts.select(*keys, *_SUMMARIZED),
        parts.select(coarse).to_series(),
    )
    # A group is shown in detail if every message that could be shown at all can be.
    in_detail = shown.select(detailed.all().over(keys) if keys else detailed.all()).to_series()
    tables = []
    for columns, chosen in ((STAGES, in_detail), (_COARSE, ~in_detail)):
        # Every part of the chain by one look for the groups.
        of_group = (
            _kept(shown, chosen)
            .group_by(keys, maintain_order=True)
            .agg(
                pl.len().cast(pl.UInt64).alias("messages"),
                *(pl.struct(_summary_of(name, bounds[name])).alias(name) for name in columns),
            )
        )
        tables += [
            of_group.select(
                *keys,
                pl.lit(name).alias("part"),
                pl.lit(order, pl.UInt32).alias("order"),
                "messages",
                pl.col(name).struct.unnest(),
            )
            for order, name in enumerate(columns)
        ]
    return pl.concat(tables).sort([*keys, "order"], maintain_order=True)


def _summary_of(part: str, bound: pl.Expr) -> list[pl.Expr]:
    """Return the columns of `summarize_breakdown` that are statistics of a part."""
    values = pl.col(part)
    return [
        values.mean().alias("mean_ns"),
        values.quantile(0.5, "linear").alias("p50_ns"),
        pl.when(pl.len() >= 100).then(values.quantile(0.99, "linear")).alias("p99_ns"),
        bound.alias("bound_ns"),
    ]


def _kept(rows: pl.DataFrame, chosen: pl.Series) -> pl.DataFrame:
    """Return the rows of a mask; all of them, as mostly, are not copied."""
    return rows if chosen.all() else rows.filter(chosen)


def response_against_latency(roundtrips: pl.DataFrame, group_columns: Sequence[str]) -> pl.DataFrame:
    """Compare the response times of a user with a fixed schedule with the round trips that stamps show.

    A sender that waits for itself (a blocked publish, a slow loop) sends late and then fast: its round trips look
    good and its users wait ("coordinated omission", G. Tene, "How not to measure latency", 2013). The schedule is
    open-loop and T0 is recorded, so the waiting is in `response_ns` and the difference shows it.

    Returns:
        The group's columns, `messages` u64 (with T0 and T2), `late_ratio` f64 (sent more than a tenth of the
        period after T0), `waiting_max_ns` i64, and for p50, p99 (null below 100 messages): `rtt_*_ns`,
        `response_*_ns` and `hidden_*_ns` = response - rtt, f64.
    """
    keys = list(group_columns)
    used = roundtrips.select(*keys, "publish_ns", "scheduled_ns", "response_ns", "rtt_ns", "rate_hz")
    is_complete = pl.col("response_ns").is_not_null() & pl.col("rtt_ns").is_not_null()
    complete = _kept(used, used.select(is_complete).to_series())
    waiting = pl.col("publish_ns") - pl.col("scheduled_ns")

    def quantile(column: str, q: float, needs: int) -> pl.Expr:
        return pl.when(pl.len() >= needs).then(pl.col(column).quantile(q, "linear"))

    return (
        complete.group_by(keys, maintain_order=True)
        .agg(
            pl.len().cast(pl.UInt64).alias("messages"),
            (waiting > 0.1 * 1e9 / pl.col("rate_hz")).mean().alias("late_ratio"),
            waiting.max().alias("waiting_max_ns"),
            quantile("rtt_ns", 0.5, 1).alias("rtt_p50_ns"),
            quantile("response_ns", 0.5, 1).alias("response_p50_ns"),
            quantile("rtt_ns", 0.99, 100).alias("rtt_p99_ns"),
            quantile("response_ns", 0.99, 100).alias("response_p99_ns"),
        )
        .with_columns(
            hidden_p50_ns=pl.col("response_p50_ns") - pl.col("rtt_p50_ns"),
            hidden_p99_ns=pl.col("response_p99_ns") - pl.col("rtt_p99_ns"),
        )
        .sort(keys)
    )
