"""The messages beyond a quantile of a group of runs: how many episodes they came in, and how they depend."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from ..statistics.intervals import RUNS_TO_TELL
from .bursts import (
    LEAST_GAP,
    episode_ends,
    equal_episodes,
    gap_of,
    independent_squares,
    positions_of,
    share_inflation,
    sizes_at,
)
from .long_bursts import bursts_to_count, level_below
from .runs import Levels

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .runs import Run, Values

    Int64 = NDArray[np.int64]

LIKELY = 0.95


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


@dataclass(frozen=True, slots=True)
class Threshold:
    """Where the tail of a group begins.

    Attributes:
        value: the order statistic of all messages next to the quantile, on the side of the bulk.
        is_upper: whether the tail lies above it (quantiles from p50 on) or below.
        is_part: whether messages equal to the value are part of the tail.
    """

    value: float
    is_upper: bool
    is_part: bool

    def is_beyond(self, values: Values) -> NDArray[np.bool_]:
        """Return which values lie in the tail.

        Where the value is infinite, the lost messages do: more of them than the quantile leaves room for, but
        comparing with infinity as with a number would make a series of lost and received ones look constant.
        """
        if math.isinf(self.value):
            return ~np.isfinite(values)
        if self.is_upper:
            return values >= self.value if self.is_part else values > self.value
        return values <= self.value if self.is_part else values < self.value


def tails_of(runs: Sequence[Run], quantile: float) -> list[Tail]:
    """Return for each run what lies beyond a quantile of the group, levels of runs set aside.

    Beyond one value for all runs, so that a run without a burst does not add the episodes of its quiet tail to those
    of a run that had one; relative to each run's median, so that a run that is slower throughout is not one episode.

    Args:
        runs: at least one message each.
        quantile: between 0 and 1, both excluded.
    """
    levels = levels_of(runs)
    beyond = _places_beyond(runs, levels, quantile)
    positions = _positions(runs, beyond)
    below = level_below(quantile)
    bursts = None
    if below is not None:
        wider = _positions(runs, _places_beyond(runs, levels, below))
        bursts = bursts_to_count(wider, positions, sum(map(len, runs)))
    return [
        _tail(run, places, of_run, bursts)
        for run, places, of_run in zip(runs, beyond, positions, strict=True)
    ]


def _places_beyond(runs: Sequence[Run], levels: Levels, quantile: float) -> list[NDArray[np.intp]]:
    if len(runs) == 1:
        alone = threshold_of_run(runs[0].ordered, quantile)
        return [alone.is_beyond(runs[0].values).nonzero()[0]]
    threshold = threshold_of(runs, levels, quantile)
    return [
        threshold.is_beyond(run.relative(levels, level)[0]).nonzero()[0]
        for run, level in zip(runs, levels.of_runs, strict=True)
    ]


def _positions(runs: Sequence[Run], places: Sequence[NDArray[np.intp]]) -> list[NDArray[np.float64]]:
    return [positions_of(of_run, len(run), run.sent_ns) for run, of_run in zip(runs, places, strict=True)]


def _tail(run: Run, places: NDArray[np.intp], positions: NDArray[np.float64], bursts: int | None) -> Tail:
    gap = gap_of(len(places), len(run), TAIL_GAP_SHARE)
    return Tail(
        messages=len(places),
        sizes=sizes_at(positions, gap),
        inflation=share_inflation(places, len(run)),
        squares=independent_squares(len(places), len(run), gap),
        rows=len(episode_ends(positions, LEAST_GAP)) if len(places) else 0,
        bursts=bursts,
    )


def inflation_of(run: Run, quantile: float) -> float:
    """Return what `tails_of` says of the inflation of one run alone, without the rest that it finds out.

    Args:
        run: at least one message.
        quantile: between 0 and 1, both excluded.
    """
    threshold = threshold_of_run(run.ordered, quantile)
    return share_inflation(threshold.is_beyond(run.values).nonzero()[0], len(run))


def threshold_of_run(ordered: Values, quantile: float) -> Threshold:
    """Return where the tail of one run begins; see `threshold_of`.

    Args:
        ordered: its values, rising, at least one.
        quantile: between 0 and 1, both excluded.
    """
    is_upper = quantile >= 0.5
    messages = len(ordered)
    position = (messages - 1) * quantile
    value = ordered[math.floor(position) if is_upper else math.ceil(position)]
    below, after = int(ordered.searchsorted(value, "left")), int(ordered.searchsorted(value, "right"))
    if np.isinf(value):
        counts = (messages - below, messages - below)
    else:
        counts = (messages - after, messages - below) if is_upper else (below, after)
    wanted = messages * (1 - quantile if is_upper else quantile)
    misfits = [(count in {0, messages}, abs(count - wanted)) for count in counts]
    return Threshold(float(value), is_upper, is_part=misfits[1] < misfits[0])


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
    messages = np.array([tail.messages for tail in tails])
    if len(tails) < RUNS_TO_TELL or not messages.var():
        return equal
    variation = float(messages.var(ddof=1)) / float(messages.mean()) ** 2
    ninth = 2 / (9 * (len(tails) - 1))
    least_likely = (1 - ninth + NormalDist().inv_cdf(LIKELY) * math.sqrt(ninth)) ** 3
    return min(equal, max(1, round(least_likely * len(tails) / variation)))


def levels_of(runs: Sequence[Run]) -> Levels:
    """Return the median of each run; to be taken off if one is not above zero. One run alone is left as it is.

    A run whose median is infinite is given the middle level of the others.
    """
    medians = np.array([run.median for run in runs])
    is_finite = np.isfinite(medians)
    if len(runs) == 1 or not is_finite.any():
        return Levels((0.0,) * len(runs), is_ratio=False)
    medians[~is_finite] = np.median(medians[is_finite])
    return Levels(tuple(medians.tolist()), is_ratio=bool((medians > 0).all()))


def threshold_of(runs: Sequence[Run], levels: Levels, quantile: float) -> Threshold:
    """Return where the tail of a group begins.

    The quantile of all messages lies between the least and the greatest of the runs' own, so that only what lies
    there is looked at. Of a clock that ticks once a millisecond many values are equal: those at the quantile are
    part of the tail if that brings its share closer to the one that the quantile leaves, and if no others are.

    Args:
        runs: at least one message each.
        levels: of the runs.
        quantile: between 0 and 1, both excluded.
    """
    is_upper = quantile >= 0.5
    messages = sum(len(run) for run in runs)
    position = (messages - 1) * quantile
    place = math.floor(position) if is_upper else math.ceil(position)
    between, below = _between_quantiles(runs, levels, quantile)
    value = float(np.partition(between, place - below)[place - below])
    wanted = messages * (1 - quantile if is_upper else quantile)
    outside = messages - below - len(between) if is_upper else below

    def misfit(candidate: Threshold) -> tuple[bool, float]:
        count = int(np.count_nonzero(candidate.is_beyond(between))) + (outside if math.isfinite(value) else 0)
        return count in {0, messages}, abs(count - wanted)

    return min((Threshold(value, is_upper, is_part) for is_part in (False, True)), key=misfit)


def _between_quantiles(runs: Sequence[Run], levels: Levels, quantile: float) -> tuple[Values, int]:
    """Return the relative values from the least to the greatest of the runs' quantiles, and how many lie below."""
    pairs = list(zip(runs, levels.of_runs, strict=True))
    ranks = [quantile * len(run) for run in runs]
    first, last = (
        [run.relative(levels, level)[1][place] for (run, level), place in zip(pairs, of_runs, strict=True)]
        for of_runs in (
            [max(math.floor(rank) - 1, 0) for rank in ranks],
            [min(math.ceil(rank), len(run) - 1) for rank, run in zip(ranks, runs, strict=True)],
        )
    )
    low, high = min(first), max(last)
    parts, below = [], 0
    for run, level in pairs:
        _, relative = run.relative(levels, level)
        begin, end = relative.searchsorted(low, "left"), relative.searchsorted(high, "right")
        parts.append(relative[begin:end])
        below += int(begin)
    return np.concatenate(parts), below
