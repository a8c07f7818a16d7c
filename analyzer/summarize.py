"""The frames `summary` (one row per group) and `distributions` (a histogram per group and metric)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from analyzer.columns import PARAMETER_COLUMNS, STATISTICS, SUMMARY_COLUMNS, schema_of
from analyzer.metrics import METRICS
from analyzer.pair import Outcome
from analyzer.statistics import histogram_of, summarize_values

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from analyzer.exchanges import Exchange
    from analyzer.roundtrips import RoundTrips


_NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Grouping:
    """Exchanges with equal parameters are one group; groups are sorted by their parameters, null last.

    Attributes:
        parameters: the parameter columns of each group.
        group_of_exchange: uint32, for each exchange the position of its group.
    """

    parameters: pl.DataFrame
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
    """

    frame: pl.DataFrame
    distributions: pl.DataFrame
    samples: dict[str, NDArray[np.int64]]


def group_exchanges(exchanges: Sequence[Exchange]) -> Grouping:
    """Find the groups: exchanges that agree in every parameter column, whatever their run or relay_id."""
    parameters = [exchange.parameters() for exchange in exchanges]
    groups = sorted(set(parameters), key=lambda values: [(value is None, value) for value in values])
    number = {values: group for group, values in enumerate(groups)}
    return Grouping(
        pl.DataFrame(groups, schema=schema_of(PARAMETER_COLUMNS), orient="row"),
        np.array([number[values] for values in parameters], np.uint32),
    )


def summarize_groups(roundtrips: RoundTrips, grouping: Grouping) -> Summary:
    """Counts, rates, statistics and histograms of every group."""
    groups = grouping.parameters.height
    statistics: dict[str, list[float | None]] = {
        f"{metric}_{statistic}_ns": [] for metric in METRICS for statistic in STATISTICS
    }
    samples = {metric: np.zeros(groups, np.int64) for metric in METRICS}
    distributions = [pl.DataFrame(schema=_DISTRIBUTION_SCHEMA)]
    for group, members in enumerate(grouping.members()):
        for metric in METRICS:
            values_ns = _values(roundtrips, f"{metric}_ns", members)
            samples[metric][group] = len(values_ns)
            for statistic, value in summarize_values(values_ns).items():
                statistics[f"{metric}_{statistic}_ns"].append(value)
            distributions.append(_distribution(group, metric, values_ns))
    measured = pl.DataFrame(statistics, schema=dict.fromkeys(statistics, pl.Float64))
    frame = pl.concat(
        [grouping.parameters, _counts_and_rates(roundtrips, grouping), measured], how="horizontal"
    )
    return Summary(
        frame.select(pl.col(column.name).cast(column.dtype) for column in SUMMARY_COLUMNS),
        pl.concat(distributions),
        samples,
    )


def _values(roundtrips: RoundTrips, column: str, members: Iterable[int]) -> NDArray[np.int64]:
    """The column's values in the rows of some exchanges, without nulls."""
    series = roundtrips.frame[column]
    parts = [
        series.slice(first, after - first).drop_nulls().to_numpy()
        for first, after in ((int(roundtrips.bounds[m]), int(roundtrips.bounds[m + 1])) for m in members)
    ]
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


_DISTRIBUTION_SCHEMA = {"group": pl.UInt32, "metric": pl.String, "value_ns": pl.Float64, "count": pl.UInt64}


def _distribution(group: int, metric: str, values_ns: NDArray[np.int64]) -> pl.DataFrame:
    histogram = histogram_of(values_ns)
    return pl.DataFrame({"value_ns": histogram.value_ns, "count": histogram.count}).select(
        pl.lit(group, pl.UInt32).alias("group"), pl.lit(metric).alias("metric"), "value_ns", "count"
    )


def _counts_and_rates(roundtrips: RoundTrips, grouping: Grouping) -> pl.DataFrame:
    """The columns of `columns.COUNT_COLUMNS`, one row per group."""
    publish, receive = pl.col("publish_ns"), pl.col("receive_ns")
    relay_in, relay_out = pl.col("relay_in_ns"), pl.col("relay_out_ns")
    outcome = pl.col("outcome")
    payload = pl.col("payload_bytes").cast(pl.Int64)
    of_exchange = (
        roundtrips.frame.lazy()
        .with_columns(roundtrips.exchange_of_row())
        .group_by("exchange")
        .agg(
            pl.len().alias("published"),
            (outcome == Outcome.COMPLETED.value).sum().alias("received"),
            *((outcome == o.value).sum().alias(o.value) for o in Outcome if o is not Outcome.COMPLETED),
            pl.col("duplicates").cast(pl.UInt64).sum(),
            pl.col("reordered").sum(),
            (pl.len() - 1).alias("intervals"),
            (publish.max() - publish.min()).alias("publish_span_ns"),
            (payload * relay_in.is_not_null()).sum().alias("relayed_bytes"),
            (relay_out.max() - relay_in.min()).alias("relay_span_ns"),
            (payload * receive.is_not_null()).sum().alias("replied_bytes"),
            (receive.max() - receive.min()).alias("reply_span_ns"),
        )
    )
    recorded = pl.col("relay_recorded")
    return (
        pl.LazyFrame(
            {
                "exchange": np.arange(len(roundtrips.exchanges), dtype=np.uint32),
                "group": grouping.group_of_exchange,
                "relay_recorded": [exchange.relay_recorded for exchange in roundtrips.exchanges],
            }
        )
        .join(of_exchange, on="exchange", how="left")
        .with_columns(
            pl.when(recorded).then("relayed_bytes").otherwise("replied_bytes").alias("moved_bytes"),
            pl.when(recorded).then("relay_span_ns").otherwise("reply_span_ns").alias("moved_span_ns"),
        )
        .group_by("group")
        .agg(
            pl.col("published", "received", "duplicates", "reordered").sum(),
            pl.col(*(o.value for o in Outcome if o is not Outcome.COMPLETED)).sum(),
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
