"""How regular a topic is, and so how many messages are missing, and where.

A publisher with a timer sends one message a period: an interval of k periods lacks k - 1. Several publishers on one topic, or a driver
that sends batches, repeat a pattern of m messages.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Int64 = NDArray[np.int64]
Float64 = NDArray[np.float64]

_FEWEST = 8
_TOLERANCE = 0.35
"""Deviation, in mean intervals, of an interval of one period."""

_LEAST_SHARE, _SAME_SHARE, _RIVAL_SHARE, _CLEAR_SHARE = 0.5, 0.02, 0.15, 0.3
_MOST_IN_PATTERN = 16
_WINDOW = 20
_EQUAL_SHARE = 0.8
"""Least share of equal intervals in a stretch that may have another rate; losses at random leave fewer."""

_LEAST_STALL, _QUEUED = 2.5, 0.75
"""Least interval that a queue follows, and the largest interval within that queue, in periods."""

_OFF_GRID, _LEAST_ON_GRID, MOST_STEPS, _OFF_MEAN = 0.2, 0.95, 20, 0.002
"""Deviation of a stamp in periods, the least share within it, the longest step that is compared, the mean deviation of equal steps."""

_MOST_PAUSED, _MOST_CHANGES, _LEAST_MODE = 2.5, 2, 3
_MOST_TWICE = 0.9
"""Least expected messages per message of a pattern."""

_FEWEST_PHASES, _MOST_PHASES, _PHASE_BINS, _LEAST_POWER, _LONGEST_HOLE = 200, 2000, 8, 20.0, 1000
"""Messages with a common phase, bins of a period, least power (random times exceed it once in a million), longest interval in periods."""

_NEIGHBOURS, _PHASE_LOST = 8, 0.65
"""Messages on either side that must differ in phase, and by how many periods."""


@dataclass(frozen=True, slots=True)
class Hole:
    """Time without messages that were due, the first of them at `start_ns`."""

    start_ns: int
    duration_ns: int
    missing: int

    def overlaps(self, start_ns: int, end_ns: int) -> bool:
        return self.start_ns < end_ns and start_ns < self.start_ns + self.duration_ns

    def meets(self, other: Hole) -> bool:
        return self.overlaps(other.start_ns, other.start_ns + other.duration_ns)


@dataclass(frozen=True, slots=True)
class Regularity:
    """What the times of a topic show; times in ns."""

    period_ns: float
    in_pattern: int
    jitter_ns: float
    missing: int
    low: int
    high: int
    share: float = 1.0
    holes: list[Hole] = field(default_factory=list)

    @property
    def rate_hz(self) -> float:
        return self.in_pattern / self.period_ns * 1e9

    def without(self, is_none: Callable[[Hole], bool]) -> Regularity:
        real = [hole for hole in self.holes if not is_none(hole)]
        less = sum(hole.missing for hole in self.holes) - sum(hole.missing for hole in real)
        low, missing, high = (max(count - less, 0) for count in (self.low, self.missing, self.high))
        return replace(self, missing=missing, low=low, high=high, holes=real)


def spread(values: Int64 | Float64) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def find_regularity(times_ns: Int64) -> Regularity | None:
    """Return the regularity of ascending times; None without a period."""
    patterns = [pattern for m in range(1, _MOST_IN_PATTERN + 1) if (pattern := _pattern(times_ns, m)) is not None]
    if not patterns:
        return None
    clearest = max(pattern.share for pattern in patterns)
    fewest = min(pattern.expected for pattern in patterns if pattern.share > clearest - _CLEAR_SHARE)
    near = [pattern for pattern in patterns if pattern.expected <= 1.15 * fewest + 1]
    most = max(pattern.share for pattern in near)
    best = next(pattern for pattern in near if pattern.share > most - _SAME_SHARE)
    if patterns[0].length == 1 < best.length and _is_single_with_stalls(np.diff(times_ns) / patterns[0].period_ns):
        best = patterns[0]
    period_ns, in_pattern = best.period_ns, best.length
    if in_pattern == 1:
        regularity = _by_phase(times_ns, best) or _single(times_ns, period_ns)
    else:
        regularity = _several(times_ns, period_ns, in_pattern)
        rivals = [
            _several(times_ns, rival.period_ns, rival.length)
            for rival in near
            if rival.length > in_pattern and rival.share > most - _RIVAL_SHARE
        ]
        low, high = min(r.low for r in (regularity, *rivals)), max(r.high for r in (regularity, *rivals))
        grid = find_grid(times_ns)  # of one publisher that loses some messages of each pattern
        high = high if grid is None else max(high, int((grid[1] - 1).sum()))
        regularity = replace(regularity, low=low, high=high)
    pauses = len(regularity.holes) > 2 and len(times_ns) + regularity.missing > _MOST_PAUSED * len(times_ns)
    return None if pauses else replace(regularity, share=best.share)


def joined(parts: Sequence[Regularity]) -> Regularity:
    first = parts[0]
    holes = [hole for hole in first.holes if all(any(map(hole.meets, part.holes)) for part in parts[1:])]
    rate = sum(part.rate_hz for part in parts)
    slowest = max(parts, key=lambda part: part.period_ns)
    return replace(
        slowest,
        in_pattern=max(round(rate * slowest.period_ns / 1e9), 1),
        jitter_ns=float(np.median([part.jitter_ns for part in parts])),
        missing=sum(part.missing for part in parts),
        low=sum(part.low for part in parts),
        high=sum(part.high for part in parts),
        share=min(part.share for part in parts),
        holes=holes,
    )


class _Pattern(NamedTuple):
    length: int
    period_ns: float
    share: float
    expected: float


def _pattern(times_ns: Int64, m: int) -> _Pattern | None:
    if len(times_ns) < max(_FEWEST, 4 * m):
        return None
    periods_ns = times_ns[m:] - times_ns[:-m]
    typical_ns = float(np.median(periods_ns))
    if typical_ns <= 0:
        return None
    regular = np.abs(periods_ns - typical_ns) < _TOLERANCE * typical_ns / m
    share = float(regular.mean())
    if share < _LEAST_SHARE:
        return None
    period_ns = float(periods_ns[regular].mean())
    expected = m * float(times_ns[-1] - times_ns[0]) / period_ns + 1
    return _Pattern(m, period_ns, share, expected) if expected >= _MOST_TWICE * len(times_ns) else None


def _by_phase(times_ns: Int64, pattern: _Pattern) -> Regularity | None:
    """Return the regularity of times off a grid by a good part of a period each, by their sharpest phase (Rayleigh's test); None without."""
    ratio = np.diff(times_ns) / pattern.period_ns
    is_steady = pattern.share > _EQUAL_SHARE or len(times_ns) < _FEWEST_PHASES or _is_single_with_stalls(ratio)
    if is_steady or ratio.max() > _LONGEST_HOLE or _rate_changes(ratio):
        return None
    parts, missing = np.array_split(times_ns, -(-len(times_ns) // _MOST_PHASES)), 0
    for number, part_ns in enumerate(parts):
        bins = np.bincount((part_ns - part_ns[0]) * _PHASE_BINS // round(pattern.period_ns))
        size = 4 << len(bins).bit_length()
        first, last = (round(size / _PHASE_BINS * factor) for factor in (0.88, 1.12))
        power = np.abs(np.fft.rfft(bins, size)[first:last]) ** 2 / len(part_ns)
        if power.max() < _LEAST_POWER:
            return None
        part_period_ns = round(pattern.period_ns) * size / _PHASE_BINS / (first + int(power.argmax()))
        end_ns = parts[number + 1][0] if number + 1 < len(parts) else part_ns[-1] + part_period_ns
        missing += round(float(end_ns - part_ns[0]) / part_period_ns) - len(part_ns)
    missing, unsure = max(missing, 0), 2 + round(2 * len(parts) ** 0.5)
    whole = _single(times_ns, float(times_ns[-1] - times_ns[0]) / (len(times_ns) - 1 + missing))
    return replace(whole, missing=missing, low=max(missing - unsure, 0), high=missing + unsure)


def find_grid(stamps_ns: Int64) -> tuple[float, Int64] | None:
    """Return the period of ascending stamps that are multiples of one apart, and their steps in periods; None for others."""
    steps_ns = np.diff(stamps_ns)
    positive_ns = steps_ns[steps_ns > 0]
    if len(stamps_ns) < _FEWEST or len(positive_ns) < 0.9 * len(steps_ns):
        return None
    period_ns = float(np.median(positive_ns[positive_ns < 1.5 * np.quantile(positive_ns, 0.05)]))
    for _ in range(3):
        ratio = positive_ns / period_ns
        steps = np.rint(ratio)
        short = (steps >= 1) & (steps <= MOST_STEPS)
        on_grid = short & (np.abs(ratio - steps) < _OFF_GRID)
        if on_grid.sum() < max(_LEAST_ON_GRID * short.sum(), len(ratio) / 2):
            return None
        period_ns = float(positive_ns[on_grid].sum() / steps[on_grid].sum())
    steps = np.rint(steps_ns / period_ns).astype(np.int64)
    return (period_ns, steps) if _is_one_grid(steps_ns / period_ns, steps) else None


def _is_one_grid(ratio: Float64, steps: Int64) -> bool:
    """Return whether equal steps are multiples in the mean; of two publishers in turn they are not."""
    for length, count in zip(*np.unique(steps, return_counts=True), strict=True):
        off = np.abs(ratio[steps == length] - length)
        mean_off = abs(float((ratio[steps == length] - length).mean()))
        if 0 < length <= MOST_STEPS and count >= _FEWEST and mean_off > _OFF_MEAN + 4 * float(off.std()) / count**0.5:
            return False
    return True


def with_rivals(grid: Regularity, steps: Int64) -> Regularity:
    """Return a grid as of a publisher that changes its rate, or of two at multiples, if it can be; one that loses messages is the other end."""
    changes = _rate_changes(steps.astype(float) / np.median(steps))
    usual = np.concatenate([np.full(len(part), np.median(part)) for part in np.split(steps, changes)])
    if changes and (len(changes) <= _MOST_CHANGES or usual.max() >= _LEAST_MODE):
        fewest = min(max(round(float((steps / usual - 1).sum())), 0), grid.missing)
        holes = [hole for hole in grid.holes if hole.missing >= usual.max()]
        return replace(grid, missing=fewest, low=fewest, holes=holes)
    indices = np.append(0, np.cumsum(steps))
    for length in range(4, _MOST_IN_PATTERN + 1):
        cycles = indices[-1] / length
        counts = np.bincount(indices % length, minlength=length)
        sent, is_none = np.flatnonzero(counts > cycles / 2), counts <= _SAME_SHARE * cycles
        if cycles < _FEWEST or len(sent) + is_none.sum() < length or length % max(len(sent) - 1, 1):
            continue
        step = length // (len(sent) - 1)
        if step > 1 and any((np.diff(sent[sent != slower]) == step).all() for slower in sent):
            fewest = max(grid.missing - int(is_none[np.arange(indices[-1] + 1) % length].sum()), 0)
            holes = [hole for hole in grid.holes if hole.missing >= step]
            period_ns = length * grid.period_ns
            return replace(grid, period_ns=period_ns, in_pattern=len(sent), missing=fewest, low=fewest, holes=holes)
    return grid


def _single(times_ns: Int64, period_ns: float) -> Regularity:
    """Count what one rate lacks; with stretches of another rate, what the rates lack, within the interval of both readings."""
    intervals = np.diff(times_ns) / period_ns
    ratio, unsure = _without_queues(intervals)
    if (ratio != intervals).any():
        times_ns = times_ns[0] + np.rint(np.concatenate([[0.0], np.cumsum(ratio)]) * period_ns).astype(np.int64)
    whole = _one_rate(times_ns, period_ns)
    whole = replace(whole, high=whole.high + unsure)
    edges = _rate_changes(ratio)
    if not edges:
        return whole
    parts = []
    for start, stop in pairwise([0, *edges, len(ratio)]):
        part_ns = times_ns[start : stop + 1]
        parts.append(_one_rate(part_ns, float(np.median(np.diff(part_ns)))))
    fastest = max(parts, key=lambda part: part.rate_hz)
    rival = whole if fastest.rate_hz < 1.25 * whole.rate_hz else _one_rate(times_ns, fastest.period_ns)
    return replace(
        fastest,
        missing=sum(part.missing for part in parts),
        low=min(sum(part.low for part in parts), rival.low),
        high=max(sum(part.high for part in parts) + unsure, rival.high),
        holes=[hole for part in parts for hole in part.holes],
    )


def _without_queues(ratio: Float64) -> tuple[Float64, int]:
    """Return intervals as they were sent, and how many messages a last stall, with its queue cut off, may lack.

    After a stall its messages come at once: only what these do not make up for is missing.
    """
    sent, queues, unsure = ratio.copy(), 0, 0
    for at in np.flatnonzero(ratio > _LEAST_STALL).tolist():
        late, end = float(ratio[at]) - 1, at + 1
        while end < len(ratio) and ratio[end] < _QUEUED and late > (1 - ratio[end]) / 2:
            late -= 1 - float(ratio[end])
            end += 1
        if end == len(ratio) and queues:
            late, unsure = 0.0, round(late)
        if end - at > 2 or unsure:
            sent[at], sent[at + 1 : end] = 1 + late, 1
            queues += 1
    return sent, unsure


def _is_single_with_stalls(ratio: Float64) -> bool:
    sent, _ = _without_queues(ratio)
    return bool((sent != ratio).any() and (np.abs(sent - 1) < _TOLERANCE).mean() > _LEAST_ON_GRID)


def _rate_changes(ratio: Float64) -> list[int]:
    if len(ratio) <= _WINDOW:
        return []
    padded = np.pad(ratio, _WINDOW, mode="reflect")
    typical = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * _WINDOW + 1), axis=1)
    is_other = np.abs(typical - 1) > 0.25
    changes = (np.flatnonzero(np.diff(is_other.astype(np.int8))) + 1).tolist()
    edges = []
    for start, stop in pairwise([0, *changes, len(ratio)]):
        part = ratio[start:stop]
        is_equal = np.abs(part - np.median(part)) < _TOLERANCE * np.median(part)
        if is_other[start] and len(part) >= _WINDOW and is_equal.mean() >= _EQUAL_SHARE:
            edges += [start, stop]
    return sorted({edge for edge in edges if 0 < edge < len(ratio)})


def _one_rate(times_ns: Int64, period_ns: float) -> Regularity:
    intervals_ns = np.diff(times_ns)
    ratio = intervals_ns / period_ns
    steps = _settled(ratio, np.rint(ratio).astype(np.int64))
    regular_ns = intervals_ns[(steps == 1) & (np.abs(ratio - 1) < _TOLERANCE)]
    slow_ns, fast_ns = _extremes(regular_ns, period_ns)
    is_gap = steps >= 2
    fewer = int((steps[is_gap] - np.minimum(steps[is_gap], np.rint(intervals_ns[is_gap] / slow_ns))).sum())
    more = int((np.maximum(steps[is_gap], np.rint(intervals_ns[is_gap] / fast_ns)) - steps[is_gap]).sum())
    unsure = round(2 * np.sqrt(int((np.abs(ratio - np.rint(ratio)) > _TOLERANCE).sum())))
    missing = max(int(steps.sum()) - len(steps), 0)
    gaps = np.flatnonzero(is_gap)
    gaps = gaps[np.argsort(-intervals_ns[gaps], kind="stable")]
    gaps = np.sort(gaps[: np.searchsorted(np.cumsum(steps[gaps] - 1), missing) + 1] if missing else gaps[:0])
    return Regularity(
        period_ns,
        1,
        spread(regular_ns) if len(regular_ns) else 0.0,
        missing,
        max(missing - fewer - unsure, 0),
        missing + more + unsure,
        holes=[
            Hole(int(times_ns[at] + period_ns), int(intervals_ns[at] - period_ns), int(steps[at] - 1))
            for at in gaps.tolist()
        ],
    )


def _extremes(regular_ns: Int64, period_ns: float) -> tuple[float, float]:
    """Slowest and fastest period, as means of 32 intervals."""
    if len(regular_ns) < 64:
        return period_ns, period_ns
    means = regular_ns[: len(regular_ns) // 32 * 32].reshape(-1, 32).mean(axis=1)
    return float(np.quantile(means, 0.95)), float(np.quantile(means, 0.05))


def _settled(ratio: Float64, steps: Int64) -> Int64:
    """Correct the steps of late messages: what follows them is in phase again."""
    for at in np.flatnonzero((np.abs(ratio - np.rint(ratio)) > 0.25) & (ratio < 16)).tolist():
        start = max(at - _NEIGHBOURS, 0)
        phase = np.cumsum((ratio - steps)[start : at + _NEIGHBOURS])
        before = np.append(0.0, phase[: at - start])
        shift = float(np.median(phase[at - start :]) - np.median(before))
        if abs(shift) > _PHASE_LOST:
            steps[at] = max(steps[at] + round(shift), 0)
    for at in np.flatnonzero(steps[1:-1] == 0).tolist():  # one late message is not a missing one
        late = at + 2 * int(steps[at + 2] > steps[at])
        if steps[late] > 1:
            steps[[late, at + 1]] += [-1, 1]
    return steps


def _several(times_ns: Int64, period_ns: float, in_pattern: int) -> Regularity:
    intervals_ns = np.diff(times_ns)
    largest = np.sort(intervals_ns)[-max(len(intervals_ns) // in_pattern, 1) :]
    usual_ns = float(np.median(largest))
    periods_ns = times_ns[in_pattern:] - times_ns[:-in_pattern]
    # One of several publishers may begin later or end earlier.
    regular = np.flatnonzero(np.abs(periods_ns - period_ns) < _TOLERANCE * period_ns / in_pattern)
    inner_ns = times_ns[regular[0] : regular[-1] + in_pattern + 1]
    missing, most = (_lacking(part_ns, period_ns, in_pattern, usual_ns) for part_ns in (inner_ns, times_ns))
    gaps = np.flatnonzero(intervals_ns > usual_ns + 0.8 * period_ns)
    lost = np.rint((intervals_ns[gaps] - usual_ns) / period_ns).astype(np.int64) * in_pattern
    unsure = in_pattern + round(missing**0.5)
    return Regularity(
        period_ns,
        in_pattern,
        spread(periods_ns),
        missing,
        max(missing - unsure, 0),
        max(most, missing) + unsure,
        holes=[
            Hole(int(times_ns[at] + usual_ns), int(intervals_ns[at] - usual_ns), count)
            for at, count in zip(gaps.tolist(), lost.tolist(), strict=True)
        ],
    )


def _lacking(times_ns: Int64, period_ns: float, in_pattern: int, usual_ns: float) -> int:
    if usual_ns > period_ns / 2:  # batches with a pause between them
        starts = times_ns[np.append(0, np.flatnonzero(np.diff(times_ns) > usual_ns / 2) + 1)]
        return max(in_pattern * int(np.rint(np.diff(starts) / period_ns).sum() + 1) - len(times_ns), 0)
    since = (times_ns - times_ns[0]) / period_ns
    # Wraps around: the last index is the first.
    last = int(np.flatnonzero(np.abs(since - np.rint(since)) < 0.1)[-1])
    return max(round(float(since[last])) * in_pattern - last, 0)
