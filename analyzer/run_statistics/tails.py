"""The tails of a group of runs: where they begin, the episodes their messages came in, and how these depend."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain, pairwise
from operator import itemgetter

import numpy as np

from ..statistics.distributions import special
from ..statistics.intervals import MIN_EPISODES, MIN_RUNS, WIDEST_TAIL, mean_and_variance, tail_share
from .bursts import (
    EPISODE_GAP_SHARE,
    LEAST_GAP,
    Float64,
    Indices,
    Int64,
    cells_of,
    episode_ends,
    equal_episodes,
    gap_of,
    gaps_of,
    independent_squares,
    share_inflations,
    sizes_between,
)
from .runs import Runs, SendTimes, Values

Streaks = tuple[Float64, Float64, Indices]
"""Positions of the first and of the last message of each streak, and its messages."""

TAIL_GAP_SHARE = 0.5
"""As `EPISODE_GAP_SHARE`, wide enough that an excursion of correlated neighbours that comes back twice is one episode;
`bursts.independent_squares` corrects for independent ones."""

LEVEL_BELOW = 10
"""The level below a tail leaves this many times as many messages beyond: p90 for p99, p99 for p99.9."""

CHANCE = 0.01
"""Probability that independent messages have a streak taken for a burst."""

MIN_BURSTS = MIN_EPISODES - 1
"""Bursts from which on they do not limit a tail; one less than episodes, as the shortest look like chance."""

LEAST_PART = 0.1
"""Bursts with a smaller part of a tail do not decide it."""

LIKELY = 0.95


def limits_of(series: Sequence[Values], quantiles: Sequence[float]) -> Float64:
    """Return where the tails of ascending series begin, shape (series, quantiles): at it or beyond it, which is above it from p50 on.

    Values equal to the quantile (a coarse clock) are part of the tail if its share fits better then, or it is empty without. Beyond an
    infinite limit are the lost messages.
    """
    share = np.array(quantiles)
    is_upper, messages = share >= 0.5, np.array([len(ordered) for ordered in series])[:, None]
    ranks = (messages - 1) * share
    indices = np.where(is_upper, np.floor(ranks), np.ceil(ranks)).astype(np.intp)
    at = [ordered[row] for ordered, row in zip(series, indices, strict=True)]
    below, after = (
        np.array([ordered.searchsorted(values, side) for ordered, values in zip(series, at, strict=True)])
        for side in ("left", "right")
    )
    counts = np.where(is_upper, [messages - after, messages - below], [below, after])
    is_empty = (counts == 0) | (counts == messages)
    off = np.abs(counts - messages * np.where(is_upper, 1 - share, share))
    is_part = (is_empty[1] < is_empty[0]) | ((is_empty[1] == is_empty[0]) & (off[1] < off[0]))
    limits = np.array(at, np.float64)
    next_to = np.nextafter(limits, np.where(is_upper, np.inf, -np.inf))
    return np.where(is_part | np.isinf(limits), limits, next_to)


def indices_beyond(values: Values, offsets: Indices, limits: Float64, quantiles: Sequence[float]) -> list[Indices]:
    """Return for each quantile the indices of the values beyond the limit of their series.

    An upper tail is searched in the next wider one, by indices for speed. `values` are series after series, from `offsets`; `limits`
    are `limits_of` the series.
    """
    indices: dict[float, Indices] = {}
    wider, remainder, ends = None, values, offsets
    for quantile, by_series in sorted(zip(quantiles, limits.T.tolist(), strict=True), key=itemgetter(0)):
        is_upper = quantile >= 0.5
        parts = [
            remainder[start:end] >= limit if is_upper or limit == math.inf else remainder[start:end] <= limit
            for limit, (start, end) in zip(by_series, pairwise(ends.tolist()), strict=True)
        ]
        inside = np.concatenate(parts).nonzero()[0]
        indices[quantile] = inside if wider is None else wider[inside]
        if is_upper:
            wider, remainder = indices[quantile], remainder[inside]
            ends = wider.searchsorted(offsets)
    return [indices[quantile] for quantile in quantiles]


@dataclass(frozen=True, slots=True, eq=False)
class Tail:
    messages: int
    sizes: Int64
    inflation: float
    squared: int
    squares: float = 1.0
    streaks: int | None = None
    bursts: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Beyond:
    """The messages of a group beyond a quantile: ascending indices, `Runs.positions`, and the first of each run."""

    indices: Indices
    positions: Float64
    offsets: Indices

    @property
    def by_run(self) -> list[Float64]:
        return [self.positions[start:end] for start, end in pairwise(self.offsets.tolist())]


def beyond_quantiles(groups: Sequence[Runs], quantiles: Sequence[float]) -> list[Beyond]:
    """Return the messages beyond each quantile of the groups.

    One threshold for all, so that a quiet run adds no episodes; values are relative to their run's level, so that a
    slow run is not one.
    """
    first = groups[0]
    starts = np.arange(len(groups) + 1) * len(first.values)
    bounds = np.append((starts[:-1, None] + first.offsets[:-1]).ravel(), starts[-1])
    limits = limits_of([runs.ordered_relative for runs in groups], quantiles)
    is_single = len(groups) == 1
    values = first.relative if is_single else np.concatenate([runs.relative for runs in groups])
    positions_of_all = first.positions if is_single else _positions([runs.times for runs in groups], bounds)
    beyond = []
    for indices in indices_beyond(values, starts, limits, quantiles):
        offsets = indices.searchsorted(bounds)
        beyond.append(Beyond(indices, positions_of_all(indices, offsets), offsets))
    return beyond


def _positions(times: Sequence[SendTimes], bounds: Indices) -> Callable[[Indices, Indices], Float64]:
    together = SendTimes(np.concatenate([sending.sent_ns for sending in times]), bounds)
    for name in ("first_ns", "distances_ns"):
        together.__dict__[name] = np.concatenate([getattr(sending, name) for sending in times])
    return lambda indices, offsets: together.positions(indices, np.diff(offsets))


def alike(keys: Iterable[Sequence[object]]) -> list[list[int]]:
    """Return the indices of equal keys, by key."""
    indices: dict[tuple[object, ...], list[int]] = {}
    for index, key in enumerate(keys):
        indices.setdefault(tuple(key), []).append(index)
    return list(indices.values())


def tails_of_all(groups: Sequence[tuple[Runs, Sequence[float]]]) -> list[list[list[Tail]]]:
    """Return by group and quantile the tails of the runs; groups with equal quantiles and lengths of runs share the work."""
    tails: dict[int, list[list[Tail]]] = {}
    for numbers in alike((*quantiles, runs.lengths) for runs, quantiles in groups):
        runs_of_all = [groups[number][0] for number in numbers]
        tails.update(zip(numbers, _tails_of_alike(runs_of_all, groups[numbers[0]][1]), strict=True))
    return [tails[number] for number in range(len(groups))]


def _tails_of_alike(groups: Sequence[Runs], quantiles: Sequence[float]) -> list[list[list[Tail]]]:
    if not quantiles:
        return [[] for _ in groups]
    levels = [level_below(quantile) for quantile in quantiles]
    extra = dict.fromkeys(level for level in levels if level is not None and level not in quantiles)
    at = dict(zip([*quantiles, *extra], beyond_quantiles(groups, [*quantiles, *extra]), strict=True))
    tails = [at[quantile] for quantile in quantiles]
    first, count = groups[0], len(groups)
    # All runs of all groups beyond the first quantile, then all beyond the second ...
    positions = np.concatenate([beyond.positions for beyond in tails])
    events = np.concatenate([beyond.offsets[1:] - beyond.offsets[:-1] for beyond in tails])
    offsets = np.concatenate([[0], np.cumsum(events)])
    lengths = first.lengths * (count * len(quantiles))
    gaps = gaps_of(events, np.array(lengths), TAIL_GAP_SHARE)
    ends = episode_ends(positions, np.repeat(gaps, events), offsets)
    streaks = np.diff(episode_ends(positions, LEAST_GAP, offsets).searchsorted(offsets)).tolist()
    sizes, episodes = sizes_between(ends), ends.searchsorted(offsets)
    squared = np.diff(np.concatenate([[0], np.cumsum(sizes * sizes)])[episodes]).tolist()
    spans = pairwise(episodes.tolist())
    # By group: a product with more rows may be rounded differently.
    bounds = np.arange(count)[:, None] * len(first) + np.arange(len(first) + 1)
    inflations = share_inflations(
        first.cells,
        np.concatenate([first.cells.counts(beyond.indices, count) for beyond in tails]),
        np.concatenate([beyond.offsets[bounds] for beyond in tails]),
    )
    bursts = chain.from_iterable(
        [None] * count if level is None else _bursts(at[level], beyond, first)
        for level, beyond in zip(levels, tails, strict=True)
    )
    bursts_of_row = [burst for burst in bursts for _ in range(len(first))]
    inflated = chain.from_iterable(inflations)
    columns = zip(
        events.tolist(), lengths, gaps.tolist(), spans, inflated, squared, streaks, bursts_of_row, strict=True
    )
    rows = [
        Tail(messages, sizes[start:end], inflation, square, independent_squares(messages, length, gap), streak, burst)
        for messages, length, gap, (start, end), inflation, square, streak, burst in columns
    ]
    runs = len(first)
    return [[rows[at : at + runs] for at in range(group * runs, len(rows), count * runs)] for group in range(count)]


def _bursts(below: Beyond, beyond: Beyond, first: Runs) -> list[int | None]:
    """Return the bursts of each group; short ones are seen only beyond the quantile."""
    runs, messages = len(first), len(first.values)
    may_be = _may_be_bursts(below, runs, messages), _may_be_bursts(beyond, runs, messages)
    sides = (below.by_run, beyond.by_run) if any(map(any, may_be)) else ((), ())
    bursts: list[int | None] = [None] * len(may_be[0])
    for group in range(len(bursts)):
        wide, deep = (side[group * runs : (group + 1) * runs] for side in sides)
        for positions, is_likely in zip((wide, deep), may_be, strict=True):
            if is_likely[group] and not bursts[group]:
                bursts[group] = bursts_to_count(positions, deep, messages)
    return bursts


def _may_be_bursts(beyond: Beyond, runs: int, messages: int) -> list[bool]:
    """Return whether a streak of each group is longer than by chance; else `bursts_to_count` is None."""
    events = np.diff(beyond.offsets[::runs])
    gaps = gaps_of(events, np.full(len(events), messages), EPISODE_GAP_SHARE)
    ends = episode_ends(beyond.positions, gaps.repeat(events), beyond.offsets)
    sizes, streaks = sizes_between(ends), np.diff(ends.searchsorted(beyond.offsets[::runs]))
    longest = np.zeros(len(events), np.int64)
    has_any = streaks > 0
    if has_any.any():
        longest[has_any] = np.maximum.reduceat(sizes, (np.cumsum(streaks) - streaks)[has_any])
    columns = zip(events.tolist(), gaps.tolist(), streaks.tolist(), longest.tolist(), strict=True)
    return [
        count > 0 and size > _longest_streak(count, _by_chance(event, messages, gap))
        for event, gap, count, size in columns
    ]


def inflations_of(runs: Runs, quantiles: Sequence[float], groups: int = 1) -> list[list[float]]:
    """Return by quantile and group the inflation of each run's tail; the groups have equal lengths of runs."""
    limits = limits_of([run.ordered for run in runs], quantiles)
    indices = indices_beyond(runs.values, runs.offsets, limits, quantiles)
    size = len(runs) // groups
    cells, bounds = cells_of(runs.lengths[:size]), np.arange(groups)[:, None] * size + np.arange(size + 1)
    return share_inflations(
        cells,
        np.concatenate([cells.counts(tail, groups) for tail in indices]),
        np.concatenate([tail.searchsorted(runs.offsets)[bounds] for tail in indices]),
    )


