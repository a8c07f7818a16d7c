"""One device's clock seen from another's: offset and drift over time from T1..T4, each with its bound.

With `theta` the relay's clock minus the ping's clock at one instant, a message that was not received before
it was sent says, on its way out and on its way back,

    T4 - T2  <=  theta  <=  T3 - T1

The interval is `rtt - intermediate` wide whatever the network does, so its middle is wrong by at most half
of that (RFC 5905, section 8: offset and delay). Where in the interval theta lies cannot be seen from stamps:
a link that is slower one way than the other looks like a clock that is off by half the difference.

Two assumptions make the interval of a slow message as good as its fast neighbours':
- clocks part by at most `DRIFT_LIMIT_PPB`. A message whose interval cannot be reached from the earlier ones at
  that rate shows a step (clock set, suspend, reboot) and splits the fit;
- within a window of `WINDOW_NS` theta is a straight line. All lines that respect every message of the window
  are kept, and the bound is what they leave open (L. Zhang, Z. Liu, C. Xia, "Clock synchronization algorithms
  for network measurements", INFOCOM 2002; S. Moon, P. Skelly, D. Towsley, INFOCOM 1999; Huygens, NSDI 2018,
  keeps the fastest messages for the same reason as NTP's clock filter, RFC 5905, section 10). A window
  whose messages no line respects is halved until one does.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from tracefile import Run, Session

Int64 = NDArray[np.int64]
Float64 = NDArray[np.float64]

DRIFT_LIMIT_PPB = 500_000
"""Linux slews a clock by at most 500 ppm (adjtimex(2)); quartz is off by less than 100 ppm."""

WINDOW_NS = 10_000_000_000
"""Ten seconds: crystals wander by well under 0.1 ppm in that time, and 10 Hz gives 100 messages to choose from."""

CANDIDATES = 32
"""Messages of a window that are kept per direction. Fewer constraints can only widen the bound."""

_DRIFT = DRIFT_LIMIT_PPB / 1e9
_BLOCK = 4096
_ROUNDING_NS = 1e-3
"""Float slack when lines are checked against points; far below the nanosecond that is reported."""


@dataclass(frozen=True, slots=True)
class ClockKnot:
    """The clock at the instant of a window where it is known best.

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
        messages: messages that the fit used.
        at_ns: the instant of `offset_ns`, where it is known best.
        offset_ns: relay's clock minus ping's clock.
        bound_ns: the offset is wrong by at most this.
        drift_ppb: mean rate at which the relay's clock gains on the ping's, parts per billion (ns per s).
        drift_bound_ppb: the drift is wrong by at most this.
        residual_ns: farthest that a knot lies from the straight line through the first and the last knot.
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
        after_ns: last message that is surely from before the step, ping's monotonic clock.
        before_ns: first message that is surely from after it.
        size_ns: how far the relay's clock jumped against the ping's (negative: it fell back).
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
        same_clock: the devices have one name and an offset of zero agrees with every message: one machine,
            one clock. The segments are then a check of the method, and one-way times are exact.
        segments: between steps, in order of time; empty without a message that has all four stamps.
        steps: between the segments, so one fewer.
    """

    ping_device: str
    relay_device: str
    boot: int
    same_clock: bool
    segments: tuple[ClockSegment, ...]
    steps: tuple[ClockStep, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ClockOffsets:
    """Offset of the relay's clock at each message, in the order of the input.

    Attributes:
        offset_ns: int64, relay's clock minus ping's clock halfway between T1 and T2.
        bound_ns: int64, the offset is wrong by at most this.
    """

    offset_ns: Int64
    bound_ns: Int64


@dataclass(frozen=True, slots=True, eq=False)
class _Intervals:
    """What each message says alone: theta in [lower, upper] at time t; origins subtracted, so floats are exact."""

    time: Float64
    lower: Float64
    upper: Float64

    def part(self, start: int, stop: int) -> _Intervals:
        return _Intervals(self.time[start:stop], self.lower[start:stop], self.upper[start:stop])

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True, slots=True, eq=False)
class _Lines:
    """All lines that respect the messages of one window, by the corners of their set.

    A line is its slope and its height at `centre`. For corner i the heights from `low[i]` to `high[i]` are possible.
    """

    centre: float
    slope: Float64
    low: Float64
    high: Float64

    @classmethod
    def through(cls, points: _Intervals) -> _Lines | None:
        """The lines below every upper and above every lower end, no steeper than the drift limit; None if none is."""
        above, below = _tightest(points, points.upper), _tightest(points, -points.lower)
        centre = float(points.time[len(points) // 2])
        x, upper = points.time[above] - centre, points.upper[above]
        y, lower = points.time[below] - centre, points.lower[below]
        # The corners of the set lie where two constraints meet, so each has the slope through two of the points.
        time, height = np.concatenate([x, y]), np.concatenate([upper, lower])
        run = time[:, None] - time[None, :]
        rise = height[:, None] - height[None, :]
        gentle = np.abs(rise) < _DRIFT * run  # half of the pairs (run > 0), none with equal times
        slope = np.concatenate([rise[gentle] / run[gentle], [-_DRIFT, _DRIFT]])
        high = (upper - slope[:, None] * x).min(axis=1)
        low = (lower - slope[:, None] * y).max(axis=1)
        possible = high >= low - _ROUNDING_NS
        if not possible.any():
            return None
        return cls(centre, slope[possible], low[possible], high[possible])

    def range_at(self, time: Float64) -> tuple[Float64, Float64]:
        """Lowest and highest that any of the lines is at each time."""
        x = time - self.centre
        low = np.full(len(time), np.inf)
        high = np.full(len(time), -np.inf)
        for slope, bottom, top in zip(self.slope, self.low, self.high, strict=True):
            np.minimum(low, bottom + slope * x, out=low)
            np.maximum(high, top + slope * x, out=high)
        return low, high


@dataclass(frozen=True, slots=True)
class _Best:
    """Where the lines of a window are closest together, and what they say at its last and first message."""

    time: float
    offset: float
    bound: float
    slope: tuple[float, float]
    first: tuple[float, float]
    last: tuple[float, float]

    @classmethod
    def of(cls, window: _Intervals, lines: _Lines) -> _Best:
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


def _tightest(points: _Intervals, height: Float64) -> list[int]:
    """Index of the points that a line must pass below: the lower convex hull of the lowest of each part.

    The lowest point of each of `CANDIDATES` equal parts of the window is looked at; the hull is built from left
    to right (A. Andrew's monotone chain, 1979).
    """
    edges = np.linspace(0, len(points), min(CANDIDATES, len(points)) + 1).astype(np.intp).tolist()
    hull: list[int] = []
    for begin, end in pairwise(edges):
        new = begin + int(height[begin:end].argmin())
        while len(hull) > 1:
            first, last = hull[-2], hull[-1]
            rise_last = (height[last] - height[first]) * (points.time[new] - points.time[first])
            rise_new = (height[new] - height[first]) * (points.time[last] - points.time[first])
            if rise_last < rise_new:
                break
            hull.pop()
        hull.append(new)
    return hull


def fit_clock(
    publish_ns: Int64,
    relay_in_ns: Int64,
    relay_out_ns: Int64,
    receive_ns: Int64,
    *,
    ping_device: str = "ping",
    relay_device: str = "relay",
    boot: int = 0,
) -> tuple[ClockFit, ClockOffsets]:
    """The relay's clock against the ping's, and the offset at each message.

    Args:
        publish_ns: T1 of each message, int64.
        relay_in_ns: T3.
        relay_out_ns: T4.
        receive_ns: T2. All arrays of one length, in any order; every message with `rtt >= intermediate`.
        ping_device: name of the device of T1 and T2.
        relay_device: name of the device of T3 and T4.
        boot: which boot of the ping's device (`ping_boots`).
    """
    if not len(publish_ns):
        nothing = np.empty(0, np.int64)
        return ClockFit(ping_device, relay_device, boot, False, (), ()), ClockOffsets(nothing, nothing)
    out_ns, back_ns = relay_in_ns - publish_ns, relay_out_ns - receive_ns  # theta's upper and lower end
    if np.any(back_ns > out_ns):
        raise ValueError("a message spent more time in the relay than under way: leave it out of the fit")
    same_clock = ping_device == relay_device and bool(np.all(out_ns >= 0) and np.all(back_ns <= 0))

    rtt_ns = receive_ns - publish_ns
    half_way_ns = publish_ns + rtt_ns // 2
    order = np.argsort(half_way_ns, kind="stable")
    time_origin_ns, offset_origin_ns = int(half_way_ns[order[0]]), int(out_ns[order[0]])
    # T1 and T2 stand for the instant halfway between them: the clocks part a little on the way there.
    slack = (_DRIFT / 2 * rtt_ns)[order]
    points = _Intervals(
        (half_way_ns - time_origin_ns)[order].astype(np.float64),
        (back_ns - offset_origin_ns)[order] - slack,
        (out_ns - offset_origin_ns)[order] + slack,
    )
    low, high = points.lower.copy(), points.upper.copy()
    segments: list[ClockSegment] = []
    steps: list[ClockStep] = []
    before, edge = 0, (0.0, 0.0)
    for start, stop in _stretches(points):
        stretch = points.part(start, stop)
        best: list[_Best] = []
        for begin, end, lines in _windows(stretch, 0, len(stretch)):
            window = stretch.part(begin, end)
            lowest, highest = lines.range_at(window.time)
            low[start + begin : start + end] = np.maximum(lowest, window.lower)
            high[start + begin : start + end] = np.minimum(highest, window.upper)
            best.append(_Best.of(window, lines))
        if segments:
            steps.append(_step(points.time[[before - 1, start]], edge, best[0].first, time_origin_ns))
        segments.append(_segment(stretch, best, time_origin_ns, offset_origin_ns))
        before, edge = stop, best[-1].last
    # Only the tightest messages shaped the lines; a message that none of them reaches speaks for itself.
    alone = low > high
    low[alone], high[alone] = points.lower[alone], points.upper[alone]

    fit = ClockFit(ping_device, relay_device, boot, same_clock, tuple(segments), tuple(steps))
    if same_clock:
        zero = np.zeros(len(publish_ns), np.int64)
        return fit, ClockOffsets(zero, zero)
    offset_ns, bound_ns = np.empty(len(order), np.int64), np.empty(len(order), np.int64)
    offset_ns[order] = np.rint((low + high) / 2).astype(np.int64) + offset_origin_ns
    bound_ns[order] = np.ceil((high - low) / 2 + 0.5).astype(np.int64)  # half a nanosecond for the rounding
    return fit, ClockOffsets(offset_ns, bound_ns)


def _stretches(points: _Intervals) -> Iterator[tuple[int, int]]:
    """Start and stop of each stretch without a step.

    Messages around a step that agree with the clock before it and after it belong to no stretch.
    """
    start = 0
    while start < len(points):
        step = _first_out_of_reach(points, start)
        yield start, _last_surely_before(points, start, step)
        start = step


def _first_out_of_reach(points: _Intervals, start: int) -> int:
    """Index of the first message that no drift within the limit reaches from the ones since `start`."""
    lowest_top, highest_bottom = np.inf, -np.inf
    for begin in range(start, len(points), _BLOCK):
        part = points.part(begin, begin + _BLOCK)
        reach = _DRIFT * part.time
        top = np.minimum.accumulate(np.concatenate([[lowest_top], part.upper - reach]))
        bottom = np.maximum.accumulate(np.concatenate([[highest_bottom], part.lower + reach]))
        out = (part.lower > top[:-1] + reach) | (part.upper < bottom[:-1] - reach)
        if out.any():
            return begin + int(out.argmax())
        lowest_top, highest_bottom = top[-1], bottom[-1]
    return len(points)


def _last_surely_before(points: _Intervals, start: int, step: int) -> int:
    """Index after the last message before `step` that the clock of the messages after it cannot explain."""
    if step == len(points):
        return step
    after, before = points.part(step, step + 64), points.part(start, step)
    top = (after.upper + _DRIFT * after.time).min() - _DRIFT * before.time
    bottom = (after.lower - _DRIFT * after.time).max() + _DRIFT * before.time
    foreign = np.flatnonzero((before.lower > top) | (before.upper < bottom))
    return start + int(foreign[-1]) + 1 if len(foreign) else step


def _windows(points: _Intervals, start: int, stop: int) -> Iterator[tuple[int, int, _Lines]]:
    """Start, stop and lines of each window; at most `WINDOW_NS` long, and short enough that a line fits."""
    part = points.part(start, stop)
    duration = part.time[-1] - part.time[0]
    if duration > WINDOW_NS:
        edges = np.linspace(part.time[0], part.time[-1], int(np.ceil(duration / WINDOW_NS)) + 1)[1:-1]
        cuts = [start, *(start + np.searchsorted(part.time, edges)).tolist(), stop]
        for begin, end in pairwise(cuts):
            if end > begin:
                yield from _windows(points, begin, end)
        return
    lines = _Lines.through(part)
    if lines is not None:
        yield start, stop, lines
        return
    middle = (start + stop) // 2  # one message alone always has a line, so this ends
    yield from _windows(points, start, middle)
    yield from _windows(points, middle, stop)


def _segment(
    points: _Intervals,
    windows: Sequence[_Best],
    time_origin_ns: int,
    offset_origin_ns: int,
) -> ClockSegment:
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
    """The jump between two instants from offset and bound at each."""
    drifted = _DRIFT * (time[1] - time[0])
    return ClockStep(
        after_ns=time_origin_ns + int(time[0]),
        before_ns=time_origin_ns + int(time[1]),
        size_ns=round(new[0] - old[0]),
        bound_ns=int(np.ceil(old[1] + new[1] + drifted + 0.5)),
    )


def ping_boots(sessions: Sequence[Session], runs: Sequence[Run]) -> dict[int, int]:
    """Which boot of its device each run belongs to, by run_id: wall clock at monotonic zero, in whole seconds.

    A device's monotonic clock starts again at every boot, so stamps of two boots must not be mixed. Sessions
    whose zero differs by under two seconds are one boot; a run that does not name its session is in boot 0.
    """
    boot_of_session: dict[int, int] = {}
    known: dict[str, list[int]] = {}
    for session in sessions:
        zero_s = (session.wall_anchor_ns - session.monotonic_anchor_ns) // 1_000_000_000
        of_device = known.setdefault(session.device, [])
        boot_of_session[session.session_id] = next((b for b in of_device if abs(b - zero_s) < 2), zero_s)
        if boot_of_session[session.session_id] not in of_device:
            of_device.append(zero_s)
    return {run.run_id: boot_of_session.get(session_of_run(run), 0) for run in runs}


def session_of_run(run: Run) -> int:
    """The ping session that a run names (`session_id` in its description), or -1."""
    try:
        return int(str(run.extra["session_id"]), 16)
    except (KeyError, ValueError):
        return -1


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Round trips with their one-way times.

    Attributes:
        roundtrips: the input with the columns `outbound_ns` (T1 to T3), `return_ns` (T4 to T2) and
            `clock_bound_ns`, i64, null unless all four stamps are there. The two add up to `rtt_ns -
            intermediate_ns`; each may be wrong by `clock_bound_ns`, one up as the other goes down.
        fits: one for each pair of devices and boot.
    """

    roundtrips: pl.DataFrame
    fits: tuple[ClockFit, ...] = field(default=())


def align_clocks(roundtrips: pl.DataFrame, boots: Mapping[int, int] | None = None) -> Alignment:
    """One-way times of every message that has all four stamps, and the clock fits they rest on.

    Args:
        roundtrips: frame of `docs/trace-format.md`, any order.
        boots: boot of each run (`ping_boots`); without it every device is taken to have been up throughout.
    """
    stamps = ["publish_ns", "relay_in_ns", "relay_out_ns", "receive_ns"]
    complete = pl.all_horizontal(pl.col(stamps).is_not_null()) & (
        pl.col("receive_ns") - pl.col("publish_ns") >= pl.col("relay_out_ns") - pl.col("relay_in_ns")
    )
    keys = [pl.col("ping_device").fill_null(""), pl.col("relay_device").fill_null(""), _boot(boots or {})]
    groups = (
        roundtrips.select(*keys, complete.alias("complete"))
        .with_row_index("row")
        .filter(pl.col("complete"))
        .group_by("ping_device", "relay_device", "boot", maintain_order=True)
        .agg("row")
        .sort("ping_device", "relay_device", "boot")
    )
    t1, t3, t4, t2 = (roundtrips[name].fill_null(0).to_numpy() for name in stamps)
    one_way: dict[str, Any] = {
        name: np.zeros(len(roundtrips), np.int64) for name in ("outbound_ns", "return_ns", "clock_bound_ns")
    }
    known = np.zeros(len(roundtrips), np.bool_)
    fits: list[ClockFit] = []
    for ping_device, relay_device, boot, row_list in groups.iter_rows():
        rows = np.asarray(row_list, np.intp)
        fit, offsets = fit_clock(
            t1[rows],
            t3[rows],
            t4[rows],
            t2[rows],
            ping_device=ping_device,
            relay_device=relay_device,
            boot=boot,
        )
        fits.append(fit)
        under_way = (t2[rows] - t1[rows]) - (t4[rows] - t3[rows])
        outbound = np.clip(t3[rows] - t1[rows] - offsets.offset_ns, 0, under_way)
        one_way["outbound_ns"][rows] = outbound
        one_way["return_ns"][rows] = under_way - outbound
        one_way["clock_bound_ns"][rows] = offsets.bound_ns
        known[rows] = True
    columns = [
        pl.when(pl.Series(known)).then(pl.Series(name, values)).otherwise(None).alias(name)
        for name, values in one_way.items()
    ]
    return Alignment(roundtrips.with_columns(columns), tuple(fits))


def _boot(boots: Mapping[int, int]) -> pl.Expr:
    if not boots:
        return pl.lit(0, pl.Int64).alias("boot")
    run_ids = pl.Series(list(boots), dtype=pl.UInt64)
    return (
        pl.col("run_id")
        .replace_strict(run_ids, pl.Series(list(boots.values()), dtype=pl.Int64), default=0)
        .alias("boot")
    )


def clock_table(fits: Sequence[ClockFit]) -> pl.DataFrame:
    """One row per knot, for drawing offset and drift over time.

    Columns: `ping_device`, `relay_device` str, `boot` i64, `same_clock` bool, `segment` u32 (0, 1, ... within
    the pair), `at_ns` i64 (ping's monotonic clock), `offset_ns`, `bound_ns` i64, `drift_ppb`,
    `drift_bound_ppb` f64 (of the segment), `residual_ns` i64 (of the segment).
    """
    rows = [
        {
            "ping_device": fit.ping_device,
            "relay_device": fit.relay_device,
            "boot": fit.boot,
            "same_clock": fit.same_clock,
            "segment": number,
            "at_ns": knot.at_ns,
            "offset_ns": knot.offset_ns,
            "bound_ns": knot.bound_ns,
            "drift_ppb": segment.drift_ppb,
            "drift_bound_ppb": segment.drift_bound_ppb,
            "residual_ns": segment.residual_ns,
        }
        for fit in fits
        for number, segment in enumerate(fit.segments)
        for knot in segment.knots
    ]
    schema: dict[str, type[pl.DataType]] = {
        "ping_device": pl.String,
        "relay_device": pl.String,
        "boot": pl.Int64,
        "same_clock": pl.Boolean,
        "segment": pl.UInt32,
        "at_ns": pl.Int64,
        "offset_ns": pl.Int64,
        "bound_ns": pl.Int64,
        "drift_ppb": pl.Float64,
        "drift_bound_ppb": pl.Float64,
        "residual_ns": pl.Int64,
    }
    return pl.DataFrame(rows, schema=schema)
