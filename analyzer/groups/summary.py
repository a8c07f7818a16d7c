"""Statistics and histograms of groups, and the frame `summary`: one row per group, from all batches."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from dds_trace.base.units import SECOND_NS
from dds_trace.tracefile.format.descriptions import Session
from dds_trace.tracefile.format.json_fields import number_of, object_of

from ..model.columns import SUMMARY_COLUMNS
from ..model.metrics import METRICS
from ..model.runs import MOST_MESSAGES
from ..pairing.pair import LOSSES
from ..pairing.roundtrips import RoundTrips
from ..statistics.percentiles import STATISTICS, Histogram, histogram_of, summarize_values
from .batch import Grouping, present

_STATISTICS_SCHEMA: dict[str, type[pl.DataType]] = {
    "group": pl.UInt32,
    "metric": pl.String,
    "samples": pl.Int64,
    **{statistic.name: pl.Float64 for statistic in STATISTICS},
}


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    samples: int
    statistics: Mapping[str, float | None]
    histogram: Histogram

    @classmethod
    def of(cls, ordered_ns: NDArray[np.int64]) -> Measured:
        return cls(len(ordered_ns), summarize_values(ordered_ns), histogram_of(ordered_ns))


@dataclass(frozen=True, slots=True, eq=False)
class Statistics:
    """Statistics (`samples` and `percentiles.STATISTICS`, ns) and histograms of each metric of some groups."""

    frame: pl.DataFrame
    distributions: pl.DataFrame

    @classmethod
    def of(cls, metrics: Iterable[tuple[int, str, Measured]]) -> Statistics:
        all_metrics = list(metrics)
        rows = [{"group": g, "metric": metric, "samples": m.samples, **m.statistics} for g, metric, m in all_metrics]
        histograms = [(group, metric, measured.histogram) for group, metric, measured in all_metrics]
        return cls(pl.DataFrame(rows, schema=_STATISTICS_SCHEMA), _distributions(histograms))

    @classmethod
    def concatenate(cls, parts: Sequence[Statistics]) -> Statistics:
        return cls(pl.concat([p.frame for p in parts]), pl.concat([p.distributions for p in parts]))


def metric_values(roundtrips: RoundTrips, metric: str, first: int, after: int) -> NDArray[np.int64]:
    rows = roundtrips.bounds[[first, after]].tolist()
    return present(roundtrips.column(f"{metric}_ns").slice(rows[0], rows[1] - rows[0]))


def measure_batch(roundtrips: RoundTrips, group_of_exchange: NDArray[np.uint32]) -> Statistics:
    groups, first = np.unique(group_of_exchange, return_index=True)
    after = np.append(first, len(group_of_exchange))[1:]
    return measure_groups(
        (group, metric, np.sort(metric_values(roundtrips, metric, start, stop)))
        for group, start, stop in zip(groups.tolist(), first.tolist(), after.tolist(), strict=True)
        for metric in METRICS
    )


def measure_groups(values: Iterable[tuple[int, str, NDArray[np.int64]]]) -> Statistics:
    return Statistics.of((group, metric, Measured.of(ordered_ns)) for group, metric, ordered_ns in values)


def _distributions(histograms: list[tuple[int, str, Histogram]]) -> pl.DataFrame:
    lengths = [len(histogram.value_ns) for _, _, histogram in histograms]
    index = np.repeat(np.arange(len(histograms), dtype=np.uint32), lengths)
    return pl.DataFrame(
        {
            "group": pl.Series([group for group, _, _ in histograms], dtype=pl.UInt32).gather(index),
            "metric": pl.Series([metric for _, metric, _ in histograms], dtype=pl.String).gather(index),
            "value_ns": np.concatenate([np.empty(0), *(h.value_ns for _, _, h in histograms)]),
            "count": np.concatenate([np.empty(0, np.uint64), *(h.count for _, _, h in histograms)]),
        }
    )


EVENTS_IN_RELAY = 2
"""Events recorded while a message is in the relay: T3 and T4."""


def own_cost_ns(ping: Session, relay: Session | None) -> float | None:
    """Return the part of a round trip that both nodes take themselves, ns; None where a side did not measure it."""
    if relay is None:
        return None
    there, back = (_median_ns(side, "client_library_floor", "median_ns") for side in (ping, relay))
    if there is None or back is None:
        return None
    return there + back + EVENTS_IN_RELAY * (_median_ns(relay, "recorder_cost", "record_median_ns") or 0.0)


def _median_ns(session: Session, part: str, name: str) -> float | None:
    value = number_of(object_of(session.extra.get(part)).get(name))
    return float(value) if value is not None and value >= 0 else None


@dataclass(frozen=True, slots=True, eq=False)
class Summary:
    frame: pl.DataFrame
    distributions: pl.DataFrame
    samples: dict[str, NDArray[np.int64]]
    exchange_counts: pl.DataFrame

    def unsent_by_run(self, grouping: Grouping) -> dict[int, int]:
        unsent: dict[int, int] = {}
        counts = self.exchange_counts["unsent"].fill_null(0).to_list()
        for exchange, count in zip(grouping.exchanges, counts, strict=True):
            if count:
                unsent[exchange.run.run_id] = max(count, unsent.get(exchange.run.run_id, 0))
        return unsent


def summarize_groups(grouping: Grouping, exchange_counts: pl.DataFrame, statistics: Statistics) -> Summary:
    measured = statistics.frame.sort("group", maintain_order=True)
    wide = [
        measured.filter(metric=metric).select(pl.col(s.name).alias(f"{metric}_{s.name}_ns") for s in STATISTICS)
        for metric in METRICS
    ]
    counts = _counts_and_rates(exchange_counts, grouping)
    frame = pl.concat([grouping.parameters, counts, *wide], how="horizontal").with_columns(
        ratio(pl.col("own_cost_ns"), pl.col("rtt_p50_ns")).alias("own_share")
    )
    return Summary(
        frame=frame.select(pl.col(column.name).cast(column.dtype) for column in SUMMARY_COLUMNS),
        distributions=statistics.distributions,
        samples={metric: measured.filter(metric=metric)["samples"].to_numpy() for metric in METRICS},
        exchange_counts=exchange_counts,
    )


def _counts_and_rates(exchange_counts: pl.DataFrame, grouping: Grouping) -> pl.DataFrame:
    exchanges = grouping.exchanges
    recorded = pl.Series([exchange.relay_recorded for exchange in exchanges], dtype=pl.Boolean)
    payload_bytes = pl.Series([exchange.run.payload_bytes for exchange in exchanges], dtype=pl.Int64)
    planned = [min(max(exchange.run.planned_messages, 0), MOST_MESSAGES) for exchange in exchanges]
    own_ns = [own_cost_ns(exchange.ping, exchange.relay) for exchange in exchanges]
    all_pinged = pl.Series([exchange.run.ping_every == 1 for exchange in exchanges], dtype=pl.Boolean)
    moved = pl.when(recorded).then("reached").when(all_pinged).then("replied")
    return (
        exchange_counts.lazy()
        .with_columns(
            pl.Series("group", grouping.group_of_exchange),
            pl.Series("run_id", [exchange.run.run_id for exchange in exchanges], dtype=pl.UInt64),
            pl.Series("planned", planned, dtype=pl.Int64),
            pl.Series("environment", [exchange.environment() for exchange in exchanges], dtype=pl.String),
            pl.Series("own_cost_ns", own_ns, dtype=pl.Float64),
            (pl.col("sent") - 1).alias("intervals"),
            moved.alias("reached"),
            (moved * payload_bytes).alias("moved_bytes"),
            pl.when(recorded).then("relay_span_ns").otherwise("reply_span_ns").alias("moved_span_ns"),
        )
        .group_by("group")
        .agg(
            pl.col("published", "received", *LOSSES, "duplicates", "reordered", "planned", "unsent", "sent").sum(),
            pl.when(pl.col("reached").null_count() == 0).then(pl.col("reached").sum()).alias("reached"),
            pl.col("run_id").n_unique().alias("runs"),
            pl.col("environment").unique().sort().str.join("+"),
            pl.col("own_cost_ns").median(),
            _per_second("intervals", "publish_span_ns").alias("achieved_rate_hz"),
            _per_second("moved_bytes", "moved_span_ns").alias("transfer_rate_bytes_per_s"),
            _per_second("reached", "moved_span_ns").alias("reached_rate_hz"),
        )
        .with_columns(ratio(pl.col("received"), pl.col("published")).alias("received_ratio"))
        .sort("group")
        .drop("group")
        .collect()
    )


def _per_second(amount: str, span_ns: str) -> pl.Expr:
    """Divide sum by sum, so that runs weigh by their duration; a run without a duration does not count."""
    lasted = pl.col(span_ns) > 0
    return ratio(pl.col(amount).filter(lasted).sum() * float(SECOND_NS), pl.col(span_ns).filter(lasted).sum())


def ratio(numerator: pl.Expr, denominator: pl.Expr) -> pl.Expr:
    return pl.when(denominator > 0).then(numerator / denominator)