def episodes_of(tails: Sequence[Tail]) -> int | None:
    """Return how many episodes of equal size the tails of all runs are worth; None without a message.

    At most the unbroken streaks, the few bursts, and what the runs make likely: if E episodes fall on R runs by chance, the squared
    coefficient of variation of the messages that each run has beyond is about R / E. The limit is the E for which so large a variation
    has a probability of 5 % (chi-square with R - 1 degrees).
    """
    counts = [tail.messages for tail in tails]
    equal = equal_episodes(sum(counts), sum(tail.squared / tail.squares for tail in tails))
    if equal is None:
        return None
    equal = min(equal, sum(len(tail.sizes) if tail.streaks is None else tail.streaks for tail in tails))
    if tails[0].bursts is not None:
        equal = min(equal, tails[0].bursts)
    if len(tails) < MIN_RUNS or min(counts) == max(counts):
        return equal
    mean, variance = mean_and_variance(np.array(counts, np.float64))
    degrees = len(tails) - 1
    least_likely = float(special().chdtri(degrees, 1 - LIKELY)) / degrees
    return min(equal, max(1, round(least_likely * len(tails) * mean**2 / variance)))


def level_below(quantile: float) -> float | None:
    tail = tail_share(quantile)
    if tail >= WIDEST_TAIL:
        return None
    wider = min(LEVEL_BELOW * tail, WIDEST_TAIL)
    return 1 - wider if quantile >= 0.5 else wider


