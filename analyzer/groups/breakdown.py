"""The frames `breakdown` and `responses`: where the time of a message goes, from planned sending to reply.

    T0 ..waiting.. T1 ..transport.. R3 ..delivery.. T3 ..relay.. T4 ..transport.. R2 ..delivery.. T2
                   |------- outbound_ns ----------|             |--------- return_ns --------|

R3 and R2 are the middleware's reception stamps, on wall clocks. Wall clock and monotonic clock of a device differ by a constant,
the session's anchor, until somebody sets the wall clock (clock_gettime(2)). The stamps check it: no message is delivered before
it is received (`received <= T3`), nor stamped before it is handed over (`source >= T4`).
"""

from __future__ import annotations

import polars as pl

from dds_trace.tracefile.format.descriptions import Session
from dds_trace.tracefile.format.events import Stage

from ..model.metrics import frame_schema
from ..pairing.roundtrips import MIDDLEWARE_STAMPS, RoundTrips
from ..statistics.percentiles import minimum_messages
from .batch import Batch, described_exchanges

STAGES = (
    "waiting_ns",
    "outbound_transport_ns",
    "relay_delivery_ns",
    "relay_ns",
    "return_transport_ns",
    "ping_delivery_ns",
)

_ANCHORED = ("relay_delivery_ns", "ping_delivery_ns", "relay_write_ns", "ping_write_ns")
"""Deliveries and writes of relay and ping bound an anchor from both sides."""

_P99 = minimum_messages(0.99)

_PART_COLUMNS = ("scheduled_ns", "outbound_ns", "intermediate_ns", "return_ns", "clock_bound_ns")
"""Parts of a response; only messages with all of them are shown."""

BREAKDOWN_SCHEMA = frame_schema(
    "group:u32 part:str order:u32 messages:u64 mean_ns:f64 p50_ns:f64 p99_ns:f64 bound_ns:f64"
)

RESPONSE_SCHEMA = frame_schema(
    "group:u32 messages:u64 late_ratio:f64 waiting_max_ns:i64 rtt_p50_ns:f64 response_p50_ns:f64 "
    "rtt_p99_ns:f64 response_p99_ns:f64 hidden_p50_ns:f64 hidden_p99_ns:f64"
)


def breakdown_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """Summarize where the time of each whole group goes, a row per part.

    Only messages with all parts count, so that the means add up to the mean response. `part` is a name of `STAGES`, or
    `outbound_ns` and `return_ns` where a reception stamp is missing or contradicts its anchor; `p99_ns` is null below 100
    messages, `bound_ns` (mean bound of the clocks) where an anchor is bounded on one side only.
    """
    if not batch.whole:
        return pl.DataFrame(schema=BREAKDOWN_SCHEMA)
    messages, is_stamped = _messages(batch, roundtrips), bool(roundtrips.stamps)
    deliveries = pl.when("is_sound").then(pl.col(_ANCHORED[:2]))
    # By exchange: a join would copy all columns.
    anchors = described_exchanges(batch).join(
        _anchors(messages).collect(), on="group", how="left", maintain_order="left"
    )
    anchored = {name: pl.lit(anchors[name]).gather("exchange") for name in ("is_sound", "anchor_ns", "with_clock_ns")}
    is_sound, clock_ns = pl.col("is_sound").first(), pl.col("clock_bound_ns").mean()
    anchor_ns, with_clock_ns = pl.col("anchor_ns").first(), pl.col("with_clock_ns").first()
    there, back = (pl.col(name) for name in _ANCHORED[:2])

    def part(order: int, whole_way: str, values: pl.Expr, bound_ns: pl.Expr) -> pl.Expr:
        return pl.struct(
            part=pl.when(is_sound).then(pl.lit(STAGES[order])).otherwise(pl.lit(whole_way)),
            messages=pl.len(),
            mean_ns=values.mean(),
            p50_ns=values.median(),
            p99_ns=pl.when(pl.len() >= _P99).then(values.quantile(0.99, "linear")),
            bound_ns=bound_ns,
        ).alias(STAGES[order])

    way_ns = pl.when(is_sound).then(with_clock_ns).otherwise(clock_ns)
    parts = [
        part(0, "waiting_ns", pl.col("waiting_ns"), pl.lit(0.0)),
        part(1, "outbound_ns", pl.col("outbound_ns") - there.fill_null(0), way_ns),
        *([part(2, "", there, anchor_ns)] if is_stamped else []),
        part(3, "relay_ns", pl.col("intermediate_ns"), pl.lit(0.0)),
        part(4, "return_ns", pl.col("return_ns") - back.fill_null(0), way_ns),
        *([part(5, "", back, anchor_ns)] if is_stamped else []),
    ]
    complete = messages.filter("is_complete").with_columns(**anchored).with_columns(deliveries).group_by("group")
    queries = [[values] for values in parts] if roundtrips.exchanges else [parts]  # of many rows one after the other
    return (
        pl.concat([complete.agg(query).unpivot(index="group").collect() for query in queries])
        .lazy()
        .unnest("value")
        .drop_nulls("mean_ns")  # without a delivery
        .sort("group", maintain_order=True)
        .with_columns(order=pl.int_range(pl.len()).over("group"))
        .select(pl.col(name).cast(kind) for name, kind in BREAKDOWN_SCHEMA.items())
        .collect()
    )


