"""The spread of a statistic between runs and within them, and how many runs decide."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from ..statistics.intervals import Interval
from ..statistics.power import runs_to_decide
from .between_runs import Scale, scale_of
from .bursts import COSINES, Float64, long_run_variance
from .change import Change
from .runs import Run, Runs, Statistic, quantiles_at, quantiles_of_runs
from .tails import alike, inflations_of


@dataclass(frozen=True, slots=True)
class Spread:
    """Standard deviations of the logarithm of a statistic of one run; 0.05 is 5 %."""

    between: float | None
    within: float | None


def spread_of_runs(runs: Runs | Sequence[Run], statistic: Statistic) -> Spread:
    """Return the variance components of a statistic (one-way random effects, S. Searle et al., 1992, section 3.6).

    The part within is each run's own error, so `between**2 = max(0, variance - within**2)`. Runs that do not support the
    statistic are left out.
    """
    needs = max(statistic.needs, 2 * COSINES + 1)
    runs = Runs(tuple(run for run in runs if len(run) >= needs))
    values = statistic.of_runs(runs) if len(runs) else np.empty(0)
    if not len(runs) or scale_of(values) is not Scale.LOGARITHM:
        return Spread(None, None)
    if statistic.quantile is None:
        variances = [max(float(run.values.var()), long_run_variance(run.values)) / len(run) for run in runs]
        errors = np.sqrt(variances) / values
    else:
        (errors,) = log_errors(runs, [statistic.quantile])
    return _spreads(values[None], errors[None])[0]


def _spreads(values: Float64, errors: Float64) -> list[Spread]:
    runs = values.shape[1]
    within_squared = np.add.reduce(errors * errors, axis=1) / runs
    has_spread = (values > 0).all(axis=1) & np.isfinite(values).all(axis=1) & ~np.isnan(within_squared)
    logs = np.log(np.where(has_spread[:, None], values, 1.0))
    apart = logs - (np.add.reduce(logs, axis=1) / runs)[:, None]
    between_squared = np.add.reduce(apart * apart, axis=1) / max(runs - 1, 1) - within_squared
    between = np.sqrt(np.maximum(between_squared, 0.0)).tolist() if runs > 1 else [None] * len(values)
    pairs = zip(between, np.sqrt(within_squared).tolist(), has_spread.tolist(), strict=True)
    return [Spread(*parts) if has_own else Spread(None, None) for *parts, has_own in pairs]


def log_errors(runs: Runs, quantiles: Sequence[float], groups: int = 1) -> list[Float64]:
    """Return the standard error of the logarithm of each run's quantiles, NaN where not finite; each of shape (runs,).

    Half of the logarithm's rise over one standard error of the share below it to either side (R. Woodruff, JASA 47, 1952).
    """
    share, n = np.array(quantiles)[:, None], np.array(runs.lengths)
    inflations = np.array(inflations_of(runs, quantiles, groups)).reshape(len(quantiles), -1)
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
    if change.ratio is None or not 0 < change.ratio < math.inf or limit <= 0:
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


def spreads_of_groups(groups: Sequence[Sequence[Runs]], statistics: Sequence[Statistic]) -> list[list[list[Spread]]]:
    """Return the spreads of each series of each group, one at least; groups with equal lengths of runs share the work."""
    spreads: dict[int, list[list[Spread]]] = {}
    for numbers in alike([runs.lengths for runs in group] for group in groups):
        series = [runs for number in numbers for runs in groups[number]]
        together = Runs(tuple(run for runs in series for run in runs))
        longest = max(together.lengths)
        supported = [s for s in statistics if s.needs <= longest]
        quantiles = [s.quantile for s in supported if s.quantile is not None]
        columns = log_errors(together, quantiles, len(numbers)), quantiles_of_runs(together, quantiles)
        shape = (len(series), -1) if len(set(map(len, series))) == 1 else None
        by_statistic = dict.fromkeys(statistics, [Spread(None, None)] * len(series))
        for statistic, errors, values in zip(supported, *columns, strict=True):
            if shape and min(together.lengths) >= max(statistic.needs, 2 * COSINES + 1):
                by_statistic[statistic] = _spreads(values.reshape(shape), errors.reshape(shape))
            else:
                by_statistic[statistic] = [spread_of_runs(runs, statistic) for runs in series]
        rows = iter(zip(*by_statistic.values(), strict=True))
        spreads |= {number: [list(row) for row in islice(rows, len(groups[number]))] for number in numbers}
    return [spreads[number] for number in range(len(groups))]
