"""The frames `freshness` and `outages`: deadlines, age of information and outages."""

from __future__ import annotations

from collections.abc import Hashable

import polars as pl

from dds_trace.base.units import SECOND_NS

from ..clocks.boots import machine_of
from ..model.metrics import frame_schema
from ..pairing.pair import LOSSES, OUTCOMES, Outcome
from ..pairing.roundtrips import RoundTrips
from .batch import Batch, described_exchanges
from .intervals import ONE_WAY_METRICS

OUTAGE_MESSAGES = 3
"""Lost messages in a row that make an outage: single losses are loss, not an outage."""

RECOVERED_MESSAGES = 5
"""Messages in a row in time that end the recovery from an outage."""

_NEVER = {"outbound": (Outcome.LOST_OUTBOUND.value,)}
"""Outcomes of messages that surely never arrived; for other metrics all losses."""

FRESHNESS_SCHEMA = frame_schema(
    "group:u32 run_id:u64 relay_id:u32 messages:u64 deadline_ns:i64 judged:u64 missed:u64 "
    "missed_ratio:f64 longest_missed:u64 longest_missed_ns:i64 age_mean_ns:f64 age_peak_mean_ns:f64 "
    "age_peak_max_ns:i64 relay_age_mean_ns:f64 relay_age_peak_max_ns:i64 clock_bound_ns:i64 outages:u32 "
    "outage_longest_ns:i64 recovery_longest_ns:i64 unsure:u64 period_ns:i64 late_by_p50_ns:f64 late_by_p99_ns:f64 late_by_max_ns:i64 "
    "empty_periods:u64"
)

OUTAGE_SCHEMA = frame_schema(
    "group:u32 run_id:u64 relay_id:u32 first_sequence:u64 messages:u64 start_ns:i64 end_ns:i64 "
    "duration_ns:i64 recovery_ns:i64"
)
"""A run of lost messages, from T0 (else T1) of the first one to the next reception; null for a time that the run does not reach."""

_KEYS = ("group", "run_id", "relay_id")
_READ = ("sequence", "scheduled_ns", "publish_ns", "receive_ns", "relay_in_ns", "outbound_ns", "clock_bound_ns")


def freshness_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """Summarize deadline misses, age of information and outages of each run and relay with messages.

    Without a schedule the response is the round trip; docs/explanation/method.md has the rest.

    Returns:
        Columns of `FRESHNESS_SCHEMA`. `judged` includes unsent messages; `unsure` are the others; `longest_missed` in a row and
        `longest_missed_ns` to the next message in time; `age_*` of information that went to the relay and back, `relay_age_*`
        at the relay, wrong by at most `clock_bound_ns`; `late_by_*` of the messages at the relay (without its trace: of the
        replies), `empty_periods` of a control loop there (`late_by`).
    """
    is_limited = batch.options.deadline_ns is not None
    loses = _may_have_outages(roundtrips)
    rows = _rows(batch, roundtrips, is_timed=is_limited or loses)
    # Collected one after the other: each copies some columns of all messages.
    back, there = (age_of_information(rows, name).collect().lazy() for name in ("receive_ns", "arrived_ns"))
    outages = (
        find_outages(rows if loses else rows.head(0))
        .group_by("exchange")
        .agg(
            outages=pl.len(),
            outage_longest_ns=pl.col("duration_ns").max(),
            recovery_longest_ns=pl.col("recovery_ns").max(),
        )
    )
    frame = (
        described_exchanges(batch)
        .lazy()
        .with_columns(roundtrips.counts["unsent"])
        .join(
            rows.lazy().group_by("exchange").agg(pl.len().alias("messages"), pl.col("clock_bound_ns").max()),
            on="exchange",
        )
        .join(_misses(rows, batch.options.deadline_ns), on="exchange", how="left")
        .join(back.select("exchange", pl.exclude("exchange").name.prefix("age_")), on="exchange", how="left")
        .join(there.select("exchange", pl.exclude("exchange").name.prefix("relay_age_")), on="exchange", how="left")
        .join(_late(rows, batch).collect().lazy(), on="exchange", how="left")
        .join(outages, on="exchange", how="left")
        .with_columns(
            pl.col("outages").fill_null(0),
            pl.when(pl.col("relay_age_mean_ns").is_not_null()).then("clock_bound_ns").alias("clock_bound_ns"),
            # Unsent messages were due after the last sent one.
            pl.col("judged", "missed") + pl.col("unsent"),
            longest_missed=pl.max_horizontal(
                "longest_missed", pl.when(pl.col("unsent") > 0).then(pl.col("last_missed") + pl.col("unsent"))
            ),
        )
        .with_columns(missed_ratio=pl.when(pl.col("judged") > 0).then(pl.col("missed") / pl.col("judged")))
        .sort(_KEYS)
        .select(pl.col(name).cast(kind) for name, kind in FRESHNESS_SCHEMA.items())
    )
    return frame.collect()


