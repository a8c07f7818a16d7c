"""Which changes a comparison would have seen: the smallest one, from the spread of its own runs.

A single group that became slower among many that did not has the hardest test: Benjamini and Hochberg then ask it for a
p value of alpha divided by the number of groups, and a change wholly within the band of "the same" is never called
slower, however sure it is. The smallest change that is found with a probability of 80 % under both is what counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ...statistics.distributions import shift_for_power, student_quantile
from ...statistics.power import POWER

if TYPE_CHECKING:
    from collections.abc import Iterable

    from ...run_statistics.change import Change


@dataclass(frozen=True, slots=True)
class Sight:
    """What the verdicts on one statistic of one metric would have seen.

    Attributes:
        metric: the metric.
        statistic: its statistic.
        groups: groups in common.
        told: groups whose runs allow a verdict and an estimate of what they would have seen.
        smallest_ratio: a group that became slower by this much or more, whichever it is and though no other did, would
            have been called slower with a probability of at least 80 %; None if `told` is 0.
    """

    metric: str
    statistic: str
    groups: int
    told: int
    smallest_ratio: float | None


def sights(
    changes: Iterable[tuple[str, str, Change]], confidence: float, same_within: float
) -> tuple[Sight, ...]:
    """Return what the verdicts of a comparison would have seen, for each metric and statistic.

    Args:
        changes: metric and statistic of each change of a group.
        confidence: of a verdict.
        same_within: a ratio wholly within `1 +- same_within` is the same.
    """
    families: dict[tuple[str, str], list[Change]] = {}
    for metric, statistic, change in changes:
        families.setdefault((metric, statistic), []).append(change)
    found = []
    for (metric, statistic), of_groups in families.items():
        tests = sum(change.p_value is not None for change in of_groups)
        smallest = [
            one
            for change in of_groups
            if (one := smallest_seen(change, tests, confidence, same_within)) is not None
        ]
        found.append(Sight(metric, statistic, len(of_groups), len(smallest), max(smallest, default=None)))
    return tuple(found)


def smallest_seen(change: Change, tests: int, confidence: float, same_within: float) -> float | None:
    """Return the smallest ratio above 1 that would have been called slower with a probability of 80 %.

    Args:
        change: a change whose runs have logarithms; of others (no run, a lost percentile) it is not known.
        tests: p values that are adjusted together.
        confidence: of a verdict.
        same_within: a ratio wholly within `1 +- same_within` is the same.
    """
    if change.smallest_ratio is None or change.degrees is None:
        return None
    degrees = max(1.0, math.floor(change.degrees * 4) / 4)  # as in `power.smallest_shift`
    error = math.log(change.smallest_ratio) / shift_for_power(degrees, confidence)
    shift = error * shift_for_power(degrees, 1 - (1 - confidence) / max(1, tests))
    # To lie above 1 is not enough: the upper end has to leave the band.
    reach = student_quantile((1 + confidence) / 2, degrees)
    beyond = math.log1p(same_within) + error * (student_quantile(POWER, degrees) - reach)
    return math.exp(max(shift, beyond))