def bursts_to_count(below: Sequence[Float64], beyond: Sequence[Float64], messages: int) -> int | None:
    """Return how many bursts a tail rests on; None where they are `MIN_BURSTS` or do not limit it.

    A burst is a streak of messages longer than independent ones have with a probability of `CHANCE`; if correlation makes streaks
    go on, longer than that explains. `below` and `beyond` are, for each run, the ascending positions of its messages beyond
    `level_below` and beyond the quantile.
    """
    events = sum(map(len, below))
    if not events:
        return None
    gap = gap_of(events, messages, EPISODE_GAP_SHARE)
    offsets = np.cumsum([0, *map(len, below)])
    sizes = sizes_between(episode_ends(np.concatenate(below), gap, offsets))
    by_chance = _by_chance(events, messages, gap)
    going_on = float(np.count_nonzero(sizes > 1)) / len(sizes)
    bursts = None
    for probability in (by_chance, max(by_chance, going_on)):
        longest = _longest_streak(len(sizes), probability)
        if sizes.max() <= longest:
            return None
        merged = [_merged_streaks(_streaks(positions, gap), longest, gap, messages) for positions in below]
        count = sum(len(first) for first, _ in merged)
        if count >= MIN_BURSTS or _inside(merged, beyond) < LEAST_PART * sum(map(len, beyond)):
            return None
        bursts = count if bursts is None else bursts
    return bursts


