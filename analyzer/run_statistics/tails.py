"""The messages beyond a quantile of a group of runs: how many episodes they came in, and how they depend."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from ..statistics.intervals import EPISODES_TO_TELL, RUNS_TO_TELL, mean_and_variance
from ..statistics.thresholds import places_beyond, thresholds_of
from .bursts import (
    EPISODE_GAP_SHARE,
    LEAST_GAP,
    episode_ends,
    equal_episodes,
    gap_of,
    independent_squares,
    share_inflations,
    sizes_between,
)
from .runs import Runs

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .runs import Run

    Int64 = NDArray[np.int64]

    from numpy.typing import NDArray

    Float64 = NDArray[np.float64]
    Rows = tuple[Float64, Float64, NDArray[np.intp]]
    """Positions of the first and of the last message of each row, and its messages."""


LEVEL_BELOW = 10
"""The level below a tail leaves this many times as many messages beyond: p90 for p99, p99 for p99.9."""

WIDEST_TAIL = 0.1
"""The largest share of messages that a level below leaves beyond. Tails of p90 and wider have none: there every fifth row
goes on by chance, and an interval covers the bursts that are in it."""

CHANCE = 0.01
"""Probability that independent messages have a row that is taken for a burst."""

BURSTS_TO_TELL = EPISODES_TO_TELL - 1
"""Bursts that do not limit a tail any more. One less than the episodes it needs, because the shortest are not seen: of bursts
of twenty messages one in five is no longer than five, which chance makes as well."""

LEAST_PART = 0.1
"""Bursts that hold a smaller part of a tail do not decide it."""


def level_below(quantile: float) -> float | None:
    """Return the quantile at which the bursts of a tail are looked for; None where the tail is too wide to have one."""
    tail = min(quantile, 1 - quantile)
    if round(tail, 9) >= WIDEST_TAIL:
        return None
    wider = min(LEVEL_BELOW * tail, WIDEST_TAIL)
    return 1 - wider if quantile >= 0.5 else wider


def bursts_to_count(below: Sequence[Float64], beyond: Sequence[Float64], messages: int) -> int | None:
    """Return how many bursts a tail rests on, if they are fewer than `BURSTS_TO_TELL`; None where bursts do not limit it.

    A burst is a row of messages longer than independent messages would have with a probability of `CHANCE`. Rows that
    go on by themselves, as those of neighbours that correlate do, are no bursts of their own kind: one of the rows has to
    be too long as well for the share of them that has a second message, if all went on with that probability.

    Args:
        below: for each run the positions of its messages beyond the level below, in messages, rising.
        beyond: the same beyond the quantile.
        messages: of all runs.
    """
    events = sum(map(len, below))
    if not events:
        return None
    gap = gap_of(events, messages, EPISODE_GAP_SHARE)
    edges = np.cumsum([0, *map(len, below)])
    sizes = sizes_between(episode_ends(np.concatenate(below), gap, edges))
    by_chance = 1 - (1 - events / messages) ** math.floor(gap)
    going_on = float(np.count_nonzero(sizes > 1)) / len(sizes)
    bursts = None
    for probability in (by_chance, max(by_chance, going_on)):
        longest = _longest_row(len(sizes), probability)
        if sizes.max() <= longest:
            return None
        kept = [_joined_rows(_rows(positions, gap), longest, gap, messages) for positions in below]
        count, inside = sum(len(first) for first, _ in kept), _inside(kept, beyond)
        if count >= BURSTS_TO_TELL or inside < LEAST_PART * sum(map(len, beyond)):
            return None
        bursts = count if bursts is None else bursts
    return bursts


def _rows(positions: Float64, gap: float) -> Rows:
    last = episode_ends(positions, gap)
    first = np.append(0, last[:-1] + 1)[: len(last)].astype(np.intp)
    return positions[first], positions[last], last - first + 1


def _longest_row(rows: int, probability: float) -> float:
    """Return the length that none of so many rows exceeds, by `CHANCE`, if each goes on with a probability."""
    if probability >= 1:
        return math.inf
    return 1 + math.log(CHANCE / rows) / math.log(max(probability, 1e-9))


def _joined_rows(rows: Rows, longest: float, gap: float, messages: int) -> tuple[Float64, Float64]:
    """Return the first and last position of each burst: longer rows, those together that a few fast messages part."""
    first, last, sizes = rows
    is_long = sizes > longest
    first, last = first[is_long], last[is_long]
    if not len(first):
        return first, last
    near = max(gap, gap_of(len(first), messages, EPISODE_GAP_SHARE))
    ends = np.append(np.flatnonzero(first[1:] - last[:-1] > near), len(first) - 1)
    return first[np.append(0, ends[:-1] + 1)], last[ends]


def _inside(bursts: Sequence[tuple[Float64, Float64]], beyond: Sequence[Float64]) -> int:
    """Return the messages of a tail that lie in bursts."""
    return sum(
        int((np.searchsorted(positions, last, "right") - np.searchsorted(positions, first, "left")).sum())
        for (first, last), positions in zip(bursts, beyond, strict=True)
    )


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
        squared: sum of the squares of `sizes`.
        squares: mean squared size of an episode over its mean size, of as many independent messages.
        rows: unbroken rows that they came in; None for as many as there are episodes.
        bursts: bursts that the whole group's tail rests on, if they are few (`long_bursts`); None where they do not limit it.
    """

    messages: int
    sizes: Int64
    inflation: float
    squared: int
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
    return Runs.of(runs).of_quantile(quantile, find_tails)