def _messages(batch: Batch, roundtrips: RoundTrips) -> pl.LazyFrame:
    """Return the parts of each message; stamps prove nothing unless both devices have reception stamps."""
    stamps = roundtrips.stamp_names
    exchanges = pl.DataFrame(
        {
            "group": batch.group_of_exchange,
            "ping_wall_ns": [_wall_ns(exchange.ping) for exchange in batch.exchanges],
            "relay_wall_ns": [_wall_ns(exchange.relay) for exchange in batch.exchanges],
            "is_direct": roundtrips.described["bridge"] == "none",
        },
        {"group": pl.UInt32, "ping_wall_ns": pl.Int64, "relay_wall_ns": pl.Int64, "is_direct": pl.Boolean},
    )
    exchange = pl.Series("exchange", roundtrips.exchange_of_row())
    per_row = {name: pl.lit(exchanges[name]).gather("exchange") for name in exchanges.columns}
    ping_wall, relay_wall, is_direct = (per_row[name] for name in exchanges.columns[1:])
    source, received, reply_source, reply_received = (
        pl.col(name).replace(0, None) if name in stamps else pl.lit(None, pl.Int64)
        for name in (*MIDDLEWARE_STAMPS[Stage.T3], *MIDDLEWARE_STAMPS[Stage.T2])
    )
    columns = ("scheduled_ns", "publish_ns", "relay_in_ns", "relay_out_ns", "receive_ns", *_PART_COLUMNS[1:])
    return (
        pl.DataFrame([exchange, *map(roundtrips.column, (*columns, *stamps))])
        .lazy()
        .select(
            "exchange",
            *_PART_COLUMNS[1:],
            group=per_row["group"],
            is_complete=pl.all_horizontal(pl.col(_PART_COLUMNS).is_not_null()),
            waiting_ns=pl.col("publish_ns") - pl.col("scheduled_ns"),
            relay_delivery_ns=pl.col("relay_in_ns") - (received - relay_wall),
            ping_delivery_ns=pl.col("receive_ns") - (reply_received - ping_wall),
            relay_write_ns=pl.when(is_direct).then(reply_source - relay_wall - pl.col("relay_out_ns")),
            ping_write_ns=pl.when(is_direct).then(source - ping_wall - pl.col("publish_ns")),
        )
    )


def _wall_ns(session: Session | None) -> int | None:
    return None if session is None else session.wall_anchor_ns - session.monotonic_anchor_ns


def _anchors(messages: pl.LazyFrame) -> pl.LazyFrame:
    """Return of each group whether no stamp contradicts the anchors, their mean bound, and this plus the clocks' bound.

    A larger error of an anchor than the shortest delivery and write would make one of these negative.
    """
    times, is_complete = pl.col(_ANCHORED), pl.col("is_complete")
    shortest_ns, count, is_judged = pl.col(_ANCHORED), pl.col("count"), pl.col("is_judged")
    weighted_ns = (count * pl.col("bound_ns")).filter(is_judged).sum()
    judged = count.filter(is_judged).sum()
    return (
        messages.group_by("group", "exchange")
        .agg(
            times.min(),
            count=is_complete.sum(),
            lacking=pl.sum_horizontal(pl.col(_ANCHORED[:2]).filter(is_complete).null_count()),
            clock_ns=pl.col("clock_bound_ns").filter(is_complete).sum(),
        )
        .filter(count > 0)
        .with_columns(
            is_judged=pl.all_horizontal(shortest_ns.is_not_null()),
            bound_ns=pl.max_horizontal(shortest_ns),
            least_ns=pl.min_horizontal(shortest_ns),
        )
        .group_by("group")
        .agg(
            is_sound=(pl.col("lacking").sum() == 0) & (pl.col("least_ns") >= 0).all(),
            anchor_ns=pl.when(judged > 0).then(weighted_ns / judged),
            with_clock_ns=pl.when(judged > 0).then((weighted_ns + pl.col("clock_ns").filter(is_judged).sum()) / judged),
        )
    )


def response_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """Compare response times with round trips of each whole group; late were more than a tenth of the period after T0."""
    if not batch.whole:
        return pl.DataFrame(schema=RESPONSE_SCHEMA)
    names = ("scheduled_ns", "publish_ns", "response_ns", "rtt_ns")
    waiting_ns, period_ns = pl.col("publish_ns") - pl.col("scheduled_ns"), 1e9 / pl.col("rate_hz").first()
    times = {name: pl.col(f"{name}_ns") for name in ("rtt", "response")}
    enough = pl.len() >= _P99
    responses = (
        pl.DataFrame([roundtrips.column(name) for name in names])
        .with_columns(
            pl.Series("group", roundtrips.per_row(batch.group_of_exchange)).set_sorted(),
            roundtrips.described["rate_hz"].gather(roundtrips.exchange_of_row()),
        )
        .drop_nulls("response_ns")
        .group_by("group", maintain_order=True)
        .agg(
            messages=pl.len(),
            late_ratio=(waiting_ns > 0.1 * period_ns).fill_null(False).mean(),
            waiting_max_ns=waiting_ns.max(),
            **{f"{name}_p50_ns": time.median() for name, time in times.items()},
            **{f"{name}_p99_ns": pl.when(enough).then(time.quantile(0.99, "linear")) for name, time in times.items()},
        )
    )
    hidden = {f"hidden_{p}_ns": pl.col(f"response_{p}_ns") - pl.col(f"rtt_{p}_ns") for p in ("p50", "p99")}
    return responses.with_columns(**hidden).select(pl.col(n).cast(kind) for n, kind in RESPONSE_SCHEMA.items())
