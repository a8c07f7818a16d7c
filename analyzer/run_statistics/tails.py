"""The messages beyond a quantile of a group of runs: how many episodes they came in, and how they depend."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from ..statistics.intervals import RUNS_TO_TELL
from ..statistics.moments import mean_and_variance
from .bursts import (
    LEAST_GAP,
    episode_ends,
    equal_episodes,
    gap_of,
    independent_squares,
    share_inflations,
    sizes_between,
)
from .long_bursts import bursts_to_count, level_below
from .runs import Runs, threshold_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .runs import Run

    Int64 = NDArray[np.int64]

LIKELY = 0.95
_LIKELY_DEVIATIONS = NormalDist().inv_cdf(LIKELY)

TAIL_GAP_SHARE = 0.5
"""Two messages of a tail closer than this share of their mean distance are one episode. Two in five independent ones are,
which is counted back (`bursts.independent_squares`). With `EPISODE_GAP_SHARE`, an excursion of correlated neighbours that
comes back twice counts as three: at a correlation of 0.95, p99 of one run of 5000 had both ends in 12 of 100 samples,
of which 84 % held the truth; with this it has them in 62, of which 94 % do. Of 1000 independent messages 76 in 100 have both
ends instead of 61, because one pair by chance is not one episode less."""


@dataclass(frozen=True, slots=True, eq=False)
class Tail:
    """The messages of one run beyond a quantile of its group.

    Attributes:
        messages: how many.
        sizes: int64, messages in each episode that they came in.
        inflation: variance of their share divided by that of independent messages.
        squares: mean squared size of an episode over its mean size, of as many independent messages.
        rows: unbroken rows that they came in; None for as many as there are episodes.
        bursts: bursts that the whole group's tail rests on, if they are few (`long_bursts`); None where they do not limit it.
    """

    messages: int
    sizes: Int64
    inflation: float
    squares: float = 1.0
    rows: int | None = None
    bursts: int | None = None


def tails_of(runs: Sequence[Run], quantile: float) -> list[Tail]:
    """Return for each run what lies beyond a quantile of the group, levels of runs set aside.

    Beyond one value for all runs, so that a run without a burst does not add the episodes of its quiet tail to those
    of a run that had one; relative to each run's median, so that a run that is slower throughout is not one episode.

    Args:
        runs: at least one message each.
        quantile: between 0 and 1, both excluded.
    """
    group = Runs.of(runs)
    beyond, below = group.beyond(quantile), level_below(quantile)
    positions = beyond.of_runs(beyond.positions)
    bursts = None
    if below is not None:
        wider = group.beyond(below)
        bursts = bursts_to_count(wider.of_runs(wider.positions), positions, int(group.edges[-1]))
    events = beyond.edges[1:] - beyond.edges[:-1]
    counts = list(zip(events.tolist(), group.lengths, strict=True))
    gaps = [gap_of(count, messages, TAIL_GAP_SHARE) for count, messages in counts]
    ends = episode_ends(beyond.positions, np.repeat(gaps, events), beyond.edges)
    rows = episode_ends(beyond.positions, LEAST_GAP, beyond.edges).searchsorted(beyond.edges)
    sizes, episodes = sizes_between(ends), ends.searchsorted(beyond.edges).tolist()
    return [
        Tail(
            messages=count,
            sizes=sizes[begin:end],
            inflation=inflation,
            squares=independent_squares(count, messages, gap),
            rows=of_rows,
            bursts=bursts,
        )
        for (count, messages), begin, end, inflation, gap, of_rows in zip(
            counts,
            episodes,
            episodes[1:],
            beyond.inflations,
            gaps,
            (rows[1:] - rows[:-1]).tolist(),
            strict=False,
        )
    ]


def inflations_of(runs: Runs, quantile: float) -> list[float]:
    """Return for each run what `tails_of` says of the inflation of that run alone, without the rest that it finds out.

    Args:
        runs: at least one message each.
        quantile: between 0 and 1, both excluded.
    """
    if len(runs) == 1:
        return runs.beyond(quantile).inflations
    is_beyond = np.empty(int(runs.edges[-1]), np.bool_)
    for run, (begin, end) in zip(runs, pairwise(runs.edges.tolist()), strict=True):
        is_beyond[begin:end] = threshold_of(run.ordered, quantile).is_beyond(run.values)
    places = is_beyond.nonzero()[0]
    return share_inflations(runs.cells, places, places.searchsorted(runs.edges))


def episodes_of(tails: Sequence[Tail]) -> int | None:
    """Return how many episodes of equal size the messages beyond a quantile are worth; None without such a message.

    From the sizes of the episodes within the runs, as many as independent messages that vary as much; but no more than
    there are unbroken rows of messages, no more than the bursts where these are few (`long_bursts`), and no more than the
    runs themselves make likely. If E episodes fall on R runs by chance, the squared coefficient of variation of the
    messages that each run has beyond is about R / E. Bursts that a gap cut in pieces, or that half of the runs do not have,
    show there: the limit is the E for which so large a variation still has a probability of 5 % (chi-square with R - 1
    degrees, by E. Wilson and M. Hilferty's cube, 1931).

    Args:
        tails: of all runs of the group.
    """
    squares = np.repeat([tail.squares for tail in tails], [len(tail.sizes) for tail in tails])
    equal = equal_episodes(np.concatenate([tail.sizes for tail in tails]), squares)
    if equal is None:
        return None
    equal = min(equal, sum(len(tail.sizes) if tail.rows is None else tail.rows for tail in tails))
    if tails[0].bursts is not None:
        equal = min(equal, tails[0].bursts)
    counts = [tail.messages for tail in tails]
    if len(tails) < RUNS_TO_TELL or min(counts) == max(counts):
        return equal
    mean, variance = mean_and_variance(np.array(counts, np.float64))
    variation = variance / mean**2
    ninth = 2 / (9 * (len(tails) - 1))
    least_likely = (1 - ninth + _LIKELY_DEVIATIONS * math.sqrt(ninth)) ** 3
    return min(equal, max(1, round(least_likely * len(tails) / variation)))
