"""Rate as published, age, loss and state of each topic while a tap runs, over its latest messages: memory does not grow."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping, Sequence

from dds_trace.base.units import SECOND_NS
from dds_trace.recorder.roles.progress import Health, LiveRow

KEPT_MESSAGES = 1000
WINDOW_NS = 5 * SECOND_NS
"""Rates are of the messages of this time, or of the latest `KEPT_MESSAGES`."""
LEARNING = 50
"""Messages after the first `WINDOW_NS` (a topic may begin with a burst) from which a rate is learnt, if none is given."""
SLOW_SHARE = 0.9
"""A topic is slow below this share of its expected rate, and late after `LATE_PERIODS` without a message."""
LATE_PERIODS, STALE_PERIODS = 3, 10
STALE_NS = SECOND_NS
"""A topic is stale after `STALE_PERIODS` without a message, and at least this time."""


class LiveTopic:
    """The latest messages of a topic; the node's thread calls `count`."""

    def __init__(self, name: str, expected_hz: float | None) -> None:
        self.name = name
        self.expected_hz = expected_hz
        self._first_ns = 0
        self._arrivals: deque[tuple[int, int]] = deque(maxlen=KEPT_MESSAGES)
        """Each arrival, and the messages up to it, the missing ones included."""
        self._messages = 0
        self._ages_ns: deque[int] = deque(maxlen=KEPT_MESSAGES)
        self._missing: dict[int, int] = {}
        self._wall_offset_ns = time.time_ns() - time.monotonic_ns()

    def count(self, arrival_ns: int, stamp_ns: int, publisher_id: int, missing: int) -> None:
        """Take a message's arrival on the monotonic clock, its stamp on the wall clock (0: none), and its publisher's losses."""
        self._first_ns = self._first_ns or arrival_ns
        self._messages += 1
        self._missing[publisher_id] = missing
        self._arrivals.append((arrival_ns, self._messages + sum(self._missing.values())))
        if stamp_ns:
            self._ages_ns.append(arrival_ns + self._wall_offset_ns - stamp_ns)

    def row(self, now_ns: int) -> LiveRow:
        self._wall_offset_ns = time.time_ns() - time.monotonic_ns()
        arrivals, ages_ns = self._arrivals.copy(), sorted(self._ages_ns.copy())
        age_ns = self._ages_ns[-1] if ages_ns else None
        if self.expected_hz is None:
            steady = [arrival for arrival in arrivals if arrival[0] > self._first_ns + WINDOW_NS]
            if len(steady) >= LEARNING:
                self.expected_hz = _rate_hz(steady, steady[-1][0])
        silence_ns = now_ns - arrivals[-1][0] if arrivals else None
        rate_hz = _rate_hz([arrival for arrival in arrivals if arrival[0] > now_ns - WINDOW_NS], now_ns)
        return LiveRow(
            self.name,
            self._health(rate_hz, silence_ns),
            rate_hz,
            self.expected_hz,
            age_ns,
            ages_ns[round(0.99 * (len(ages_ns) - 1))] if ages_ns else None,
            sum(self._missing.values()),
            silence_ns,
        )

    def _health(self, rate_hz: float, silence_ns: int | None) -> Health:
        if silence_ns is None:
            return Health.STALE
        if self.expected_hz is None:
            return Health.STALE if silence_ns > WINDOW_NS else Health.OK
        periods = silence_ns * self.expected_hz / SECOND_NS
        if periods > STALE_PERIODS and silence_ns > STALE_NS:
            return Health.STALE
        if periods > LATE_PERIODS:
            return Health.LATE
        return Health.SLOW if rate_hz < SLOW_SHARE * self.expected_hz else Health.OK


def _rate_hz(arrivals: Sequence[tuple[int, int]], now_ns: int) -> float:
    if len(arrivals) < 2:
        return 0.0
    # Up to now once a period has passed without a message, so that a topic that stops gets slower.
    (first_ns, first), (last_ns, last) = arrivals[0], arrivals[-1]
    span_ns, intervals = last_ns - first_ns, max(last - first, 1)
    overdue_ns = max(now_ns - last_ns - span_ns / intervals, 0)
    return intervals * SECOND_NS / max(span_ns + overdue_ns, 1)


class LiveTable:
    """All topics of a tap; `expected_hz` has the rates that the user gave, also of topics that never came."""

    def __init__(self, expected_hz: Mapping[str, float]) -> None:
        self._topics = {name: LiveTopic(name, rate_hz) for name, rate_hz in expected_hz.items()}

    def topic(self, name: str) -> LiveTopic:
        return self._topics.setdefault(name, LiveTopic(name, None))

    def rows(self) -> tuple[LiveRow, ...]:
        now_ns = time.monotonic_ns()
        return tuple(self._topics[name].row(now_ns) for name in sorted(self._topics))