def _streaks(positions: Float64, gap: float) -> Streaks:
    last = episode_ends(positions, gap)
    first = np.append(0, last[:-1] + 1)[: len(last)].astype(np.intp)
    return positions[first], positions[last], last - first + 1


@lru_cache(maxsize=4096)
def _by_chance(events: int, messages: int, gap: float) -> float:
    return 1 - (1 - events / messages) ** math.floor(gap)


@lru_cache(maxsize=4096)
def _longest_streak(streaks: int, probability: float) -> float:
    if probability >= 1:
        return math.inf
    return 1 + math.log(CHANCE / streaks) / math.log(max(probability, 1e-9))


def _merged_streaks(streaks: Streaks, longest: float, gap: float, messages: int) -> tuple[Float64, Float64]:
    first, last, sizes = streaks
    is_long = sizes > longest
    first, last = first[is_long], last[is_long]
    if not len(first):
        return first, last
    near = max(gap, gap_of(len(first), messages, EPISODE_GAP_SHARE))
    ends = np.append(np.flatnonzero(first[1:] - last[:-1] > near), len(first) - 1)
    return first[np.append(0, ends[:-1] + 1)], last[ends]


def _inside(bursts: Sequence[tuple[Float64, Float64]], beyond: Sequence[Float64]) -> int:
    return sum(
        int((np.searchsorted(positions, last, "right") - np.searchsorted(positions, first, "left")).sum())
        for (first, last), positions in zip(bursts, beyond, strict=True)
    )
