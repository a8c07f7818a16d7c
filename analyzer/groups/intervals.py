"""The frames `intervals`, `one_way` and `clock_knots`: percentiles with their confidence and the bounds of the clocks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ..model.metrics import METRICS, frame_schema
from ..pairing.roundtrips import RoundTrips
from ..run_statistics.between_runs import estimates_of_groups
from ..run_statistics.runs import Runs, SendTimes, Statistic
from ..run_statistics.spread import SMALL_GROUP, spreads_of_groups
from ..statistics.intervals import Basis, Interval
from ..statistics.percentiles import PERCENTILES, STATISTICS, quantile_of, summarize_values
from .batch import Batch, columns_by_group, is_present, present
from .summary import Measured, Statistics

INTERVAL_SCHEMA = frame_schema(
    "group:u32 metric:str percentile:str quantile:f64 estimate_ns:f64 low_ns:f64 high_ns:f64 method:str "
    "confidence:f64 messages:u64 independent:u64 runs:u32 units:u32 episodes:u64 basis:str between:f64 "
    "within:f64 typical_ns:f64"
)

ONE_WAY_STATISTICS = [statistic.name for statistic in STATISTICS if statistic.label]
ONE_WAY_SCHEMA = frame_schema(
    f"group:u32 metric:str messages:u64 {' '.join(f'{name}_ns:f64' for name in ONE_WAY_STATISTICS)} "
    "bound_p50_ns:f64 bound_max_ns:f64"
)

ONE_WAY_METRICS = ("outbound", "return")
"""Metrics that are wrong by at most `clock_bound_ns`."""
_METRICS = (*METRICS, *ONE_WAY_METRICS)

_STATISTICS = [Statistic(percentile.quantile) for percentile in PERCENTILES]
_METHODS = {Basis.BETWEEN_RUNS: "student_t_of_runs", Basis.WITHIN_RUN: "order_statistics"}


def measure_whole(batch: Batch, roundtrips: RoundTrips) -> tuple[Statistics, pl.DataFrame, pl.DataFrame]:
    """Return `measure_batch` and the frames `intervals` and `one_way` of whole groups; each value is sorted once.

    Every percentile of every metric has its 95 % interval: between runs from three runs on, else within one. `estimate_ns` (the
    summary's), `low_ns` and `high_ns` are null where the sample does not support them, `method` (`student_t_of_runs` or
    `order_statistics`) without both ends; `typical_ns` is of a typical run. Others as in `statistics.intervals.Interval` and
    `run_statistics.spread.Spread`.
    """
    run_ids = [exchange.run.run_id for exchange in batch.exchanges]
    number = {run_id: index for index, run_id in enumerate(dict.fromkeys(run_ids))}
    numbers = np.array([number[run_id] for run_id in run_ids], np.min_scalar_type(len(number)))
    run_of_row = roundtrips.per_row(numbers)
    measured: dict[tuple[int, str], Measured] = {}

    def take(group: int, metric: str, ordered: NDArray[np.int64]) -> None:
        measured[group, metric] = Measured.of(ordered)

    groups = ((group, column, run_of_row[part]) for group, column, part in columns_by_group(batch, roundtrips))
    rows = list(rows_of_groups(groups, take))
    nothing = Measured.of(np.empty(0, np.int64))
    statistics = Statistics.of(
        (group, metric, measured.get((group, metric), nothing))
        for group in np.unique(batch.group_of_exchange).tolist()
        for metric in METRICS
    )
    one_way = [
        row
        for group, column, _ in columns_by_group(batch, roundtrips)
        for row in one_way_rows(
            group, column, {m: measured[group, m] for m in ONE_WAY_METRICS if (group, m) in measured}
        )
    ]
    return statistics, pl.DataFrame(rows, schema=INTERVAL_SCHEMA), pl.DataFrame(one_way, schema=ONE_WAY_SCHEMA)


_Measured = tuple[int, dict[str, Runs], float]  # group, runs of metrics, error of a one-way quantile


def rows_of_groups(
    groups: Iterable[tuple[int, Callable[[str], pl.Series], NDArray[np.int64]]],
    take: Callable[[int, str, NDArray[np.int64]], object] = lambda *_: None,
) -> Iterator[dict[str, object]]:
    """Yield the rows of groups, small ones measured together; `take` gets the ascending values of each group and metric."""
    together: list[_Measured] = []
    messages = 0
    for group, column, run_of_row in groups:
        for runs, bound_ns in _measured(column, run_of_row):
            messages += len(runs) * len(run_of_row)
            together.append((group, runs, bound_ns))
            del runs  # of a long run, before the next metric is read
            if messages > len(_METRICS) * SMALL_GROUP:
                yield from _rows_of(together, take)
                together, messages = [], 0
    yield from _rows_of(together, take)


def _measured(
    column: Callable[[str], pl.Series], run_of_row: NDArray[np.int64]
) -> Iterator[tuple[dict[str, Runs], float]]:
    """Yield the runs of a small group's metrics together, of a large one's one after the other; those that no message has are left out."""
    sent_ns = column("publish_ns").to_numpy()
    all_messages = _Sending.of(sent_ns, run_of_row)
    bounds_ns = present(column("clock_bound_ns"))
    bound_ns = float(bounds_ns.max()) if len(bounds_ns) else 0.0

    def runs_of(metric: str) -> Runs | None:
        values, sending = column(f"{metric}_ns"), all_messages
        bounds = column("clock_bound_ns") if metric in ONE_WAY_METRICS else values
        if bounds.null_count() == len(bounds):
            return None
        if bounds.null_count():
            has_value = is_present(bounds)
            values = values.filter(pl.Series(has_value))
            sending = _Sending.of(sent_ns[has_value], run_of_row[has_value])
        return sending.runs(present(values))

    is_small = len(run_of_row) <= SMALL_GROUP
    for metrics in [_METRICS] if is_small else [(metric,) for metric in _METRICS]:
        if any(has_runs := [runs_of(metric) for metric in metrics]):
            yield {metric: runs for metric, runs in zip(metrics, has_runs, strict=True) if runs}, bound_ns
        del has_runs


def _rows_of(
    together: Sequence[_Measured], take: Callable[[int, str, NDArray[np.int64]], object]
) -> Iterator[dict[str, object]]:
    metrics = [
        (group, metric, runs, off_ns) for group, by_metric, off_ns in together for metric, runs in by_metric.items()
    ]
    spreads_of_all = chain.from_iterable(spreads_of_groups([[*runs.values()] for _, runs, _ in together], _STATISTICS))
    estimates_of_all = estimates_of_groups([runs for _, _, runs, _ in metrics], _STATISTICS)
    for (group, metric, runs, bound_ns), spreads, estimates in zip(
        metrics, spreads_of_all, estimates_of_all, strict=True
    ):
        ordered, off_ns = runs.ordered, bound_ns if metric in ONE_WAY_METRICS else 0.0
        take(group, metric, ordered)
        for percentile, estimate, spread in zip(PERCENTILES, estimates, spreads, strict=True):
            interval = estimate.interval
            supported = len(ordered) >= percentile.needs
            yield {
                "group": group,
                "metric": metric,
                "percentile": percentile.name,
                "quantile": percentile.quantile,
                "estimate_ns": quantile_of(ordered, percentile.quantile) if supported else None,
                "low_ns": None if interval.lower is None else interval.lower - off_ns,
                "high_ns": None if interval.upper is None else interval.upper + off_ns,
                "method": _METHODS[interval.basis] if interval.is_two_sided else None,
                **sample_columns(interval),
                "between": spread.between,
                "within": spread.within,
            }


def sample_columns(interval: Interval) -> dict[str, object]:
    return {
        "confidence": interval.confidence,
        "messages": interval.samples,
        "independent": interval.independent,
        "runs": interval.runs,
        "units": interval.units,
        "episodes": interval.episodes,
        "basis": interval.basis.value,
        "typical_ns": interval.value,
    }


@dataclass(frozen=True, slots=True, eq=False)
class _Sending:
    """T1 of messages, ascending in each run, and their indices in that order, None if it changes nothing."""

    times: SendTimes
    order: NDArray[np.intp] | None

    @classmethod
    def of(cls, sent_ns: NDArray[np.int64], run_of_row: NDArray[np.int64]) -> _Sending:
        changes = np.flatnonzero(run_of_row[1:] != run_of_row[:-1])
        offsets = np.concatenate([[0], changes + 1, [len(run_of_row)]])
        times = SendTimes(sent_ns, offsets)
        if all(bool((run[1:] >= run[:-1]).all()) for run in times.by_run):
            return cls(times, None)
        orders = [np.argsort(run, kind="stable") for run in times.by_run]
        order = np.concatenate([first + indices for first, indices in zip(offsets.tolist(), orders, strict=False)])
        return cls(SendTimes(sent_ns[order], offsets), order)

    def runs(self, values: NDArray[np.int64]) -> Runs:
        return Runs.split(values if self.order is None else values[self.order], self.times)


def one_way_rows(
    group: int, column: Callable[[str], pl.Series], measured: Mapping[str, Measured] | None = None
) -> Iterator[dict[str, object]]:
    bounds = column("clock_bound_ns")
    bounds_ns, has_bound = present(bounds), bounds.is_not_null()
    for metric in ONE_WAY_METRICS if len(bounds_ns) else ():
        statistics = (
            measured[metric].statistics
            if measured
            else summarize_values(np.sort(present(column(f"{metric}_ns").filter(has_bound))))
        )
        yield (
            {"group": group, "metric": metric, "messages": len(bounds_ns)}
            | {f"{name}_ns": statistics[name] for name in ONE_WAY_STATISTICS}
            | {"bound_p50_ns": float(np.median(bounds_ns)), "bound_max_ns": float(bounds_ns.max())}
        )


def knot_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    knots = roundtrips.clock_knots
    return knots.with_columns(pl.Series("group", batch.group_of_exchange[knots["group"].to_numpy()]))
