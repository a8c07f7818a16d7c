"""How precisely a statistic of some runs is known: the half width of its interval."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import polars as pl

from dds_trace.tracefile import OptionError

from ..model.metrics import METRICS
from ..model.runs import delivered_runs, split_runs
from ..run_statistics.between_runs import interval_of_runs
from ..statistics.intervals import Basis
from .compare import STATISTIC_BY_NAME

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from ..statistics.intervals import Interval


def check_statistic(text: str) -> tuple[str, str]:
    """Return metric and statistic of a text such as `latency_p99`.

    Raises:
        OptionError: there is no such metric or statistic.
    """
    metric, _, statistic = text.partition("_")
    if metric not in METRICS or statistic not in STATISTIC_BY_NAME:
        raise OptionError(
            f"{text!r} is no statistic; write one of {', '.join(METRICS)} and of {', '.join(STATISTIC_BY_NAME)} "
            "with an underscore between them, for example latency_p99"
        )
    return metric, statistic


def half_widths(
    rows: pl.DataFrame, runs: Mapping[str, Collection[int]], text: str, confidence: float = 0.95
) -> dict[str, float]:
    """Return how precisely a statistic is known, losses included, for each of several sets of runs.

    Args:
        rows: round trips, columns of `docs/trace-format.md`.
        runs: name of a set -> ids of its runs.
        text: the statistic, such as `latency_p99`.
        confidence: of the interval.

    Returns:
        Name -> half width of the interval between runs in percent of the value. Infinite with fewer than three runs,
        and where the interval lacks an end: too few episodes beyond a tail, or too many losses.

    Raises:
        OptionError: there is no such statistic.
    """
    metric, statistic = check_statistic(text)
    return {
        name: _half_width_percent(
            interval_of_runs(
                delivered_runs(split_runs(rows.filter(pl.col("run_id").is_in(list(run_ids)))), metric),
                STATISTIC_BY_NAME[statistic],
                confidence,
            )
        )
        for name, run_ids in runs.items()
    }


def _half_width_percent(interval: Interval) -> float:
    if interval.basis is Basis.WITHIN_RUN or interval.lower is None or interval.upper is None:
        return math.inf
    if interval.value is None or interval.value <= 0 or not math.isfinite(interval.upper):
        return math.inf
    return 100 * (interval.upper - interval.lower) / 2 / interval.value
