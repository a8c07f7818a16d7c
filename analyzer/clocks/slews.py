"""Slews: stretches of time in which a clock was made to run fast or slow.

Between two devices a slew shows in the steps of their fit, whose drift ends at `DRIFT_LIMIT_PPB`, or below that in knots
with different rates; on one device where CLOCK_MONOTONIC gains on CLOCK_MONOTONIC_RAW, which nobody slews.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .lines import Int64
from .windows import WINDOW_NS

CRYSTAL_PPB = 100_000
"""Largest drift of a crystal, 100 ppm; a larger one is a slew or a fault."""

BEND_PPB = 50_000
"""Difference of two rates of one clock pair that only a slew makes: crystals keep theirs within a few ppm."""

_STEPS = 3
"""Steps the same way in a chain that prove a slew."""

_BARELY = 3
"""A step below so many of its bounds may be a slew's; setting a clock jumps by many bounds."""

_GAIN_NS = 100_000
"""Gain on CLOCK_MONOTONIC_RAW in ten seconds, beyond the steady rate, that is a slew: NTP's is below 10 us."""

_NEARLY = 0.95
"""Share of the fastest rate that is the same slew: its start and end are between two knots."""

_MOST_KNOTS = 1000
"""Evenly chosen knots; all their pairs are compared."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """A segment of a fit, times on the ping's monotonic clock; `step_ns` is the jump that began it, 0 for the first."""

    start_ns: int
    end_ns: int
    drift_ppb: float
    drift_bound_ppb: float
    step_ns: int = 0
    step_bound_ns: int = 0

    @property
    def steps_barely(self) -> bool:
        return abs(self.step_ns) < _BARELY * self.step_bound_ns

    def is_fast(self, way: int) -> bool:
        """Return whether the clock surely ran faster (`way` 1) or slower (-1) than a crystal."""
        return way * self.drift_ppb - self.drift_bound_ppb > CRYSTAL_PPB

    def may_be_fast(self, way: int) -> bool:
        return way * self.drift_ppb + self.drift_bound_ppb > CRYSTAL_PPB


@dataclass(frozen=True, slots=True)
class Slew:
    """A slew that a fit cut into the stretches from `first` to before `after`, or that bent the one before these."""

    first: int
    after: int
    start_ns: int
    end_ns: int
    rate_ppm: float
    bound_ppm: float


def find_slews(stretches: Sequence[Stretch], at_ns: Int64, offset_ns: Int64, bound_ns: Int64) -> Iterator[Slew]:
    """Yield each chain of steps the same way that a slew left, then each bent stretch that is in no chain.

    A step continues a chain within a window of the previous step, or if it is barely more than its bound and the clock may have
    run fast since. A chain is a slew with three steps, or if all are barely more than their bounds and the clock surely ran
    fast next to one. The arrays are of the knots, by time, as in `ClockKnot`.
    """
    slewed: set[int] = set()
    for first, after in _chains(stretches):
        way = 1 if stretches[first].step_ns > 0 else -1
        may_be_jumps = not all(stretch.steps_barely for stretch in stretches[first:after])
        is_fast = any(stretch.is_fast(way) for stretch in stretches[first - 1 : after])
        if after - first < _STEPS and (may_be_jumps or not is_fast):
            continue
        begin, end = stretches[first - 1].start_ns, stretches[after - 1].end_ns
        slewed.update(range(first - 1, after))
        knots = _few((at_ns >= begin) & (at_ns <= end))
        if len(knots) > 1:
            yield _of_best_pair(first, after, way, at_ns[knots], offset_ns[knots], bound_ns[knots])
    for position, stretch in enumerate(stretches):
        is_own = (at_ns >= stretch.start_ns) & (at_ns <= stretch.end_ns)
        if position not in slewed and is_bent(at_ns[is_own], offset_ns[is_own], bound_ns[is_own]):
            knots = _few(is_own)
            at_knots = at_ns[knots], offset_ns[knots], bound_ns[knots]
            pairs = [_of_best_pair(position + 1, position + 1, way, *at_knots) for way in (1, -1)]
            yield max(pairs, key=lambda slew: abs(slew.rate_ppm) - slew.bound_ppm)