def outage_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    if not _may_have_outages(roundtrips):
        return pl.DataFrame(schema=OUTAGE_SCHEMA)
    outages = described_exchanges(batch).lazy().join(find_outages(_rows(batch, roundtrips)), on="exchange")
    return outages.sort(*_KEYS, "row").select(pl.col(name).cast(kind) for name, kind in OUTAGE_SCHEMA.items()).collect()


def _may_have_outages(roundtrips: RoundTrips) -> bool:
    lost = roundtrips.counts.select(pl.sum_horizontal(LOSSES)).to_series()
    return bool((lost >= OUTAGE_MESSAGES).any())


def _rows(batch: Batch, roundtrips: RoundTrips, *, is_timed: bool = True) -> pl.DataFrame:
    """Return the messages, `arrived_ns` at the relay on the ping's clock; not sure: neither `missed` nor `in_time`.

    Without a deadline none is missed, and in time is what took as long as 90 % of the run's messages; none unless it `is_timed`.
    """
    deadline_ns, metric = batch.options.deadline_ns, batch.options.deadline_metric
    planned = pl.coalesce("scheduled_ns", "publish_ns")
    # A message without a schedule responds from T1 on.
    names = ("response_ns", "rtt_ns") if metric == "response" else (f"{metric}_ns",)
    value = pl.coalesce(names)
    bound = pl.col("clock_bound_ns") if metric in ONE_WAY_METRICS else 0
    never = [OUTCOMES.index(Outcome(outcome)) for outcome in _NEVER.get(metric, LOSSES)]
    usual = pl.col("receive_ns") - planned
    in_time = usual <= usual.quantile(0.9, "linear").over("exchange") if is_timed else pl.lit(False)
    missed = pl.lit(False)
    if deadline_ns is not None:
        in_time = value + bound <= deadline_ns
        missed = pl.col("code").is_in(never) | (value - bound > deadline_ns).fill_null(False)
    exchange, first_of = roundtrips.exchange_of_row(), _first_of_restarted(batch, roundtrips)
    for restarted, first in first_of.items():
        exchange[roundtrips.bounds[restarted] : roundtrips.bounds[restarted + 1]] = first
    rows = roundtrips.select(list(dict.fromkeys((*_READ, *(names if deadline_ns is not None else ())))))
    rows = rows.with_columns(pl.Series("exchange", exchange), pl.Series("code", roundtrips.outcome))
    return (rows.sort("exchange", "sequence") if first_of else rows).select(
        pl.col("exchange").set_sorted(),
        "sequence",
        "receive_ns",
        "relay_in_ns",
        "clock_bound_ns",
        planned_ns=planned,
        arrived_ns=pl.when(pl.col("clock_bound_ns").is_not_null()).then(pl.col("publish_ns") + pl.col("outbound_ns")),
        lost=pl.col("code") != OUTCOMES.index(Outcome.COMPLETED),
        missed=missed,
        in_time=in_time.fill_null(False),
    )


