"""The forwarder of an emulated link, for kernels without netem: carries frames between two TAP devices.

It applies delay, jitter, loss and outages; the kernel's token bucket the rate, which slows the sender as a network card
does. With a `Drive` it applies the rate, too, by a queue that drops what is too much, as a radio does:

    tap_forwarder.py FD FD FD

takes the TAP devices, and a file with a `Link` and its `Drive` as JSON, as file descriptors. Of the lines on standard
input it answers `report` with a line of JSON (`Wire.report` of both directions); `start NS` starts the drive at a time of
CLOCK_MONOTONIC, `rest` goes back to its first row. It ends when standard input closes.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import random
import select
import sys
import time
from bisect import bisect_right
from collections import Counter, deque

FRAME_BYTES = 65536
MOST_FRAMES = 50_000
"""Most frames on the wire at once: 0.5 s at 1 Gbit/s has 42,000."""

IP_FRAMES = (b"\x08\x00", b"\x86\xdd")
"""Ethertypes that may be lost: a lost ARP request would cost a second and measure nothing."""

PR_SET_TIMERSLACK = 29  # <linux/prctl.h>
WIRE_PRIORITY = 10


class Replay:
    """The rows of a drive (time, rate, delay, loss, jitter) as time goes on; at rest the first one is valid."""

    def __init__(self, rows: list[list[float]]) -> None:
        self._rows = rows
        self._times_ns = [round(row[0] * 1e9) for row in rows]
        self.started_ns: int | None = None

    def at(self, now_ns: int) -> list[float]:
        if self.started_ns is None:
            return self._rows[0]
        elapsed_ns = (now_ns - self.started_ns) % self._times_ns[-1]
        return self._rows[bisect_right(self._times_ns, elapsed_ns) - 1]


def burst_chances(loss: float, burst: float) -> tuple[float, float]:
    """Return the chances to enter and to leave a burst with which this share is lost, `burst` frames in a row at the mean."""
    leave = 1 / burst
    return min(1.0, loss * leave / max(1 - loss, 1e-9)), leave


class Line:
    """What carries one frame after the other: of one direction, or of both if they share it."""

    def __init__(self, rate_mbit_s: float = 0.0) -> None:
        self.rate_bit_ns = rate_mbit_s / 1e3
        self.free_ns = 0.0  # when it has sent all that was taken


class Wire:
    """One direction between two TAP devices; outages count from `started_ns`."""

    def __init__(
        self,
        source: int,
        sink: int,
        link: dict[str, float],
        started_ns: int,
        replay: Replay | None = None,
        line: Line | None = None,
    ) -> None:
        self.source = source
        self._sink = sink
        self._delay_ns = link["delay_ms"] * 1e6
        self._jitter_ns = link["jitter_ms"] * 1e6
        self._loss = link["loss_percent"] / 100
        self._outage_every_ns = int(link["outage_every_s"] * 1e9)
        self._outage_ns = int(link["outage_ms"] * 1e6)
        self._started_ns = started_ns
        self._replay = replay
        self._has_rate = bool(link.get("has_rate"))
        self._queue_ns = link["queue_ms"] * 1e6
        self._line = line or Line()
        burst = link.get("loss_burst", 0.0)
        self._burst_chances = burst_chances(self._loss, burst) if burst > 1 else None
        self._in_burst = False
        self._chance = random.Random()  # noqa: S311 - losses, not a secret
        self._last_due_ns = 0
        self._in_flight: deque[tuple[int, bytes]] = deque()
        self._lateness_us: Counter[int] = Counter()
        self._counts: Counter[str] = Counter()

    def take(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:
                frame = os.read(self.source, FRAME_BYTES)
                now_ns = time.monotonic_ns()
                if self._replay is not None:
                    _, rate_mbit_s, delay_ms, loss_percent, jitter_ms = self._replay.at(now_ns)
                    self._line.rate_bit_ns, self._loss = rate_mbit_s / 1e3, loss_percent / 100
                    self._delay_ns, self._jitter_ns = delay_ms * 1e6, jitter_ms * 1e6
                fate = self._fate(frame, now_ns)
                self._counts[fate] += 1
                if fate == "carried":
                    sent_ns = now_ns
                    if self._has_rate:
                        line = self._line
                        line.free_ns = max(now_ns, line.free_ns) + len(frame) * 8 / line.rate_bit_ns
                        sent_ns = int(line.free_ns)
                    due_ns = sent_ns + max(0, int(self._chance.gauss(self._delay_ns, self._jitter_ns)))
                    self._last_due_ns = max(self._last_due_ns, due_ns)  # frames keep their order
                    self._in_flight.append((self._last_due_ns, frame))

    def _fate(self, frame: bytes, now_ns: int) -> str:
        if self._outage_ns and self._in_outage(now_ns):
            return "in_outage"
        if self._loss and frame[12:14] in IP_FRAMES and self._is_lost():
            return "lost"
        if self._has_rate and not self._line.rate_bit_ns:
            return "in_outage"
        if self._has_rate and self._line.free_ns - now_ns > self._queue_ns:
            return "overflow"
        return "carried" if len(self._in_flight) < MOST_FRAMES else "overflow"

    def _is_lost(self) -> bool:
        chance = self._chance.random()
        if self._burst_chances is None:
            return chance < self._loss
        enter, leave = self._burst_chances
        self._in_burst = chance >= leave if self._in_burst else chance < enter
        return self._in_burst

    def _in_outage(self, now_ns: int) -> bool:
        # At the end of each period, so that a new link is up.
        return (now_ns - self._started_ns) % self._outage_every_ns >= self._outage_every_ns - self._outage_ns

    def release(self) -> None:
        while self._in_flight and self._in_flight[0][0] <= time.monotonic_ns():
            due_ns, frame = self._in_flight.popleft()
            try:
                os.write(self._sink, frame)
            except OSError:  # that side's device is down or its queue is full
                self._counts["refused"] += 1
            self._lateness_us[(time.monotonic_ns() - due_ns) // 1000] += 1

    @property
    def due_ns(self) -> int | None:
        return self._in_flight[0][0] if self._in_flight else None

    def report(self) -> dict[str, float | None]:
        report: dict[str, float | None] = {
            **{fate: self._counts[fate] for fate in ("carried", "lost", "in_outage", "overflow", "refused")},
            "lateness_p50_us": quantile(self._lateness_us, 0.50),
            "lateness_p99_us": quantile(self._lateness_us, 0.99),
            "lateness_max_us": max(self._lateness_us, default=None),
        }
        self._counts.clear()
        self._lateness_us.clear()
        return report


def quantile(counts: Counter[int], share: float) -> int | None:
    rank = share * counts.total()
    reached = 0
    for value in sorted(counts):
        reached += counts[value]
        if reached >= rank:
            return value
    return None


def main() -> None:
    first, second = int(sys.argv[1]), int(sys.argv[2])
    with open(int(sys.argv[3])) as file:  # noqa: PTH123 - a descriptor
        link = json.load(file)
    ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, 1)
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(WIRE_PRIORITY))
    started_ns = time.monotonic_ns()
    replay = Replay(link["rows"]) if link["rows"] else None
    air = Line(link["rate_mbit_s"]) if link.get("shared") else None
    wires = [Wire(*ends, link, started_ns, replay, air) for ends in ((first, second), (second, first))]
    stdin = sys.stdin.fileno()
    while True:
        due_ns = [wire.due_ns for wire in wires if wire.due_ns is not None]
        wait_s = max(0.0, (min(due_ns) - time.monotonic_ns()) / 1e9) if due_ns else None
        # The time-out of poll and epoll is in whole milliseconds.
        ready, _, _ = select.select([first, second, stdin], [], [], wait_s)
        for wire in wires:
            if wire.source in ready:
                wire.take()
            wire.release()
        if stdin in ready:
            lines = os.read(stdin, 4096).decode().splitlines()
            if not lines:
                return
            for word, *values in map(str.split, lines):
                if word == "report":
                    print(json.dumps({"from_ping": wires[0].report(), "from_relay": wires[1].report()}), flush=True)
                elif replay is not None:
                    replay.started_ns = int(values[0]) if word == "start" else None


if __name__ == "__main__":
    main()
