"""Difference and drift of two devices' monotonic clocks while a beacon runs; the analysis fits the whole trace."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from dds_trace.base.units import SECOND_NS

WINDOW_NS = 5 * SECOND_NS
"""Of the round trips of this time only the quickest counts: the others waited somewhere."""
KEPT_WINDOWS = 120
DRIFT_WINDOWS = 6
"""Windows from which a drift is estimated."""
UNKNOWN_DRIFT_PPM, WANDER_PPM = 200.0, 2.0
"""How much a drift may be wrong before it is estimated (two crystals), and at least afterwards."""
STEP_PPM = 1000.0
"""A clock that moves faster than this was set: what was seen before does not count."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """The other clock minus this one now, ns: wrong by at most `bound_ns`; `drift_ppm` is None while it is unknown."""

    offset_ns: float
    bound_ns: float
    drift_ppm: float | None


@dataclass(frozen=True, slots=True)
class _Interval:
    """The offset was between `low_ns` and `high_ns` at `at_ns` of this clock."""

    at_ns: int
    low_ns: int
    high_ns: int

    @property
    def width_ns(self) -> int:
        return self.high_ns - self.low_ns

    @property
    def middle_ns(self) -> float:
        return (self.low_ns + self.high_ns) / 2

    def is_contradicted(self, later: _Interval) -> bool:
        """Return whether no drift leads from this one to a later one."""
        most_ns = abs(later.at_ns - self.at_ns) * STEP_PPM / 1e6
        return later.low_ns - self.high_ns > most_ns or self.low_ns - later.high_ns > most_ns


class ClockEstimate:
    """Round trips with one other device."""

    def __init__(self) -> None:
        self._windows: deque[_Interval] = deque(maxlen=KEPT_WINDOWS)

    def add(self, publish_ns: int, relay_in_ns: int, relay_out_ns: int, receive_ns: int) -> None:
        """Add T1 and T2 of this clock, T3 and T4 of the other one; stamps of no possible round trip are ignored."""
        new = _Interval((publish_ns + receive_ns) // 2, relay_out_ns - receive_ns, relay_in_ns - publish_ns)
        if new.width_ns < 0:
            return
        latest = self._windows[-1] if self._windows else None
        if latest is not None and latest.is_contradicted(new):
            self._windows.clear()
            latest = None
        if latest is None or new.at_ns // WINDOW_NS != latest.at_ns // WINDOW_NS:
            self._windows.append(new)
        elif new.width_ns < latest.width_ns:
            self._windows[-1] = new

    def at(self, now_ns: int) -> Estimate | None:
        """Return the estimate at an instant of this clock, None before the first round trip."""
        if not self._windows:
            return None
        drift = self._drift()
        unsure_ppm = UNKNOWN_DRIFT_PPM if drift is None else self._unsure_ppm()
        low_ns, high_ns = -float("inf"), float("inf")
        for window in reversed(self._windows):
            elapsed_ns = now_ns - window.at_ns
            moved_ns, unsure_ns = elapsed_ns * (drift or 0.0), abs(elapsed_ns) * unsure_ppm / 1e6
            low = max(low_ns, window.low_ns + moved_ns - unsure_ns)
            high = min(high_ns, window.high_ns + moved_ns + unsure_ns)
            if low > high:  # the clock drifted otherwise before
                break
            low_ns, high_ns = low, high
        return Estimate((low_ns + high_ns) / 2, (high_ns - low_ns) / 2, None if drift is None else drift * 1e6)

    def _unsure_ppm(self) -> float:
        """Return how much the drift may be wrong: the windows' usual width over their time."""
        widths = sorted(window.width_ns for window in self._windows)
        span_ns = max(self._windows[-1].at_ns - self._windows[0].at_ns, 1)
        return min(max(WANDER_PPM, 1e6 * widths[len(widths) // 2] / span_ns), UNKNOWN_DRIFT_PPM)

    def _drift(self) -> float | None:
        """Return the slope of a line through the windows, the narrow ones with more weight."""
        windows = self._windows
        if len(windows) < DRIFT_WINDOWS:
            return None
        origin = windows[0]
        rows = [
            (1 / max(one.width_ns, 1) ** 2, one.at_ns - origin.at_ns, one.middle_ns - origin.middle_ns)
            for one in windows
        ]
        total = sum(weight for weight, _, _ in rows)
        mean_at, mean_offset = (sum(row[0] * row[column] for row in rows) / total for column in (1, 2))
        spread = sum(weight * (at - mean_at) ** 2 for weight, at, _ in rows)
        common = sum(weight * (at - mean_at) * (offset - mean_offset) for weight, at, offset in rows)
        return common / spread if spread else None