def _first_of_restarted(batch: Batch, roundtrips: RoundTrips) -> dict[int, int]:
    relays = {
        at: exchange.relay
        for at, exchange in enumerate(batch.exchanges)
        if exchange.relay is not None and exchange.relays > 1
    }
    sequence, bounds = roundtrips.measured["sequence"], roundtrips.bounds.tolist()
    ends = ((bounds[at], bounds[at + 1], at) for at in relays)
    spans = [(sequence[first], sequence[end - 1], at) for first, end, at in ends if first < end]
    first_of: dict[int, int] = {}
    latest: dict[Hashable, tuple[int, int]] = {}
    for first_sequence, last_sequence, at in sorted(spans):
        key = batch.group_of_exchange[at], batch.exchanges[at].run.run_id, machine_of(relays[at])
        first, ended = latest.get(key, (at, -1))
        if first != at and ended < first_sequence:
            first_of[at] = first
        latest[key] = first_of.get(at, at), last_sequence
    return first_of


def runs_of(rows: pl.DataFrame, happened: pl.Expr) -> pl.LazyFrame:
    """Return the first message of each run of an exchange's messages for which it `happened`.

    `end_row` is the index after the last; the message there was due at `next_planned_ns` and received at `end_ns`, null at the end of
    the exchange.
    """
    keys = ("exchange", "happened")
    return (
        rows.lazy()
        .with_columns(happened=happened)
        .with_row_index("row")
        .filter(pl.any_horizontal((pl.col(key) != pl.col(key).shift()).fill_null(True) for key in keys))
        .with_columns(end_row=pl.col("row").shift(-1, fill_value=rows.height))
        .with_columns(
            messages=pl.col("end_row") - pl.col("row"),
            next_planned_ns=pl.col("planned_ns").shift(-1).over("exchange"),
            end_ns=pl.col("receive_ns").shift(-1).over("exchange"),
        )
        .filter("happened")
    )


def _misses(rows: pl.DataFrame, deadline_ns: int | None) -> pl.LazyFrame:
    """No row without a deadline; `last_missed` in a row are the last ones of the exchange."""
    if deadline_ns is None:
        rows = rows.head(0)
    last = pl.col("end_row") == pl.col("end_row").max()
    until_ns = pl.coalesce("next_planned_ns", pl.lit(rows["planned_ns"]).gather(pl.col("end_row") - 1))
    runs = runs_of(rows, pl.col("missed")).with_columns(lasted_ns=until_ns - pl.col("planned_ns"))
    longest = runs.group_by("exchange").agg(
        longest_missed=pl.col("messages").max(),
        longest_missed_ns=pl.col("lasted_ns").max(),
        last_missed=pl.col("messages").filter(last & pl.col("next_planned_ns").is_null()).first(),
    )
    sure = pl.col("missed") | pl.col("in_time")
    return (
        rows.lazy()
        .group_by("exchange")
        .agg(judged=sure.sum(), unsure=(~sure).sum(), missed=pl.col("missed").sum())
        .join(longest, on="exchange", how="left")
        .select("exchange", pl.exclude("exchange").fill_null(0), deadline_ns=pl.lit(deadline_ns, pl.Int64))
    )


def age_of_information(rows: pl.DataFrame, received: str) -> pl.LazyFrame:
    """Return the age of the newest information at a receiver, ns, of each exchange with two updates.

    `planned_ns` and `received` are the times at which received messages were made and received, g and r, on one clock. The age rises
    from `r[k] - g[k]` at update k to the peak `r[k+1] - g[k]`; an older message that comes late changes nothing.

    Returns:
        `updates`, `mean_ns` over the time from the first to the last, `peak_mean_ns`, `peak_max_ns`.
    """
    planned, came = pl.col("planned_ns"), pl.col(received)
    updates = rows.select("exchange", "planned_ns", received).drop_nulls(received)
    peak, fallen = came.shift(-1) - planned, (came - planned).filter(came.shift(-1).is_not_null())
    area = peak.drop_nulls().cast(pl.Float64) ** 2 - fallen.cast(pl.Float64) ** 2
    exchange, *times = (updates[name].to_numpy() for name in updates.columns)
    follows = exchange[1:] == exchange[:-1]
    if all((follows <= (time[1:] > time[:-1])).all() for time in times) and (exchange[1:] >= exchange[:-1]).all():
        newest = updates.lazy().with_columns(pl.col("exchange").set_sorted())
    else:
        newest = (
            updates.lazy()
            .sort("exchange", received, "planned_ns")
            .filter((planned > planned.cum_max().shift()).fill_null(True).over("exchange"))
            # Of several updates at one instant the last one counts: the others were never the newest.
            .filter((came != came.shift(-1)).fill_null(True).over("exchange"))
        )
    return (
        newest.group_by("exchange")
        .agg(
            updates=pl.len(),
            mean_ns=(area / 2).sum() / (came.last() - came.first()),
            peak_mean_ns=peak.mean(),
            peak_max_ns=peak.max(),
        )
        .filter(pl.col("updates") > 1)
    )


