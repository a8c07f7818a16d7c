"""One device's clock seen from another's: offset and drift over time from T1..T4, each with its bound.

Let `theta` be the relay's clock minus the ping's clock at one instant. No message is received before it is sent, so its
way out and its way back bound theta:

    T4 - T2  <=  theta  <=  T3 - T1

The interval is `rtt - intermediate` wide whatever the network does, so its middle is wrong by at most half
of that (RFC 5905, section 8: offset and delay). Where in the interval theta lies cannot be seen from stamps:
a link that is slower one way than the other looks like a clock that is off by half the difference.

Two assumptions give a slow message the interval of its fast neighbours:
- clocks part by at most `DRIFT_LIMIT_PPB`. A message whose interval cannot be reached from the earlier ones at
  that rate shows a step (clock set, suspend, reboot) and splits the fit;
- within a window of `WINDOW_NS` theta is a straight line. All lines that respect every message of the window
  are kept, and the bound is what they leave open (L. Zhang, Z. Liu, C. Xia, "Clock synchronization algorithms
  for network measurements", INFOCOM 2002; S. Moon, P. Skelly, D. Towsley, INFOCOM 1999; Huygens, NSDI 2018,
  keeps the fastest messages for the same reason as NTP's clock filter, RFC 5905, section 10). A window
  whose messages no line respects, or one half of which puts the offset outside of the window's bound, is halved until
  that is over. A clock that bends by 100 ppm in a window leaves lines that are wrong for 24 % of the messages, and with
  this rule for 3 % (40 simulated fits, 20 Hz, 0.1 ms and exponential 0.2 ms each way); of 840 windows of straight clocks,
  whose fastest messages took 10 us or longer each way, one was halved.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .lines import DRIFT, Lines, OffsetIntervals, find_stretches, find_windows

if TYPE_CHECKING:
    from collections.abc import Sequence

Int64 = NDArray[np.int64]
Float64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ClockKnot:
    """The offset at the instant of a window at which its bound is smallest.

    Attributes:
        at_ns: the instant, ping's monotonic clock.
        offset_ns: relay's clock minus ping's clock.
        bound_ns: the offset is wrong by at most this.
    """

    at_ns: int
    offset_ns: int
    bound_ns: int


@dataclass(frozen=True, slots=True)
class ClockSegment:
    """A stretch of time in which neither clock was stepped.

    Attributes:
        start_ns: first message, ping's monotonic clock.
        end_ns: last message.
        messages: number of messages in the fit.
        at_ns: the instant of `offset_ns`, at which its bound is smallest, ping's monotonic clock.
        offset_ns: relay's clock minus ping's clock.
        bound_ns: the offset is wrong by at most this.
        drift_ppb: mean rate at which the relay's clock gains on the ping's, parts per billion (ns per s).
        drift_bound_ppb: the drift is wrong by at most this.
        residual_ns: largest distance of a knot from the straight line through the first and the last knot.
        knots: one for each window, in order of time.
    """

    start_ns: int
    end_ns: int
    messages: int
    at_ns: int
    offset_ns: int
    bound_ns: int
    drift_ppb: float
    drift_bound_ppb: float
    residual_ns: int
    knots: tuple[ClockKnot, ...]


@dataclass(frozen=True, slots=True)
class ClockStep:
    """A jump of one clock against the other: a clock that was set, a suspend, a reboot.

    Attributes:
        after_ns: last message that is surely older than the step, ping's monotonic clock.
        before_ns: first message that is surely younger than the step.
        size_ns: jump of the relay's clock against the ping's; negative if it fell back.
        bound_ns: the size is wrong by at most this.
    """

    after_ns: int
    before_ns: int
    size_ns: int
    bound_ns: int


@dataclass(frozen=True, slots=True)
class ClockFit:
    """The relay's clock against the ping's, for one pair of devices.

    Attributes:
        ping_device: name of the device of T1 and T2.
        relay_device: name of the device of T3 and T4.
        boot: number of the boot of the ping's device (`boots.ping_boots`).
        same_clock: whether both sides are of one boot of one machine (where no boot id tells: have one name), and an
            offset of zero agrees with every message. The segments are then a check of the method, and one-way times
            are exact.
        segments: stretches between steps, in order of time; empty without a message that has all four stamps.
        steps: jumps between the segments, one fewer than these.
        relay_boot: the kernel's text for the boot of the relay's device; None where no session tells.
    """

    ping_device: str
    relay_device: str
    boot: int
    same_clock: bool
    segments: tuple[ClockSegment, ...]
    steps: tuple[ClockStep, ...]
    relay_boot: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ClockOffsets:
    """Offset of the relay's clock at each message, in the order of the input.

    Attributes:
        offset_ns: int64, relay's clock minus ping's clock halfway between T1 and T2.
        bound_ns: int64, largest error of the offset.
    """

    offset_ns: Int64
    bound_ns: Int64


@dataclass(frozen=True, slots=True)
class _Best:
    """The instant of a window at which its lines are closest together.

    Attributes:
        time: the instant.
        offset: middle of the lines at that instant.
        bound: half of their distance at that instant.
        slope: smallest and largest slope of the lines.
        first: middle and half distance at the first message.
        last: middle and half distance at the last message.
    """

    time: float
    offset: float
    bound: float
    slope: tuple[float, float]
    first: tuple[float, float]
    last: tuple[float, float]

    @classmethod
    def of(cls, window: OffsetIntervals, lines: Lines) -> _Best:
        time = np.linspace(window.time[0], window.time[-1], 17)
        low, high = lines.range_at(time)
        middle, half = (low + high) / 2, (high - low) / 2
        best = int(half.argmin())
        return cls(
            time=float(time[best]),
            offset=float(middle[best]),
            bound=float(half[best]),
            slope=(float(lines.slope.min()), float(lines.slope.max())),
            first=(float(middle[0]), float(half[0])),
            last=(float(middle[-1]), float(half[-1])),
        )


def fit_clock(
    publish_ns: Int64,
    relay_in_ns: Int64,
    relay_out_ns: Int64,
    receive_ns: Int64,
    *,
    ping_device: str = "ping",
    relay_device: str = "relay",
    boot: int = 0,
    relay_boot: str | None = None,
    same_boot: bool | None = None,
) -> tuple[ClockFit, ClockOffsets]:
    """Fit the relay's clock against the ping's, and return the fit with the offset at each message.

    Args:
        publish_ns: T1 of each message, int64.
        relay_in_ns: T3.
        relay_out_ns: T4.
        receive_ns: T2. All arrays have one length and any order.
        ping_device: name of the device of T1 and T2.
        relay_device: name of the device of T3 and T4.
        boot: number of the boot of the ping's device (`boots.ping_boots`).
        relay_boot: the kernel's text for the boot of the relay's device, if known.
        same_boot: whether both sides are of one boot of one machine (`boots.share_boot`); None lets names decide.

    Raises:
        ValueError: a message has `rtt < intermediate`.
    """
    if not len(publish_ns):
        nothing = np.empty(0, np.int64)
        no_fit = ClockFit(ping_device, relay_device, boot, False, (), (), relay_boot)
        return no_fit, ClockOffsets(nothing, nothing)
    out_ns, back_ns = relay_in_ns - publish_ns, relay_out_ns - receive_ns  # theta's upper and lower end
    if np.any(back_ns > out_ns):
        raise ValueError("a message spent more time in the relay than under way: leave it out of the fit")
    one_machine = ping_device == relay_device if same_boot is None else same_boot
    # Two devices may have one name, and a time namespace another clock on one machine: zero has to agree, too.
    same_clock = one_machine and bool(np.all(out_ns >= 0) and np.all(back_ns <= 0))

    rtt_ns = receive_ns - publish_ns
    half_way_ns = publish_ns + rtt_ns // 2
    order = np.argsort(half_way_ns, kind="stable")
    time_origin_ns, offset_origin_ns = int(half_way_ns[order[0]]), int(out_ns[order[0]])
    # T1 and T2 stand for the instant halfway between them: the clocks part a little on the way there.
    slack = (DRIFT / 2 * rtt_ns)[order]
    points = OffsetIntervals(
        (half_way_ns - time_origin_ns)[order].astype(np.float64),
        (back_ns - offset_origin_ns)[order] - slack,
        (out_ns - offset_origin_ns)[order] + slack,
    )
    low, high = points.lower.copy(), points.upper.copy()
    segments: list[ClockSegment] = []
    steps: list[ClockStep] = []
    before, edge = 0, (0.0, 0.0)
    for start, stop in find_stretches(points):
        stretch = points.part(start, stop)
        best: list[_Best] = []
        for begin, end, lines in find_windows(stretch, 0, len(stretch)):
            window = stretch.part(begin, end)
            lowest, highest = lines.range_at(window.time)
            low[start + begin : start + end] = np.maximum(lowest, window.lower)
            high[start + begin : start + end] = np.minimum(highest, window.upper)
            best.append(_Best.of(window, lines))
        if not best:  # no line at all: each of its messages keeps its own bound
            continue
        if segments:
            steps.append(_step(points.time[[before - 1, start]], edge, best[0].first, time_origin_ns))
        segments.append(_segment(stretch, best, time_origin_ns, offset_origin_ns))
        before, edge = stop, best[-1].last
    # Only the tightest messages shaped the lines; a message that no line reaches keeps its own bound.
    alone = low > high
    low[alone], high[alone] = points.lower[alone], points.upper[alone]

    fit = ClockFit(ping_device, relay_device, boot, same_clock, tuple(segments), tuple(steps), relay_boot)
    if same_clock:
        zero = np.zeros(len(publish_ns), np.int64)
        return fit, ClockOffsets(zero, zero)
    offset_ns, bound_ns = np.empty(len(order), np.int64), np.empty(len(order), np.int64)
    offset_ns[order] = np.rint((low + high) / 2).astype(np.int64) + offset_origin_ns
    bound_ns[order] = np.ceil((high - low) / 2 + 0.5).astype(np.int64)  # half a nanosecond for the rounding
    return fit, ClockOffsets(offset_ns, bound_ns)


def _segment(
    points: OffsetIntervals,
    windows: Sequence[_Best],
    time_origin_ns: int,
    offset_origin_ns: int,
) -> ClockSegment:
    """Return a segment from the best instants of its windows, with the origins added again."""
    time = np.array([w.time for w in windows])
    offset = np.array([w.offset for w in windows])
    if len(windows) > 1:
        drift = (offset[-1] - offset[0]) / (time[-1] - time[0])
        drift_bound = (windows[-1].bound + windows[0].bound) / (time[-1] - time[0])
    else:
        gentle, steep = windows[0].slope
        drift, drift_bound = (steep + gentle) / 2, (steep - gentle) / 2
    knots = tuple(
        ClockKnot(
            time_origin_ns + round(w.time),
            offset_origin_ns + round(w.offset),
            int(np.ceil(w.bound + 0.5)),
        )
        for w in windows
    )
    best = min(knots, key=lambda knot: knot.bound_ns)
    return ClockSegment(
        start_ns=time_origin_ns + int(points.time[0]),
        end_ns=time_origin_ns + int(points.time[-1]),
        messages=len(points),
        at_ns=best.at_ns,
        offset_ns=best.offset_ns,
        bound_ns=best.bound_ns,
        drift_ppb=float(drift * 1e9),
        drift_bound_ppb=float(drift_bound * 1e9),
        residual_ns=round(float(np.abs(offset - offset[0] - drift * (time - time[0])).max())),
        knots=knots,
    )


def _step(
    time: Float64,
    old: tuple[float, float],
    new: tuple[float, float],
    time_origin_ns: int,
) -> ClockStep:
    """Return the jump between two instants from offset and bound at each."""
    drifted = DRIFT * (time[1] - time[0])
    return ClockStep(
        after_ns=time_origin_ns + int(time[0]),
        before_ns=time_origin_ns + int(time[1]),
        size_ns=round(new[0] - old[0]),
        bound_ns=int(np.ceil(old[1] + new[1] + drifted + 0.5)),
    )
