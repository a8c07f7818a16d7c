"""How regular a topic arrives, and so how many messages are missing, and where.

A publisher with a timer sends one message a period: an interval of k periods lacks k - 1. Several publishers on one topic, or a driver
that sends batches, repeat a pattern of m messages.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dds_trace.base.units import SECOND_NS

from .bounds import FEW, FEWEST, MOST, NEAR, PATTERN, PHASES, REGULAR, WINDOW
from .holes import Holes
from .quantiles import indices_of, median, middle, quantile, row_medians, spread, steps_of

Int64 = NDArray[np.int64]
Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Regularity:
    """What the times of a topic show; times in ns."""

    period_ns: float
    in_pattern: int
    jitter_ns: float
    missing: int
    low: int
    high: int
    share: float = 1.0
    holes: Holes = field(default_factory=Holes)

    @property
    def rate_hz(self) -> float:
        return self.in_pattern / self.period_ns * SECOND_NS

    def without(self, is_none: Bools) -> Regularity:
        less = int(self.holes.missing[is_none].sum())
        low, missing, high = (max(count - less, 0) for count in (self.low, self.missing, self.high))
        return replace(self, missing=missing, low=low, high=high, holes=self.holes.at(~is_none))

    def unsure(self, is_unsure: Bools) -> Regularity:
        """Return the same with holes in which perhaps nothing is missing."""
        less = int(self.holes.low[is_unsure].sum())
        holes = replace(self.holes, low=np.where(is_unsure, 0, self.holes.low))
        return replace(self, low=max(self.low - less, 0), holes=holes) if less else self


def levels_around(values: Float64 | Int64, at: Int64) -> tuple[Float64, Float64]:
    """Return medians of `FEWEST` values before each index, and from it on."""
    offsets = np.arange(FEWEST)
    last = max(len(values) - 1, 0)
    before = row_medians(values[np.clip(at[:, None] - 1 - offsets, 0, last)])
    return before, row_medians(values[np.clip(at[:, None] + offsets, 0, last)])


def find_regularity(times_ns: Int64) -> Regularity | None:
    """Return the regularity of ascending times; None without a period."""
    patterns = [pattern for pattern in [_pattern(times_ns, 1)] if pattern is not None]
    if not patterns or patterns[0].share < MOST:
        patterns += [p for m in range(2, PATTERN + 1) if (p := _pattern(times_ns, m)) is not None]
    if not patterns:
        return None
    clearest = max(pattern.share for pattern in patterns)
    fewest = min(pattern.expected for pattern in patterns if pattern.share > clearest - REGULAR)
    near = [pattern for pattern in patterns if pattern.expected <= (1 + NEAR) * fewest + 1]
    most = max(pattern.share for pattern in near)
    best = next(pattern for pattern in near if pattern.share > most - FEW)
    if patterns[0].length == 1 < best.length and _is_single_with_stalls(steps_of(times_ns) / patterns[0].period_ns):
        best = patterns[0]
    period_ns, in_pattern = best.period_ns, best.length
    if in_pattern == 1:
        regularity = _by_phase(times_ns, best) or _single(times_ns, period_ns)
    else:
        intervals_ns = steps_of(times_ns)
        ordered_ns = np.sort(intervals_ns)
        rivals = [
            _several(times_ns, intervals_ns, ordered_ns, rival.period_ns, rival.length)
            for rival in near
            if rival is best or (rival.length > in_pattern and rival.share > most - NEAR)
        ]
        low, high = min(rival.low for rival in rivals), max(rival.high for rival in rivals)
        regularity = next(rival for rival in rivals if rival.in_pattern == in_pattern)
        if grid := find_grid(times_ns):  # of one publisher that loses some messages of each pattern
            high = max(high, int((grid[1] - 1).sum()))
        jitter_ns = spread(times_ns[in_pattern:] - times_ns[:-in_pattern])
        regularity = replace(regularity, low=low, high=high, jitter_ns=jitter_ns)
    pauses = len(regularity.holes) > 2 and regularity.missing > (1 + 1 / 2) * len(times_ns)
    return None if pauses else replace(regularity, share=best.share)


def joined(parts: Sequence[Regularity]) -> Regularity:
    """Return the regularity of a topic of several publishers; its holes are where all of them have one."""
    first = parts[0]
    rate = sum(part.rate_hz for part in parts)
    slowest = max(parts, key=lambda part: part.period_ns)
    common = np.ones(len(first.holes), np.bool_)
    for part in parts[1:]:
        common &= first.holes.meet(part.holes)
    return replace(
        slowest,
        in_pattern=max(round(rate * slowest.period_ns / SECOND_NS), 1),
        jitter_ns=median([part.jitter_ns for part in parts]),
        missing=sum(part.missing for part in parts),
        low=sum(part.low for part in parts),
        high=sum(part.high for part in parts),
        share=min(part.share for part in parts),
        holes=first.holes.at(common),
    )


class _Pattern(NamedTuple):
    length: int
    period_ns: float
    share: float
    expected: float


def _pattern(times_ns: Int64, m: int) -> _Pattern | None:
    if len(times_ns) < max(FEWEST, 2 * 2 * m):
        return None
    periods_ns = times_ns[m:] - times_ns[:-m]
    typical_ns = median(periods_ns)
    if typical_ns <= 0:
        return None
    regular = np.abs(periods_ns - typical_ns) < REGULAR * typical_ns / m
    share = np.count_nonzero(regular) / len(regular)
    if share < 1 / 2:
        return None
    period_ns = float(periods_ns[regular].mean())
    expected = m * float(times_ns[-1] - times_ns[0]) / period_ns + 1
    return _Pattern(m, period_ns, share, expected) if expected >= MOST * len(times_ns) else None


def _by_phase(times_ns: Int64, pattern: _Pattern) -> Regularity | None:
    """Return the regularity of times off a grid by a good part of a period each, by their sharpest phase (Rayleigh's test); None without."""
    ratio = steps_of(times_ns) / pattern.period_ns
    if pattern.share > 1 - NEAR or len(times_ns) < PHASES / FEWEST or _is_single_with_stalls(ratio):
        return None
    if ratio.max() > PHASES / 2 or ratio.sum() > 2 * 2 * len(ratio) or rate_changes(ratio):
        return None
    parts, missing = np.array_split(times_ns, -(-len(times_ns) // PHASES)), 0
    for number, part_ns in enumerate(parts):
        bins = np.bincount((part_ns - part_ns[0]) * FEWEST // round(pattern.period_ns))
        size = 1 << (2 * len(bins)).bit_length() + 1
        first, last = (round(size / FEWEST * factor) for factor in (1 - NEAR / 2, 1 + NEAR / 2))
        power = np.abs(np.fft.rfft(bins, size)[first:last]) ** 2 / len(part_ns)
        if power.max() < PATTERN:
            return None
        part_period_ns = round(pattern.period_ns) * size / FEWEST / (first + int(power.argmax()))
        end_ns = parts[number + 1][0] if number + 1 < len(parts) else part_ns[-1] + part_period_ns
        missing += round(float(end_ns - part_ns[0]) / part_period_ns) - len(part_ns)
    missing, unsure = max(missing, 0), 2 + round(2 * len(parts) ** (1 / 2))
    whole = _single(times_ns, float(times_ns[-1] - times_ns[0]) / (len(times_ns) - 1 + missing), has_phase=True)
    still = int((whole.holes.missing - whole.holes.low).sum())
    return replace(whole, missing=missing, low=max(missing - unsure - still, 0), high=missing + unsure)


def find_grid(stamps_ns: Int64) -> tuple[float, Int64, Float64] | None:
    """Return the period of ascending stamps that are multiples of one apart, their steps in periods, rounded and not; None for others."""
    steps_ns = steps_of(stamps_ns)
    positive_ns = steps_ns[steps_ns > 0]
    if len(stamps_ns) < FEWEST or len(positive_ns) < (1 - NEAR) * len(steps_ns):
        return None
    period_ns = median(positive_ns[positive_ns < (1 + 1 / 2) * quantile(positive_ns, 1 - MOST)])
    for _ in range(2 + 1):
        ratio = positive_ns / period_ns
        steps = np.rint(ratio)
        short = (steps >= 1) & (steps <= PATTERN)
        on_grid = short & (np.abs(ratio - steps) < NEAR)
        if on_grid.sum() < max(MOST * short.sum(), len(ratio) / 2):
            return None
        period_ns = float(positive_ns[on_grid].sum() / steps[on_grid].sum())
    exact = steps_ns / period_ns
    steps = np.rint(exact).astype(np.int64)
    return (period_ns, steps, exact) if _is_one_grid(exact, steps) else None


def _is_one_grid(ratio: Float64, steps: Int64) -> bool:
    """Return whether equal steps are multiples in the mean; of two publishers in turn they are not."""
    is_short = (steps > 0) & (steps <= PATTERN)
    lengths, off = steps[is_short], (ratio - steps)[is_short]
    counts = np.bincount(lengths, minlength=1)
    at_least_one = np.maximum(counts, 1)
    means = np.bincount(lengths, off) / at_least_one
    squares = np.bincount(lengths, np.abs(off - means[lengths]) ** 2) / at_least_one
    largest = FEW / FEWEST + 2 * 2 * np.sqrt(squares / at_least_one)
    return not bool((np.abs(means)[counts >= FEWEST] > largest[counts >= FEWEST]).any())


def usual_steps(steps: Int64) -> Int64 | None:
    """Return the step that is usual at each place, where a topic is thinned or the rate changes once or twice; None where 1 is.

    Two of three, three of five, or a throttle's messages: steps that come again after some, or are never off by more than one. Losses at
    random are soon.
    """
    gaps = int((steps > 1).sum())
    if gaps >= PATTERN:
        lengths, counts = np.unique(steps, return_counts=True)
        is_rare = lengths[counts.argmax()] > 1  # after losses at random the shortest step is the most common
        again = [np.count_nonzero(steps[m:] == steps[:-m]) / (len(steps) - m) for m in range(1, PATTERN)]
        is_again = again[0] < MOST <= max(again) and gaps * PATTERN > (1 - NEAR) * len(steps)
        length = -(-len(steps) * PATTERN // gaps)
        blocks = steps[: len(steps) // length * length].reshape(-1, length)
        ahead = np.cumsum(blocks - blocks.mean(axis=1, keepdims=True), axis=1)
        in_block = (blocks > 1).sum(axis=1)
        is_even = median(np.abs(in_block - PATTERN)) <= 2 and median(np.ptp(ahead, axis=1)) <= 2
        if is_rare or is_again or is_even:
            return np.full(len(steps), lengths[counts >= min(FEW * len(steps), counts.max())].max())
    changes = rate_changes(steps / max(median(steps), 1.0))
    parts = np.split(steps, changes)
    usual = np.repeat([round(median(part)) for part in parts], [len(part) for part in parts])
    return usual if changes and (len(changes) <= 2 or usual.max() > 2) else None


def _single(times_ns: Int64, period_ns: float, *, has_phase: bool = False) -> Regularity:
    """Count what one rate lacks; with stretches of another rate, what the rates lack, within the interval of both readings."""
    raw = steps_of(times_ns) / period_ns
    ratio, unsure = without_queues(raw)
    whole = _one_rate(times_ns, ratio, period_ns, has_phase=has_phase)
    whole = replace(whole, high=whole.high + unsure)
    edges = rate_changes(ratio)
    if not edges:
        return whole
    parts = []
    for start, stop in pairwise([0, *edges, len(ratio)]):
        own_ns = median(ratio[start:stop]) * period_ns
        parts.append(_one_rate(times_ns[start : stop + 1], ratio[start:stop] * period_ns / own_ns, own_ns))
    fastest = max(parts, key=lambda part: part.rate_hz)
    rival = whole
    if fastest.rate_hz >= (1 + NEAR) * whole.rate_hz:
        rival = _one_rate(times_ns, ratio * period_ns / fastest.period_ns, fastest.period_ns)
    return replace(
        fastest,
        missing=sum(part.missing for part in parts),
        low=min(sum(part.low for part in parts), rival.low),
        high=max(sum(part.high for part in parts) + unsure, rival.high),
        holes=Holes.of([part.holes for part in parts]),
    )


def without_queues(ratio: Float64) -> tuple[Float64, int]:
    """Return intervals as they were sent, and how many messages a last stall, with its queue cut off, may lack.

    After a stall its messages come at once: only what these do not make up for is missing.
    """
    sent, queues, unsure = ratio.copy(), 0, 0
    stalls = indices_of(ratio > 2 + 1 / 2)
    stalls = stalls[np.append(ratio, 0.0)[stalls + 1] < 1 - NEAR]
    for at in stalls.tolist():
        late, end = float(ratio[at]) - 1, at + 1
        while end < len(ratio) and ratio[end] < 1 - NEAR and late > (1 - ratio[end]) / 2:
            late -= 1 - float(ratio[end])
            end += 1
        if end == len(ratio) and queues:
            late, unsure = 0.0, round(late)
        if end - at > 2 or unsure:
            sent[at], sent[at + 1 : end] = 1 + late, 1
            queues += 1
    return sent, unsure


def _is_single_with_stalls(ratio: Float64) -> bool:
    sent, _ = without_queues(ratio)
    return bool((sent != ratio).any() and (np.abs(sent - 1) < REGULAR).mean() > MOST)


def rate_changes(ratio: Float64) -> list[int]:
    """Return where stretches of another rate begin and end: losses at random leave unequal intervals."""
    if len(ratio) <= PATTERN:
        return []
    blocks = row_medians(np.lib.stride_tricks.sliding_window_view(ratio, PATTERN)[::PATTERN])
    if not (np.abs(blocks - 1) > NEAR).any() and np.abs(median(ratio[-PATTERN:]) - 1) <= NEAR:
        return []
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(ratio, PATTERN, mode="reflect"), 2 * PATTERN + 1)
    typical = np.concatenate([row_medians(windows[at : at + PHASES]) for at in range(0, len(windows), PHASES)])
    is_other = np.abs(typical - 1) > NEAR
    changes = indices_of((steps_of(is_other.astype(np.int8)) != 0) | (np.abs(steps_of(typical)) > NEAR)) + 1
    edges = []
    for start, stop in pairwise([0, *changes.tolist(), len(ratio)]):
        part = ratio[start:stop]
        if is_other[start] and len(part) >= PATTERN:
            is_equal = np.abs(part - median(part)) < REGULAR * median(part)
            if is_equal.mean() >= 1 - NEAR:
                edges += [start, stop]
    return sorted({edge for edge in edges if 0 < edge < len(ratio)})


def _one_rate(times_ns: Int64, ratio: Float64, period_ns: float, *, has_phase: bool = False) -> Regularity:
    intervals_ns, ratios = steps_of(times_ns), ratio
    steps = _settled(ratios)
    is_regular = (steps == 1) & (np.abs(ratios - 1) < REGULAR)
    regular_ns = intervals_ns[is_regular]
    slow, fast = _extremes(ratios[is_regular])
    is_gap = steps >= 2
    long = ratios[is_gap]
    fewer = int((steps[is_gap] - np.minimum(steps[is_gap], np.rint(long / slow))).sum())
    more = int((np.maximum(steps[is_gap], np.rint(long / fast)) - steps[is_gap]).sum())
    unsure = round(2 * np.sqrt(int((np.abs(ratios - np.rint(ratios)) > REGULAR).sum())))
    missing = max(int(steps.sum()) - len(steps), 0)
    gaps = indices_of(is_gap)
    gaps = gaps[np.argsort(-ratios[gaps], kind="stable")]
    gaps = np.sort(gaps[: np.searchsorted(np.cumsum(steps[gaps] - 1), missing) + 1] if missing else gaps[:0])
    least = np.where(is_explained(ratios, steps, gaps, has_phase=has_phase), 0, steps[gaps] - 1)
    still = int((steps[gaps] - 1 - least).sum())
    return Regularity(
        period_ns,
        1,
        spread(regular_ns),
        missing,
        max(missing - max(fewer + unsure, still), 0),
        missing + more + unsure,
        holes=Holes.due(times_ns[gaps], intervals_ns[gaps], period_ns, steps[gaps] - 1, least),
    )


def is_explained(ratio: Float64, steps: Int64, at: Int64, *, has_phase: bool = False) -> Bools:
    """Return which long intervals have another explanation than a loss: the publisher stood still, a clock was set, or it has no timer.

    A timer goes on in its phase. What is sent when a computation or a loop ends has intervals of any length: only those are losses that are
    multiples of one, as long as its own wander is less than that.
    """
    wander = np.cumsum(ratio - steps)
    lag, jitter = min(len(ratio) // FEWEST, WINDOW), spread(ratio - steps)
    noise = spread(wander[lag:] - wander[: len(wander) - lag])
    if has_phase or (noise <= 2 * jitter and jitter < NEAR / 2):
        return _still_holes(wander, at, steps[at], noise)
    tail = ratio[(ratio > 1 + NEAR) & (ratio < 2 * 2)]
    is_multiple = np.abs(tail - np.rint(tail)) <= NEAR
    bound = np.maximum(FEW, 2 * jitter * np.sqrt(steps[at]))
    is_off: Bools = (np.abs(ratio - steps)[at] > bound) | (bound > NEAR)
    chance = float(np.prod(2 * bound[~is_off]))  # of intervals of any length
    is_off |= bool(2 * 2 * (~is_multiple).sum() > is_multiple.sum()) or chance > FEW / FEWEST
    is_off |= bool(2 * is_off.sum() > len(at))
    return is_off


def _still_holes(wander: Float64, at: Int64, steps: Int64, noise: float) -> Bools:
    """Return after which holes a timer goes on in another phase: it stood still, or a clock was set, and nothing was lost.

    One that lost its messages goes on in its phase, from the first on; one that was held up fires at once. `wander` is the phase of each
    message in periods. Where one silence is of that kind, all of them may be, and where most holes are, there is no timer.
    """
    if not len(at):
        return np.zeros(0, np.bool_)
    before, after = levels_around(wander, at)
    bound = np.maximum(FEW, 2 * noise * (1 + steps / (len(wander) * WINDOW) ** (1 / 2)))
    is_fine, is_silence = bound < NEAR, steps > FEWEST
    has_moved = is_fine & (np.abs(after - before) > bound)
    is_still: Bools = has_moved | is_fine & (np.abs(wander[at] - before) > 2 * bound)
    if (has_moved & is_silence).any() or 2 * (is_still & is_silence).sum() > is_silence.sum():
        is_still |= is_silence
    is_still |= bool(2 * is_still.sum() > len(at))
    return is_still


def _extremes(regular: Float64) -> tuple[float, float]:
    if len(regular) < 2 * WINDOW:
        return 1.0, 1.0
    means = regular[: len(regular) // WINDOW * WINDOW].reshape(-1, WINDOW).mean(axis=1)
    return quantile(means, MOST), quantile(means, 1 - MOST)


def _settled(ratio: Float64) -> Int64:
    """Return intervals in periods; corrected after late messages: what follows is in phase again."""
    steps = np.rint(ratio).astype(np.int64)
    doubtful = indices_of((np.abs(ratio - steps) > NEAR) & (ratio < PATTERN))
    before, after = levels_around(np.cumsum(ratio - steps), doubtful)
    shift = after - before
    wrong = np.abs(shift) > 1 - REGULAR
    doubtful, shift = doubtful[wrong], shift[wrong]
    if len(doubtful):  # neighbours see the same shift: the largest of them has it
        group = np.cumsum(np.diff(doubtful, prepend=doubtful[0]) > FEWEST)
        order = np.lexsort((-np.abs(shift), group))
        largest = order[np.unique(group[order], return_index=True)[1]]
        at = doubtful[largest]
        steps[at] = np.maximum(steps[at] + np.rint(shift[largest]).astype(np.int64), 0)
    for late, soon in ((steps[:-1], steps[1:]), (steps[1:], steps[:-1])):  # one late message is not a missing one
        pairs = indices_of((late > 1) & (soon == 0))
        late[pairs] -= 1
        soon[pairs] += 1
    return steps


def _several(times_ns: Int64, intervals_ns: Int64, ordered_ns: Int64, period_ns: float, in_pattern: int) -> Regularity:
    """Count what a pattern lacks; without its jitter."""
    usual_ns = middle(ordered_ns[-max(len(ordered_ns) // in_pattern, 1) :])
    periods_ns = times_ns[in_pattern:] - times_ns[:-in_pattern]
    # One of several publishers may begin later or end earlier.
    is_regular = np.abs(periods_ns - period_ns) < REGULAR * period_ns / in_pattern
    regular = indices_of(is_regular)
    inner_ns = times_ns[regular[0] : regular[-1] + in_pattern + 1]
    missing = most = _lacking(inner_ns, period_ns, in_pattern, usual_ns)
    if len(inner_ns) < len(times_ns):
        most = _lacking(times_ns, period_ns, in_pattern, usual_ns)
    gaps = indices_of(intervals_ns > usual_ns + (1 - NEAR) * period_ns)
    lost = np.rint((intervals_ns[gaps] - usual_ns) / period_ns).astype(np.int64) * in_pattern
    unsure = in_pattern + round(missing ** (1 / 2))
    seen = int(lost.sum())
    if seen < missing > unsure:
        slow, fast = _extremes(periods_ns[is_regular] / period_ns)
        seen = missing if slow - fast < FEW else seen  # a pattern that drifts is of no clock
    return Regularity(
        period_ns,
        in_pattern,
        0.0,
        missing,
        max(min(missing, seen) - unsure, 0),
        max(most, missing) + unsure,
        holes=Holes.due(times_ns[gaps], intervals_ns[gaps], usual_ns, lost, lost),
    )


def _lacking(times_ns: Int64, period_ns: float, in_pattern: int, usual_ns: float) -> int:
    if usual_ns > period_ns / 2:  # batches with a pause between them
        starts = times_ns[np.append(0, indices_of(steps_of(times_ns) > usual_ns / 2) + 1)]
        return max(in_pattern * int(np.rint(steps_of(starts) / period_ns).sum() + 1) - len(times_ns), 0)
    since = (times_ns - times_ns[0]) / period_ns
    # Wraps around: the last index is the first.
    last = int(indices_of(np.abs(since - np.rint(since)) < NEAR / 2)[-1])
    return max(round(float(since[last])) * in_pattern - last, 0)
