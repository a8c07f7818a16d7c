"""Slews: stretches of time in which a clock was made to run fast or slow, however many steps a fit made of them.

Between two devices a slew shows in the steps of their fit (`fit.py`), whose drift ends at `lines.DRIFT_LIMIT_PPB`; on one
device where its CLOCK_MONOTONIC gains on its CLOCK_MONOTONIC_RAW, which nobody slews.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .windows import WINDOW_NS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    Int64 = NDArray[np.int64]

CRYSTAL_PPB = 100_000
"""Drift of a crystal at most, 100 ppm; a larger one is a clock that is slewed, or a fault."""

_STEPS = 3
"""Steps the same way in a chain that are a slew by themselves: nothing jumps again and again by chance."""

_BARELY = 3
"""Bounds of a step within which it may be what a slew leaves: a fit goes on until a message is just out of reach. A clock
that was set jumps by many times the bound of a fast link."""

_GAIN_NS = 100_000
"""Gain on CLOCK_MONOTONIC_RAW in ten seconds, beyond the steady rate, that is a slew: NTP moves its frequency by well under 1 ppm at
once (10 us)."""

_NEARLY = 0.95
"""Share of the fastest rate that is the same slew: its start and end are between two knots."""

_MOST_KNOTS = 1000
"""Knots that the rate is sought between, evenly chosen: all pairs are compared."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """A segment of a fit, as far as a slew shows in it; times on the ping's monotonic clock.

    Attributes:
        start_ns: first message.
        end_ns: last message.
        drift_ppb: rate at which the relay's clock gains.
        drift_bound_ppb: the drift is wrong by at most this.
        step_ns: jump that began it; 0 for the first of a fit.
        step_bound_ns: the jump is wrong by at most this.
    """

    start_ns: int
    end_ns: int
    drift_ppb: float
    drift_bound_ppb: float
    step_ns: int = 0
    step_bound_ns: int = 0

    @property
    def steps_barely(self) -> bool:
        """Whether the jump is barely more than its bound."""
        return abs(self.step_ns) < _BARELY * self.step_bound_ns

    def is_fast(self, way: int) -> bool:
        """Return whether the clock surely ran faster (`way` 1) or slower (-1) than crystals do."""
        return way * self.drift_ppb - self.drift_bound_ppb > CRYSTAL_PPB

    def may_be_fast(self, way: int) -> bool:
        """Return whether the clock perhaps ran faster or slower than crystals do."""
        return way * self.drift_ppb + self.drift_bound_ppb > CRYSTAL_PPB


@dataclass(frozen=True, slots=True)
class Slew:
    """A slew that the fit of two devices cut into steps.

    Attributes:
        first: position of the stretch that its first step began.
        after: position after the stretch that its last step began.
        start_ns: start of the time over which the rate is known best, ping's monotonic clock.
        end_ns: end of that time.
        rate_ppm: mean rate at which the relay's clock gained on the ping's in that time.
        bound_ppm: the rate is wrong by at most this.
    """

    first: int
    after: int
    start_ns: int
    end_ns: int
    rate_ppm: float
    bound_ppm: float


def find_slews(
    stretches: Sequence[Stretch], at_ns: Int64, offset_ns: Int64, bound_ns: Int64
) -> Iterator[Slew]:
    """Yield each chain of steps the same way that a slew left.

    A step continues a chain within a window of the previous step, or if it is barely more than its bound and the clock may have run
    fast since then. A chain is a slew with three steps, or if all its steps are barely more than their bounds and the clock surely ran
    fast next to one of them.

    Args:
        stretches: segments of a fit, in order.
        at_ns: instant of each knot of the fit's runs, ascending, int64.
        offset_ns: relay's clock minus ping's at the knot.
        bound_ns: the offset is wrong by at most this.
    """
    for first, after in _chains(stretches):
        way = 1 if stretches[first].step_ns > 0 else -1
        may_be_jumps = not all(stretch.steps_barely for stretch in stretches[first:after])
        is_fast = any(stretch.is_fast(way) for stretch in stretches[first - 1 : after])
        if after - first < _STEPS and (may_be_jumps or not is_fast):
            continue
        begin, end = stretches[first - 1].start_ns, stretches[after - 1].end_ns
        knots = np.flatnonzero((at_ns >= begin) & (at_ns <= end))
        knots = knots[:: -(-len(knots) // _MOST_KNOTS) or 1]
        if len(knots) > 1:
            yield _of_best_pair(first, after, way, at_ns[knots], offset_ns[knots], bound_ns[knots])


def _chains(stretches: Sequence[Stretch]) -> Iterator[tuple[int, int]]:
    """Yield first and after of each chain of steps that may be a slew's."""
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
    """Return a slew with the rate between two knots that prove nearly the fastest one, as far apart as there are."""
    one, other = np.triu_indices(len(at_ns), 1)
    lasted_ns = np.maximum(at_ns[other] - at_ns[one], 1).astype(np.float64)
    gain_ns = (offset_ns[other] - offset_ns[one]).astype(np.float64)
    unsure_ns = (bound_ns[other] + bound_ns[one]).astype(np.float64)
    # Not the fastest pair but the longest that is nearly as fast: a knot of a bent window may be wrong by more than its bound.
    enough = lasted_ns >= min(WINDOW_NS, lasted_ns.max())
    proven = np.where(enough, (way * gain_ns - unsure_ns) / lasted_ns, -np.inf)
    best = int(np.argmax(np.where(proven >= _NEARLY * proven.max(), lasted_ns, 0)))
    return Slew(
        first=first,
        after=after,
        start_ns=int(at_ns[one[best]]),
        end_ns=int(at_ns[other[best]]),
        rate_ppm=float(gain_ns[best] / lasted_ns[best] * 1e6),
        bound_ppm=float(unsure_ns[best] / lasted_ns[best] * 1e6),
    )


def slewed_ppm(monotonic_ns: Int64, raw_ns: Int64) -> float:
    """Return the fastest slew of a device's monotonic clock in parts per million, 0 if it ran steadily.

    Args:
        monotonic_ns: CLOCK_MONOTONIC of each host sample, ascending, int64.
        raw_ns: CLOCK_MONOTONIC_RAW at the same instants.
    """
    if len(monotonic_ns) < _STEPS:
        return 0.0
    elapsed_ns, gain_ns = (
        monotonic_ns - monotonic_ns[0],
        (monotonic_ns - monotonic_ns[0]) - (raw_ns - raw_ns[0]),
    )
    steady = float(np.median(np.diff(gain_ns) / np.maximum(np.diff(elapsed_ns), 1)))
    if abs(steady) * 1e9 > CRYSTAL_PPB:  # slewed throughout
        return float(gain_ns[-1] / elapsed_ns[-1]) * 1e6
    after = np.minimum(np.searchsorted(elapsed_ns, elapsed_ns + WINDOW_NS), len(elapsed_ns) - 1)
    lasted_ns = np.maximum(elapsed_ns[after] - elapsed_ns, 1)
    beyond_ns = gain_ns[after] - gain_ns - steady * lasted_ns
    # A gap between samples must not collect what a steady frequency adds.
    is_window = (lasted_ns <= 2 * WINDOW_NS) & (np.abs(beyond_ns) >= _GAIN_NS)
    if not is_window.any():
        return 0.0
    fastest = int(np.argmax(np.where(is_window, np.abs(beyond_ns) / lasted_ns, 0)))
    return float(gain_ns[after[fastest]] - gain_ns[fastest]) / float(lasted_ns[fastest]) * 1e6