def late_by(rows: pl.LazyFrame) -> pl.LazyFrame:
    """Return by how much messages came later than one `period_ns` after the newest before them, ns, and the empty periods.

    A control loop of that period which begins at the first message has nothing new in an empty period. `received_ns` are the times
    of reception on one clock in the order of sending; a message that an older one overtook changes nothing.

    Returns:
        `late_by_p50_ns`, `late_by_p99_ns`, `late_by_max_ns` and `empty_periods` of each exchange with two such messages.
    """
    received, period_ns = pl.col("received_ns"), pl.col("period_ns")
    late_ns = (received.diff().drop_nulls() - period_ns.first()).clip(0)
    ticks = (received - received.first() + period_ns // 2) // period_ns
    return (
        rows.filter(received == received.cum_max().over("exchange"))
        .group_by("exchange")
        .agg(
            period_ns.first(),
            received=pl.len(),
            late_by_p50_ns=late_ns.quantile(0.5, "linear"),
            late_by_p99_ns=late_ns.quantile(0.99, "linear"),
            late_by_max_ns=late_ns.max(),
            empty_periods=ticks.last() - (ticks.diff() > 0).sum(),  # they ascend
        )
        .filter(pl.col("received") > 1)  # else one message, or all later ones overtaken
    )


def _late(rows: pl.DataFrame, batch: Batch) -> pl.LazyFrame:
    rates_hz = [exchange.run.rate_hz for exchange in batch.exchanges]
    periods_ns = [round(SECOND_NS / rate_hz) if rate_hz > 0 else 0 for rate_hz in rates_hz]
    is_relayed = pl.col("relay_in_ns").is_not_null().any().over("exchange")
    received = rows.lazy().select(
        "exchange",
        received_ns=pl.when(is_relayed).then("relay_in_ns").otherwise("receive_ns"),
        period_ns=pl.lit(pl.Series(periods_ns, dtype=pl.Int64)).gather("exchange"),
    )
    return late_by(received.filter(pl.col("received_ns").is_not_null(), pl.col("period_ns") > 0))


def find_outages(rows: pl.DataFrame) -> pl.LazyFrame:
    """Return outages by the index of the exchange, `row` is the index of its first lost message."""
    steady = runs_of(rows, pl.col("in_time") & ~pl.col("lost")).filter(pl.col("messages") >= RECOVERED_MESSAGES)
    return (
        runs_of(rows, pl.col("lost"))
        .filter(pl.col("messages") >= OUTAGE_MESSAGES)
        .join_asof(
            steady.select("exchange", "row", steady_ns="receive_ns"),
            left_on="end_row",
            right_on="row",
            by="exchange",
            strategy="forward",
            check_sortedness=False,  # it is by exchange, which polars cannot check
        )
        .select(
            "exchange",
            "row",
            "messages",
            "end_ns",
            first_sequence="sequence",
            start_ns="planned_ns",
            duration_ns=pl.col("end_ns") - pl.col("planned_ns"),
            recovery_ns=(pl.col("steady_ns") - pl.col("end_ns")).clip(0),
        )
    )
