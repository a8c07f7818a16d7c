"""Spreads of several groups at once, for speed only: each is what `spread_of_runs` returns for its group.

Numpy takes as long to start on an array as to process some thousand values.
"""

from __future__ import annotations

from collections.abc import Sequence

from .runs import Runs, Statistic
from .spread import Spread, log_errors, spread_from

SMALL_GROUP = 20_000
"""Messages of a group up to which batching saves time."""


def spreads_of_groups(groups: Sequence[Runs], statistics: Sequence[Statistic]) -> list[list[Spread]]:
    """Return the spread of each statistic, a quantile, in each group; each run has a message."""
    if not groups:
        return []
    quantiles = [statistic.quantile for statistic in statistics if statistic.quantile is not None]
    together = groups[0] if len(groups) == 1 else Runs(tuple(run for group in groups for run in group))
    errors = log_errors(together, quantiles)
    spreads, end = [], 0
    for group in groups:
        start, end = end, end + len(group)
        spreads.append([spread_from(group, s, error[start:end]) for s, error in zip(statistics, errors, strict=True)])
    return spreads
