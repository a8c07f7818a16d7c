"""Medians, quantiles and steps of many short arrays: the numbers of NumPy's functions, at a part of their cost a call."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import NormalDist
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .bounds import FEWEST, PHASES

_STATISTICS = {"p50": (0.5, 1), "p90": (0.9, 10), "p99": (0.99, 100), "max": (1.0, 1)}
"""Statistic -> quantile, and the values that it takes."""

_NORMAL = 1 / NormalDist().inv_cdf(3 / 4)
"""Standard deviation of normal values in median deviations."""

Values = NDArray[np.int64] | NDArray[np.float64]
Numbers = TypeVar("Numbers", bound=NDArray[Any])


def median(values: Values | Sequence[float]) -> float:
    if not len(values):
        return float("nan")
    ordered = np.array(values)
    if len(ordered) > PHASES // FEWEST:  # sorting less is faster than finding two
        ordered.partition(((len(ordered) - 1) // 2, len(ordered) // 2))
    else:
        ordered.sort()
    return middle(ordered)


def middle(ascending: Values) -> float:
    return (float(ascending[(len(ascending) - 1) // 2]) + float(ascending[len(ascending) // 2])) / 2


def steps_of(values: Numbers) -> Numbers:
    steps: Numbers = values[1:] - values[:-1]
    return steps


def indices_of(selected: NDArray[np.bool_]) -> NDArray[np.intp]:
    return selected.nonzero()[0]


def row_medians(rows: Values) -> NDArray[np.float64]:
    low, high = (rows.shape[1] - 1) // 2, rows.shape[1] // 2
    medians: NDArray[np.float64] = np.partition(rows, (low, high), axis=1)[:, low : high + 1].mean(axis=1)
    return medians


def quantile(values: Values, share: float) -> float:
    at = share * (len(values) - 1)
    low = int(at)
    high = min(low + 1, len(values) - 1)
    ordered = np.partition(values, (low, high))
    before, after, part = ordered[low].item(), ordered[high].item(), at - low
    return float(before + (after - before) * part if part < 1 / 2 else after - (after - before) * (1 - part))


def named_quantile(values: Values, statistic: str) -> float | None:
    share, needs = _STATISTICS[statistic]
    return quantile(values, share) if len(values) >= needs else None


def spread(values: Values) -> float:
    return _NORMAL * median(np.abs(values - median(values))) if len(values) else 0.0
