"""The frames `summary` (one row per group) and `distributions` (a histogram per group and metric)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from ..model.column import schema_of
from ..model.columns import STATISTICS, SUMMARY_COLUMNS
from ..model.metrics import METRICS
from ..model.parameters import PARAMETER_COLUMNS, Parameters
from ..pairing.pair import LOSSES, OUTCOMES, Outcome
from ..statistics.histogram import Histogram, histogram_of
from ..statistics.percentiles import summarize_values

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from ..pairing.exchanges import Exchange
    from ..pairing.roundtrips import RoundTrips


_NS_PER_S = 1_000_000_000

_STATISTICS_SCHEMA: dict[str, type[pl.DataType]] = {
    "group": pl.UInt32,
    "metric": pl.String,
    "samples": pl.Int64,
    **dict.fromkeys(STATISTICS, pl.Float64),
}


@dataclass(frozen=True, slots=True, eq=False)
class Grouping:
    """Exchanges with equal parameters are one group; groups are sorted by their parameters, null last.

    Attributes:
        parameters: the parameter columns of each group.
        exchanges: by group, then as they came (by start of the run, then by relay).
        group_of_exchange: uint32, rising: for each exchange the position of its group.
    """

    parameters: pl.DataFrame
    exchanges: tuple[Exchange, ...]
    group_of_exchange: NDArray[np.uint32]

    def members(self) -> list[list[int]]:
        """For each group the positions of its exchanges."""
        found: list[list[int]] = [[] for _ in range(self.parameters.height)]
        for exchange, group in enumerate(self.group_of_exchange.tolist()):
            found[group].append(exchange)
        return found


@dataclass(frozen=True, slots=True, eq=False)
class Summary:
    """What the rows of `roundtrips` come to, group by group.

    Attributes:
        frame: the columns of `columns.SUMMARY_COLUMNS`; row i is group i.
        distributions: `group` u32, `metric` str, `value_ns` f64, `count` u64.
        samples: metric -> int64, values of each group that are not null.
        of_exchange: counts and spans of every exchange, see `count_exchanges`.
    """

    frame: pl.DataFrame
    distributions: pl.DataFrame
    samples: dict[str, NDArray[np.int64]]
    of_exchange: pl.DataFrame


@dataclass(frozen=True, slots=True, eq=False)
class Statistics:
    """The metrics of some groups.

    Attributes:
        frame: one row per group and metric: `group` u32, `metric` str, `samples` i64, and a column for each of
            `columns.STATISTICS`, f64 ns, null where the sample does not support it.
        distributions: `group` u32, `metric` str, `value_ns` f64, `count` u64: histograms.
    """

    frame: pl.DataFrame
    distributions: pl.DataFrame

    @classmethod
    def concatenate(cls, parts: Sequence[Statistics]) -> Statistics:
        """Those of all parts, one after the other."""
        return cls(pl.concat([p.frame for p in parts]), pl.concat([p.distributions for p in parts]))


def group_exchanges(exchanges: Sequence[Exchange]) -> Grouping:
    """Find the groups: exchanges that agree in every parameter column, whatever their run or relay_id."""
    parameters = [exchange.parameters() for exchange in exchanges]
    groups = sorted(set(parameters), key=Parameters.order)
    number = {key: group for group, key in enumerate(groups)}
    group_of_exchange = np.array([number[key] for key in parameters], np.uint32)
    order = np.argsort(group_of_exchange, kind="stable")
    return Grouping(
        pl.DataFrame([key.values() for key in groups], schema=schema_of(PARAMETER_COLUMNS), orient="row"),
        tuple(exchanges[position] for position in order.tolist()),
        group_of_exchange[order],
    )


def metric_values(roundtrips: RoundTrips, metric: str, first: int, after: int) -> NDArray[np.int64]:
    """The values of a metric in the rows of exchanges `first` to `after` (not included), without nulls."""
    rows = roundtrips.bounds[[first, after]].tolist()
    return roundtrips.measured[f"{metric}_ns"].slice(rows[0], rows[1] - rows[0]).drop_nulls().to_numpy()


def measure_batch(roundtrips: RoundTrips, group_of_exchange: NDArray[np.uint32]) -> Statistics:
    """Statistics and histograms of every group in rising order of `group_of_exchange`."""
    groups, first = np.unique(group_of_exchange, return_index=True)
    after = np.append(first[1:], len(group_of_exchange))
    return measure_groups(
        (group, metric, np.sort(metric_values(roundtrips, metric, start, stop)))
        for group, start, stop in zip(groups.tolist(), first.tolist(), after.tolist(), strict=True)
        for metric in METRICS
    )


def measure_groups(values: Iterable[tuple[int, str, NDArray[np.int64]]]) -> Statistics:
    """Statistics and histograms from (group, metric, values rising)."""
    rows, histograms = [], []
    for group, metric, ordered_ns in values:
        rows.append(
            {"group": group, "metric": metric, "samples": len(ordered_ns), **summarize_values(ordered_ns)}
        )
        histograms.append((group, metric, histogram_of(ordered_ns)))
    return Statistics(pl.DataFrame(rows, schema=_STATISTICS_SCHEMA), _distributions(histograms))


def summarize_groups(
    grouping: Grouping, exchanges: Sequence[Exchange], of_exchange: pl.DataFrame, statistics: Statistics
) -> Summary:
    """One row per group, from what was counted and measured batch by batch.

    Args:
        grouping: the groups.
        exchanges: in the order of `of_exchange`.
        of_exchange: frames of `count_exchanges`, one behind the other.
        statistics: of every group.
    """
    of_exchange = of_exchange.with_columns(exchange=pl.int_range(pl.len(), dtype=pl.UInt32))
    counts = _counts_and_rates(of_exchange, exchanges, grouping)
    measured = statistics.frame.sort("group", maintain_order=True)
    wide = [
        measured.filter(metric=metric).select(
            pl.col(name).alias(f"{metric}_{name}_ns") for name in STATISTICS
        )
        for metric in METRICS
    ]
    frame = pl.concat([grouping.parameters, counts, *wide], how="horizontal")
    return Summary(
        frame=frame.select(pl.col(column.name).cast(column.dtype) for column in SUMMARY_COLUMNS),
        distributions=statistics.distributions,
        samples={metric: measured.filter(metric=metric)["samples"].to_numpy() for metric in METRICS},
        of_exchange=of_exchange,
    )


def _distributions(histograms: list[tuple[int, str, Histogram]]) -> pl.DataFrame:
    lengths = [len(histogram.value_ns) for _, _, histogram in histograms]
    position = np.repeat(np.arange(len(histograms), dtype=np.uint32), lengths)
    return pl.DataFrame(
        {
            "group": pl.Series([group for group, _, _ in histograms], dtype=pl.UInt32).gather(position),
            "metric": pl.Series([metric for _, metric, _ in histograms], dtype=pl.String).gather(position),
            "value_ns": np.concatenate([np.empty(0), *(h.value_ns for _, _, h in histograms)]),
            "count": np.concatenate([np.empty(0, np.uint64), *(h.count for _, _, h in histograms)]),
        }
    )


def count_exchanges(roundtrips: RoundTrips) -> pl.DataFrame:
    """One row per exchange, in their order: everything that is a count or a span of its rows.

    Returns:
        `exchange` u32; `published`, `received`, `lost_*`, `duplicates`, `reordered`: as in the summary;
        `relay_gaps`: replies without T3 or T4; `unscheduled`: messages without T0; `negative_rtt`,
        `negative_intermediate`, `negative_latency`: times below zero; `publish_span_ns`, `relay_span_ns`,
        `reply_span_ns`: first to last T1, first T3 to last T4, first to last T2, null without two ends;
        `relayed`, `replied`: messages with T3, with T2. All null for an exchange without rows.
    """
    t0, t1, t2 = pl.col("scheduled_ns"), pl.col("publish_ns"), pl.col("receive_ns")
    t3, t4 = pl.col("relay_in_ns"), pl.col("relay_out_ns")
    outcome = pl.col("outcome_code")
    code = {kind.value: OUTCOMES.index(kind) for kind in OUTCOMES}
    found = (
        roundtrips.measured.lazy()
        .with_columns(
            pl.Series("exchange", roundtrips.exchange_of_row()),
            pl.Series("outcome_code", roundtrips.outcome),
        )
        .group_by("exchange")
        .agg(
            pl.len().alias("published"),
            (outcome == code[Outcome.COMPLETED.value]).sum().alias("received"),
            *((outcome == code[loss]).sum().alias(loss) for loss in LOSSES),
            pl.col("duplicates").cast(pl.UInt64).sum(),
            pl.col("reordered").sum(),
            (t2.is_not_null() & (t3.is_null() | t4.is_null())).sum().alias("relay_gaps"),
            t0.is_null().sum().alias("unscheduled"),
            *(
                (pl.col(f"{m}_ns") < 0).sum().alias(f"negative_{m}")
                for m in ("rtt", "intermediate", "latency")
            ),
            (t1.max() - t1.min()).alias("publish_span_ns"),
            (t4.max() - t3.min()).alias("relay_span_ns"),
            (t2.max() - t2.min()).alias("reply_span_ns"),
            t3.count().alias("relayed"),
            t2.count().alias("replied"),
        )
    )
    exchanges = pl.LazyFrame({"exchange": np.arange(len(roundtrips.exchanges), dtype=np.uint32)})
    return exchanges.join(found, on="exchange", how="left").sort("exchange").collect()


def _counts_and_rates(
    of_exchange: pl.DataFrame, exchanges: Sequence[Exchange], grouping: Grouping
) -> pl.DataFrame:
    """The columns of `columns.COUNT_COLUMNS`, one row per group."""
    recorded = pl.Series([exchange.relay_recorded for exchange in exchanges], dtype=pl.Boolean)
    payload_bytes = pl.Series([exchange.run.payload_bytes for exchange in exchanges], dtype=pl.Int64)
    moved = pl.when(recorded).then("relayed").otherwise("replied")
    return (
        of_exchange.lazy()
        .with_columns(
            pl.Series("group", grouping.group_of_exchange),
            (pl.col("published") - 1).alias("intervals"),
            (moved * payload_bytes).alias("moved_bytes"),
            pl.when(recorded).then("relay_span_ns").otherwise("reply_span_ns").alias("moved_span_ns"),
        )
        .group_by("group")
        .agg(
            pl.col("published", "received", *LOSSES, "duplicates", "reordered").sum(),
            _per_second("intervals", "publish_span_ns").alias("achieved_rate_hz"),
            _per_second("moved_bytes", "moved_span_ns").alias("transfer_rate_bytes_per_s"),
        )
        .with_columns(_ratio(pl.col("received"), pl.col("published")).alias("received_ratio"))
        .sort("group")
        .drop("group")
        .collect()
    )


def _per_second(amount: str, span_ns: str) -> pl.Expr:
    """Sum over sum: the runs of a group weigh as long as they took; a run without a duration says nothing."""
    lasted = pl.col(span_ns) > 0
    return _ratio(
        pl.col(amount).filter(lasted).sum() * float(_NS_PER_S), pl.col(span_ns).filter(lasted).sum()
    )


def _ratio(numerator: pl.Expr, denominator: pl.Expr) -> pl.Expr:
    return pl.when(denominator > 0).then(numerator / denominator)
