"""Bursts that are too few to tell of: counted where they are seen, at a level below the quantile.

A handful of bursts among thousands of quiet messages is the case in which a tail looks best when it is known least. The
samples in which the bursts happened to be short have a p99 that lies among the quiet messages, each of them an episode
of its own, and the messages beyond it count as many episodes. At a level that leaves ten times as many messages beyond, a
burst shows as what it is: an unbroken row of them, longer than chance makes one.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..statistics.intervals import EPISODES_TO_TELL
from .bursts import EPISODE_GAP_SHARE, episode_ends, gap_of, sizes_between

if TYPE_CHECKING:
    from collections.abc import Sequence

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