def find_tails(runs: Runs, quantiles: Sequence[float]) -> list[list[Tail]]:
    """Return the tails of each run beyond each quantile; see `tails_of`."""
    # Side by side: all runs beyond the first quantile, then beyond the second ...
    of_quantiles = [runs.beyond(quantile) for quantile in quantiles]
    positions = np.concatenate([beyond.positions for beyond in of_quantiles])
    events = np.concatenate([beyond.edges[1:] - beyond.edges[:-1] for beyond in of_quantiles])
    edges = np.concatenate([[0], np.cumsum(events)])
    counts = list(zip(events.tolist(), runs.lengths * len(quantiles), strict=True))
    gaps = [gap_of(count, messages, TAIL_GAP_SHARE) for count, messages in counts]
    ends = episode_ends(positions, np.repeat(gaps, events), edges)
    rows = episode_ends(positions, LEAST_GAP, edges).searchsorted(edges)
    sizes, episodes = sizes_between(ends), ends.searchsorted(edges)
    squared = np.diff(np.concatenate([[0], np.cumsum(sizes * sizes)])[episodes])
    bursts = [of_run for quantile in quantiles for of_run in _bursts(runs, quantile)]
    inflations = [inflation for quantile in quantiles for inflation in runs.inflations(quantile)]
    tails = [
        Tail(
            messages=count,
            sizes=sizes[begin:end],
            inflation=inflation,
            squared=of_sizes,
            squares=independent_squares(count, messages, gap),
            rows=of_rows,
            bursts=of_bursts,
        )
        for (count, messages), (begin, end), inflation, of_sizes, gap, of_rows, of_bursts in zip(
            counts,
            pairwise(episodes.tolist()),
            inflations,
            squared.tolist(),
            gaps,
            (rows[1:] - rows[:-1]).tolist(),
            bursts,
            strict=True,
        )
    ]
    return [tails[first : first + len(runs)] for first in range(0, len(tails), len(runs))]


def _bursts(runs: Runs, quantile: float) -> list[int | None]:
    """Return for each run the bursts that limit the tail of its group, if any do (`bursts_to_count`)."""
    level = level_below(quantile)
    if level is None:
        return [None] * len(runs)
    below, beyond = (tail.of_runs(tail.positions) for tail in (runs.beyond(level), runs.beyond(quantile)))
    bursts: list[int | None] = []
    for group in runs.groups:
        here = slice(len(bursts), len(bursts) + len(group))
        bursts += [bursts_to_count(below[here], beyond[here], int(group.edges[-1]))] * len(group)
    return bursts


def inflations_of(runs: Runs, quantile: float) -> list[float]:
    """Return for each run what `tails_of` says of the inflation of that run alone, without the rest that it finds out.

    Args:
        runs: at least one message each.
        quantile: between 0 and 1, both excluded.
    """
    return runs.inflations(quantile) if len(runs) == 1 else runs.of_quantile(quantile, find_own_inflations)


def find_own_inflations(runs: Runs, quantiles: Sequence[float]) -> list[list[float]]:
    """Return the inflations of each run beyond each of its own quantiles; see `inflations_of`."""
    thresholds = [thresholds_of(run.ordered, quantiles) for run in runs]
    places = places_beyond(runs.values, runs.edges, thresholds, quantiles)
    return share_inflations(runs.cells, [(of_tail, of_tail.searchsorted(runs.edges)) for of_tail in places])


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
    counts = [tail.messages for tail in tails]
    equal = equal_episodes(sum(counts), sum(tail.squared / tail.squares for tail in tails))
    if equal is None:
        return None
    equal = min(equal, sum(len(tail.sizes) if tail.rows is None else tail.rows for tail in tails))
    if tails[0].bursts is not None:
        equal = min(equal, tails[0].bursts)
    if len(tails) < RUNS_TO_TELL or min(counts) == max(counts):
        return equal
    mean, variance = mean_and_variance(np.array(counts, np.float64))
    variation = variance / mean**2
    ninth = 2 / (9 * (len(tails) - 1))
    least_likely = (1 - ninth + _LIKELY_DEVIATIONS * math.sqrt(ninth)) ** 3
    return min(equal, max(1, round(least_likely * len(tails) / variation)))
