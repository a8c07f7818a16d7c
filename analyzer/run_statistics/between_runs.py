"""The interval of a quantile or a mean of a group of runs: it holds for another run of the same kind.

A run is one observation (docs/explanation/statistics.md). The interval is Student's t on the logarithms of the runs' statistics,
because causes of latency multiply. Of a bootstrap's 95 % intervals from three runs only 83 % contain the truth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import accumulate
from statistics import NormalDist

import numpy as np

from ..statistics.distributions import student_quantile
from ..statistics.intervals import MIN_RUNS, Basis, Interval, mean_and_variance, tail_share, without_open_end
from ..statistics.percentiles import order_statistic_ranks
from .bursts import COSINES, Float64, long_run_variance
from .runs import Run, Runs, Statistic, quantile_at, quantiles_of_runs
from .tails import Tail, episodes_of, tails_of_all


@dataclass(frozen=True, slots=True, eq=False)
class Units:
    values: Float64
    messages: int
    independent: int
    runs: int
    episodes: int | None

    def __len__(self) -> int:
        return len(self.values)


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """A statistic of a group: its interval, and the units of it (None within one run)."""

    interval: Interval
    units: Units | None


def interval_of_runs(runs: Runs | Sequence[Run], statistic: Statistic, confidence: float = 0.95) -> Interval:
    return estimates_of_runs(runs, [statistic], confidence)[0].interval


def estimates_of_runs(
    runs: Runs | Sequence[Run], statistics: Sequence[Statistic], confidence: float = 0.95
) -> list[Estimate]:
    """Return the estimate of each statistic: from the runs, in the order of time, if there are three or more, else within one run.

    From three runs on the value is the geometric mean of the runs' statistics; their mean if one is not above zero, their median if
    one is infinite. Of one or two runs, an end beyond a tail is None below `LEAST_BEYOND` expected messages. Together,
    statistics share the sorting.
    """
    return estimates_of_groups([Runs.of(runs)], statistics, confidence)[0]


def estimates_of_groups(
    groups: Sequence[Runs], statistics: Sequence[Statistic], confidence: float = 0.95
) -> list[list[Estimate]]:
    units = _units_of_groups(groups, statistics)
    joined = [
        [
            statistic
            for statistic, unit in zip(statistics, units_by_statistic, strict=True)
            if unit is None or has_few_bursts(unit.episodes, unit.messages, statistic.quantile)
        ]
        for units_by_statistic in units
    ]
    within = _intervals_within(groups, joined, confidence)
    return [
        [
            Estimate(without_open_end(by_statistic[statistic], statistic.quantile), None)
            if unit is None
            else Estimate(_interval_of_units(unit, confidence, by_statistic.get(statistic)), unit)
            for statistic, unit in zip(statistics, units_by_statistic, strict=True)
        ]
        for units_by_statistic, by_statistic in zip(units, within, strict=True)
    ]


FEW_BURSTS = 6
"""Bursts below which runs are alike by chance."""


def has_few_bursts(episodes: int | None, messages: int, quantile: float | None) -> bool:
    if quantile is None or episodes is None:
        return False
    return episodes < min(FEW_BURSTS, messages * tail_share(quantile) / 2)


def _units_of_groups(groups: Sequence[Runs], statistics: Sequence[Statistic]) -> list[list[Units | None]]:
    parts: list[tuple[int, list[Statistic], Runs]] = []
    for number, group in enumerate(groups):
        if sum(messages > 0 for messages in group.lengths) < MIN_RUNS:
            continue
        shortest = min(group.lengths)
        parts.append((number, [statistic for statistic in statistics if statistic.needs <= shortest], group))
        long = (s for s in statistics if shortest < s.needs <= sum(group.lengths) // MIN_RUNS)
        parts += ((number, [statistic], _joined_where_short(group, statistic.needs)) for statistic in long)
    units: list[dict[Statistic, Units | None]] = [dict.fromkeys(statistics) for _ in groups]
    requests = [(runs, [s.quantile for s in supported if s.quantile is not None]) for _, supported, runs in parts]
    for (number, supported, runs), (_, quantiles), tails in zip(parts, requests, tails_of_all(requests), strict=True):
        by_quantile: dict[float | None, tuple[list[Tail], Float64]] = {}
        if quantiles:
            by_quantile.update(zip(quantiles, zip(tails, quantiles_of_runs(runs, quantiles), strict=True), strict=True))
        for statistic in supported:
            unit = _units(groups[number], runs, statistic, *by_quantile.get(statistic.quantile, ((), None)))
            units[number][statistic] = unit if len(unit) >= MIN_RUNS else None
    return [list(by_statistic.values()) for by_statistic in units]


def _units(
    group: Runs, runs: Runs, statistic: Statistic, tails: Sequence[Tail], values: Float64 | None = None
) -> Units:
    """Return the statistic of each unit: a run, or neighbours together where one run does not support it.

    A unit needs about as many episodes beyond the quantile as there are units: a tail of k episodes is biased by the order of 1/k,
    which no number of runs averages away, while U such units have a standard error of the order of 1/sqrt(k U).
    """
    episodes = None
    if statistic.quantile is None:
        independent = sum(map(_independent_for_mean, runs))
    else:
        episodes = episodes_of(tails)
        independent = sum(n / max(1.0, tail.inflation) for n, tail in zip(runs.lengths, tails, strict=True))
        if episodes is not None:
            most = max(MIN_RUNS, round(math.sqrt(episodes)))
            runs, values = (runs, values) if len(runs) <= most else (_joined_to(runs, most), None)
    return Units(
        values=statistic.of_runs(runs) if values is None else values,
        messages=sum(group.lengths),
        independent=max(1, int(independent)),
        runs=len(group),
        episodes=episodes,
    )


def _joined_where_short(group: Runs, needs: int) -> Runs:
    if min(group.lengths) >= needs:
        return group
    ends: list[int] = []
    messages = 0
    for number, length in enumerate(group.lengths):
        if length and messages >= needs:
            ends.append(number)
            messages = 0
        messages += length
    if ends and messages < needs:
        ends.pop()
    return group.joined_at((*ends, len(group)))


def _joined_to(runs: Runs, most: int) -> Runs:
    size, larger = divmod(len(runs), most)
    sizes = [size + 1] * larger + [size] * (most - larger)
    return runs.joined_at(tuple(accumulate(sizes)))


def _independent_for_mean(run: Run) -> float:
    if len(run) < 2 * COSINES or not np.isfinite(run.values).all():
        return len(run)
    variance, long_run = float(run.values.var()), long_run_variance(run.values)
    return len(run) if long_run <= variance else len(run) * variance / long_run


def _interval_of_units(units: Units, confidence: float, within: Interval | None) -> Interval:
    value, lower, upper, unit_spread = ends_of_units(units.values, confidence)
    if within is not None and lower is not None:
        lowers, uppers = (
            [end for end in ends if end is not None] for ends in zip((lower, upper), within.range, strict=True)
        )
        lower, upper = min(lowers), max(uppers, default=None)
    counts = units.messages, units.independent, Basis.BETWEEN_RUNS, units.runs, len(units), units.episodes
    return Interval(value, lower, upper, confidence, *counts, unit_spread=unit_spread)


class Scale(Enum):
    LOGARITHM = "logarithm"
    LINEAR = "linear"  # some statistic is zero or negative: a one-way time within the clocks' error
    RECIPROCAL = "reciprocal"  # some statistic is infinite: its reciprocal is 0, and an average has an end
    NONE = "none"  # some statistic is infinite and another not above zero


def scale_of(values: Float64) -> Scale:
    few = values.tolist()
    is_positive, is_finite = min(few) > 0, all(map(math.isfinite, few))
    if is_finite:
        return Scale.LOGARITHM if is_positive else Scale.LINEAR
    return Scale.RECIPROCAL if is_positive else Scale.NONE


def ends_of_units(values: Float64, confidence: float) -> tuple[float, float | None, float | None, float | None]:
    """Return the typical value of at least two units, the ends of its interval by Student's t, and `Interval.unit_spread`.

    On the reciprocal scale the lower end belongs to the harmonic mean, which is never above the geometric mean.
    """
    scale = scale_of(values)
    if scale is Scale.NONE:
        return float(np.median(values)), None, math.inf, None
    if scale is Scale.RECIPROCAL:
        fastest = student_ends(1 / values, confidence)[2]
        value = float(np.median(values))
        return value, min(value, 1 / fastest if fastest > 0 else math.inf), math.inf, None
    if scale is Scale.LINEAR:
        return (*student_ends(values, confidence)[:3], None)
    *ends, deviation = student_ends(np.log(values), confidence)
    value, lower, upper = map(math.exp, ends)
    return value, lower, upper, deviation


def student_ends(values: Float64, confidence: float) -> tuple[float, float, float, float]:
    """Return mean, ends of its interval (Student, 1908), and standard deviation of finite values."""
    count, (mean, variance) = len(values), mean_and_variance(values)
    deviation = math.sqrt(variance)
    reach = student_quantile((1 + confidence) / 2, count - 1) * deviation / math.sqrt(count)
    return mean, mean - reach, mean + reach, deviation


def _intervals_within(
    groups: Sequence[Runs], statistics: Sequence[Sequence[Statistic]], confidence: float
) -> list[dict[Statistic, Interval]]:
    requests: list[tuple[Runs, list[float]]] = []
    for group, supported in zip(groups, statistics, strict=True):
        samples = sum(group.lengths)
        quantiles = [s.quantile for s in supported if s.quantile is not None and s.needs <= samples]
        requests.append((group.joined if supported else group, quantiles))
    intervals: list[dict[Statistic, Interval]] = []
    parts = zip(groups, statistics, requests, tails_of_all(requests), strict=True)
    for group, supported, (joined, quantiles), tail_list in parts:
        samples, runs, tails = sum(group.lengths), len(group), dict(zip(quantiles, tail_list, strict=True))
        by_statistic: dict[Statistic, Interval] = {}
        for statistic in supported:
            if samples < statistic.needs:
                counts = samples, samples, Basis.WITHIN_RUN, runs, 0, None
                by_statistic[statistic] = Interval(None, None, None, confidence, *counts)
            elif statistic.quantile is None:
                by_statistic[statistic] = _mean_within(joined.runs[0], confidence, runs)
            else:
                (tail,) = tails[statistic.quantile]
                by_statistic[statistic] = _quantile_within(joined.ordered, statistic.quantile, tail, confidence, runs)
        intervals.append(by_statistic)
    return intervals


def _quantile_within(ordered: Float64, quantile: float, tail: Tail, confidence: float, runs: int) -> Interval:
    n, episodes = len(ordered), episodes_of([tail])
    probability = (1 + confidence) / 2
    # The inflation is estimated from COSINES numbers: Student's t over the normal quantile, squared, is 1.24 at 95 %.
    penalty = (student_quantile(probability, COSINES) / NormalDist().inv_cdf(probability)) ** 2
    independent = max(1, int(n / max(1.0, tail.inflation * penalty)))
    if has_few_bursts(episodes, n, quantile):
        independent = min(independent, int((episodes or 1) / tail_share(quantile)))
    lowest, highest = order_statistic_ranks(independent, quantile, confidence)
    has_lower, has_upper = order_statistic_ranks(n, quantile, confidence)
    stretch = n / independent
    # The extreme where too few are independent: a rule by the tail would print only lucky ends.
    lower = float(ordered[math.floor(((lowest or 1) - 1) * stretch)]) if has_lower else None
    upper = float(ordered[math.ceil(round((highest or independent) * stretch, 6)) - 1]) if has_upper else None
    value = quantile_at(ordered, 1 + (n - 1) * quantile)
    return Interval(value, lower, upper, confidence, n, independent, Basis.WITHIN_RUN, runs, 0, episodes)


def _mean_within(series: Run, confidence: float, runs: int) -> Interval:
    n, mean = len(series), float(series.values.mean())
    lower, upper, independent = None, mean if math.isinf(mean) else None, n
    if n > 2 * COSINES and not math.isinf(mean):
        spread = float(np.square(series.values - mean).mean())
        variance = max(spread * n / (n - 1), long_run_variance(series.values))
        reach = student_quantile((1 + confidence) / 2, COSINES) * math.sqrt(variance / n)
        lower, upper = mean - reach, mean + reach
        independent = n if variance == 0 else max(1, int(n * spread / variance))
    return Interval(mean, lower, upper, confidence, n, independent, Basis.WITHIN_RUN, runs, 0, None)
