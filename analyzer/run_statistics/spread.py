"""The spread of a statistic between runs and within them, and how many runs decide."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..statistics.intervals import Interval, mean_and_variance
from ..statistics.power import runs_to_decide
from .between_runs import Scale, scale_of
from .bursts import COSINES, Float64, long_run_variance
from .change import Change
from .runs import Run, Runs, Statistic, quantiles_at, quantiles_of_runs
from .tails import inflations_of


@dataclass(frozen=True, slots=True)
class Spread:
    """Standard deviations of the logarithm of a statistic of one run; 0.05 is 5 %."""

    between: float | None
    within: float | None


def spread_of_runs(
    runs: Runs | Sequence[Run], statistic: Statistic, errors: Float64 | None = None, values: Float64 | None = None
) -> Spread:
    """Return the variance components of a statistic (one-way random effects, S. Searle et al., 1992, section 3.6).

    The part within is each run's own error, so `between**2 = max(0, variance - within**2)`. Runs that do not support the
    statistic are left out. `errors` are the group's `log_errors`, `values` its statistics; None computes them.
    """
    runs = Runs.of(runs)
    needs = max(statistic.needs, 2 * COSINES + 1)
    if any(messages < needs for messages in runs.lengths):
        runs, errors, values = Runs(tuple(run for run in runs if len(run) >= needs)), None, None
    if not len(runs):
        return Spread(None, None)
    values = statistic.of_runs(runs) if values is None else values
    if scale_of(values) is not Scale.LOGARITHM:
        return Spread(None, None)
    if statistic.quantile is None:
        errors = np.array([_log_error_of_mean(run, v) for run, v in zip(runs, values.tolist(), strict=True)])
    elif errors is None:
        (errors,) = log_errors(runs, [statistic.quantile])
    within_squared = float(np.add.reduce(errors * errors) / len(errors))
    if math.isnan(within_squared):
        return Spread(None, None)
    between = None
    if len(runs) > 1:
        between = math.sqrt(max(0.0, mean_and_variance(np.log(values))[1] - within_squared))
    return Spread(between, math.sqrt(within_squared))


def _log_error_of_mean(run: Run, mean: float) -> float:
    variance = max(float(run.values.var()), long_run_variance(run.values))
    return math.sqrt(variance / len(run)) / mean


def log_errors(runs: Runs, quantiles: Sequence[float]) -> list[Float64]:
    """Return the standard error of the logarithm of each run's quantiles, NaN where not finite; each of shape (runs,).

    Half of the logarithm's rise over one standard error of the share below it to either side (R. Woodruff, JASA 47, 1952).
    """
    share, n = np.array(quantiles)[:, None], np.array(runs.lengths)
    inflations = np.array(inflations_of(runs, quantiles))
    errors = np.sqrt(share * (1 - share) * np.maximum(1.0, inflations) / n)
    steps = np.minimum(np.maximum([share - errors, share + errors], 0.5 / n), 1 - 0.5 / n)
    low, high = quantiles_at(runs.ordered_by_run, runs.offsets, (n + 1 / 3) * steps + 1 / 3)
    width = steps[1] - steps[0]
    is_finite = (low > 0) & np.isfinite(high) & (width > 0)
    by_quantile = np.full_like(low, np.nan)
    by_quantile[is_finite] = np.log(high[is_finite] / low[is_finite]) * errors[is_finite] / width[is_finite]
    return list(by_quantile)


def runs_to_settle_ratio(change: Change, limit: float) -> int | None:
    """Return the runs a side, in all, after which the interval of a ratio is on one side of a limit with a probability of 80 %.

    None within one run and where it takes more than `power.MOST_RUNS`. The measured ratio is taken as the true one.
    """
    if change.ratio is None or not 0 < change.ratio < math.inf:
        return None
    spreads = (change.base.unit_spread, change.new.unit_spread)
    if change.pairs:
        spreads = (change.pair_spread, 0.0)
    return _runs_to_decide(change.ratio / limit, spreads, change.base, change.new)


def runs_to_settle_value(interval: Interval, limit: float) -> int | None:
    if interval.value is None or not 0 < interval.value < math.inf or limit <= 0:
        return None
    return _runs_to_decide(interval.value / limit, (interval.unit_spread, 0.0), interval)


def _runs_to_decide(ratio: float, spreads: tuple[float | None, float | None], *sides: Interval) -> int | None:
    base, new = spreads
    if base is None or new is None:
        return None
    units = runs_to_decide(math.log(ratio), base, new, sides[0].confidence)
    runs_of_unit = max(side.runs / side.units for side in sides)
    return None if units is None else math.ceil(round(units * runs_of_unit, 6))


SMALL_GROUP = 20_000
"""Messages of a group up to which batching saves time."""


def spreads_of_groups(groups: Sequence[Runs], statistics: Sequence[Statistic]) -> list[list[Spread]]:
    if not groups:
        return []
    quantiles = [statistic.quantile for statistic in statistics if statistic.quantile is not None]
    together = groups[0] if len(groups) == 1 else Runs(tuple(run for group in groups for run in group))
    columns = list(
        zip(statistics, log_errors(together, quantiles), quantiles_of_runs(together, quantiles), strict=True)
    )
    spreads, end = [], 0
    for group in groups:
        start, end = end, end + len(group)
        spreads.append(
            [spread_of_runs(group, s, errors[start:end], values[start:end]) for s, errors, values in columns]
        )
    return spreads
