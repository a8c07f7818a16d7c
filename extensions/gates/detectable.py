"""Which changes a comparison would have detected, and how often a message of one side is faster."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from dds_trace.analyzer.run_statistics.change import Change
from dds_trace.analyzer.run_statistics.runs import Values
from dds_trace.analyzer.statistics.distributions import (
    estimated_shift_for_power,
    shift_for_power,
    special,
    student_quantile,
)
from dds_trace.analyzer.statistics.power import POWER, whole_degrees


def probability_of_superiority(base: Values, new: Values) -> float | None:
    """Return how often a value of `new` is below one of `base`, both ascending, ties counted half.

    1 means that every new message is faster (R. McGraw and S. Wong, Psychological Bulletin 111, 1992).
    """
    if not len(base) or not len(new):
        return None
    not_above = np.searchsorted(base, new, side="right")
    ties = not_above - np.searchsorted(base, new, side="left")
    above = len(base) - not_above
    return float((above + ties / 2).mean() / len(base))


@dataclass(frozen=True, slots=True)
class DetectableChange:
    """The smallest change of one statistic of one metric that the verdicts of a comparison would have detected, in `told` of `groups`.

    A group that became slower by `smallest_ratio`, whichever it is and though no other did, would have been called slower with a
    probability of at least 80 %; `least_ratio` is that of the group in which the least is found. Both groups are rows of `Comparison.delivery`.
    """

    metric: str
    statistic: str
    groups: int
    told: int
    smallest_ratio: float | None
    least_ratio: float | None = None
    least_result: int | None = None
    most_result: int | None = None


def detectable_changes(
    changes: Iterable[tuple[str, str, int, Change]], confidence: float, same_within: float
) -> tuple[DetectableChange, ...]:
    rows = list(changes)
    tests = sum(change.p_value is not None for *_, change in rows)
    families: dict[tuple[str, str], list[tuple[int, Error | None]]] = {}
    for metric, statistic, result, change in rows:
        families.setdefault((metric, statistic), []).append((result, _error_of(change, confidence)))
    families = {key: _pooled(family) for key, family in families.items()}
    by_result: dict[int, list[Error]] = {}
    for result, error in itertools.chain(*families.values()):
        by_result.setdefault(result, []).extend([error] if error else [])
    detectable = []
    for (metric, statistic), family in families.items():
        ratios = sorted(
            (smallest_detectable_ratio(error, by_result[result], tests, confidence, same_within), result)
            for result, error in family
            if error is not None
        )
        least, most = (ratios[0], ratios[-1]) if ratios else ((None, None), (None, None))
        limits = most[0], least[0], least[1], most[1]
        detectable.append(DetectableChange(metric, statistic, len(family), len(ratios), *limits))
    return tuple(detectable)


Error = tuple[float, float]
"""Standard error of the logarithm of a ratio, and its degrees of freedom."""

UNLIKE_UP_TO = 0.05
"""P value of Bartlett's test."""

ALIKE_ERRORS = 1.25
"""Factor within which errors have no order."""


def _error_of(change: Change, confidence: float) -> Error | None:
    if change.smallest_ratio is None or change.degrees is None:
        return None
    degrees = whole_degrees(change.degrees)
    return math.log(change.smallest_ratio) / shift_for_power(degrees, confidence), degrees


def _pooled(family: Sequence[tuple[int, Error | None]]) -> list[tuple[int, Error | None]]:
    """Return one error for all results that Bartlett's test finds alike: the largest is so by chance."""
    errors = [error for _, error in family if error is not None and error[0] > 0]
    if len(errors) < 2 or any(error is not None and error[0] <= 0 for _, error in family):
        return list(family)
    variances, degrees = np.square([error for error, _ in errors]), np.array([freedom for _, freedom in errors])
    mean, total = float(np.average(variances, weights=degrees)), float(degrees.sum())
    unlike = total * math.log(mean) - float(degrees @ np.log(variances))
    correction = 1 + (float((1 / degrees).sum()) - 1 / total) / (3 * (len(errors) - 1))
    if special().chdtrc(len(errors) - 1, unlike / correction) < UNLIKE_UP_TO:
        return list(family)
    pooled = math.sqrt(mean), whole_degrees(total / len(errors))
    return [(result, error and pooled) for result, error in family]


def smallest_detectable_ratio(
    error: Error, errors_of_result: Sequence[Error], tests: int, confidence: float, same_within: float
) -> float:
    """Return the smallest ratio above 1 that would have been called slower with a probability of 80 %, if no other result changed.

    Its p value is at most alpha times its rank, by the errors of its result, over `tests`; its interval leaves the band of "the same".
    """
    standard_error, degrees = error
    rank = sum(other <= ALIKE_ERRORS * standard_error for other, _ in errors_of_result)
    shift = standard_error * estimated_shift_for_power(degrees, 1 - (1 - confidence) * rank / max(rank, tests))
    reach = student_quantile((1 + confidence) / 2, degrees)
    beyond = math.log1p(same_within) + standard_error * (student_quantile(POWER, degrees) - reach)
    return math.exp(max(shift, beyond))


def among_tests(degrees: float, tests: int, confidence: float) -> float:
    """Return how many times `smallest_ratio`'s logarithm a change has to be to be found among so many tests, if it is the only one."""
    degrees = whole_degrees(degrees)
    needed = estimated_shift_for_power(degrees, 1 - (1 - confidence) / max(1, tests))
    return needed / shift_for_power(degrees, confidence)