def is_bent(at_ns: Int64, offset_ns: Int64, bound_ns: Int64) -> bool:
    """Return whether knots, ascending, prove two rates that differ by more than `BEND_PPB`: the clock was slewed."""
    slowest, fastest, lag = np.inf, -np.inf, 1
    while lag < len(at_ns):
        lasted_ns = np.maximum(at_ns[lag:] - at_ns[:-lag], 1)
        gain_ns, unsure_ns = offset_ns[lag:] - offset_ns[:-lag], bound_ns[lag:] + bound_ns[:-lag]
        slowest = min(slowest, float(((gain_ns + unsure_ns) / lasted_ns).min()))
        fastest = max(fastest, float(((gain_ns - unsure_ns) / lasted_ns).max()))
        lag *= 2
    return (fastest - slowest) * 1e9 > BEND_PPB


def _few(is_chosen: NDArray[np.bool_]) -> NDArray[np.intp]:
    knots = np.flatnonzero(is_chosen)
    return knots[:: -(-len(knots) // _MOST_KNOTS) or 1]


def _chains(stretches: Sequence[Stretch]) -> Iterator[tuple[int, int]]:
    first = 0
    for position, stretch in enumerate(stretches):
        if not stretch.step_ns:
            continue
        before = stretches[position - 1]
        is_near = stretch.start_ns - before.start_ns <= WINDOW_NS
        way = 1 if stretch.step_ns > 0 else -1
        goes_on = before.step_ns * way > 0 and (is_near or (stretch.steps_barely and before.may_be_fast(way)))
        if not goes_on:
            if first:
                yield first, position
            first = position
    if first:
        yield first, len(stretches)


def _of_best_pair(first: int, after: int, way: int, at_ns: Int64, offset_ns: Int64, bound_ns: Int64) -> Slew:
    first_knot, other = np.triu_indices(len(at_ns), 1)
    lasted_ns = np.maximum(at_ns[other] - at_ns[first_knot], 1).astype(np.float64)
    gain_ns = (offset_ns[other] - offset_ns[first_knot]).astype(np.float64)
    unsure_ns = (bound_ns[other] + bound_ns[first_knot]).astype(np.float64)
    # Not the fastest pair: a knot of a bent window may be wrong by more than its bound.
    enough = lasted_ns >= min(WINDOW_NS, lasted_ns.max())
    proven = np.where(enough, (way * gain_ns - unsure_ns) / lasted_ns, -np.inf)
    best = int(np.argmax(np.where(proven >= _NEARLY * proven.max(), lasted_ns, 0)))
    return Slew(
        first=first,
        after=after,
        start_ns=int(at_ns[first_knot[best]]),
        end_ns=int(at_ns[other[best]]),
        rate_ppm=float(gain_ns[best] / lasted_ns[best] * 1e6),
        bound_ppm=float(unsure_ns[best] / lasted_ns[best] * 1e6),
    )


def slewed_ppm(monotonic_ns: Int64, raw_ns: Int64) -> float:
    """Return the fastest slew of a monotonic clock, by host samples in time order, in parts per million; 0 if steady."""
    if len(monotonic_ns) < _STEPS:
        return 0.0
    elapsed_ns, gain_ns = (monotonic_ns - monotonic_ns[0], (monotonic_ns - monotonic_ns[0]) - (raw_ns - raw_ns[0]))
    steady = float(np.median(np.diff(gain_ns) / np.maximum(np.diff(elapsed_ns), 1)))
    if abs(steady) * 1e9 > CRYSTAL_PPB:  # slewed throughout
        return float(gain_ns[-1] / elapsed_ns[-1]) * 1e6
    after = np.minimum(np.searchsorted(elapsed_ns, elapsed_ns + WINDOW_NS), len(elapsed_ns) - 1)
    lasted_ns = np.maximum(elapsed_ns[after] - elapsed_ns, 1)
    beyond_ns = gain_ns[after] - gain_ns - steady * lasted_ns
    # A gap between samples must not collect the steady gain.
    is_window = (lasted_ns <= 2 * WINDOW_NS) & (np.abs(beyond_ns) >= _GAIN_NS)
    if not is_window.any():
        return 0.0
    fastest = int(np.argmax(np.where(is_window, np.abs(beyond_ns) / lasted_ns, 0)))
    return float(gain_ns[after[fastest]] - gain_ns[fastest]) / float(lasted_ns[fastest]) * 1e6
