"""The user-space wire of an emulated link: it carries frames between two TAP devices with delay, jitter, loss and outages.

For kernels without netem. A process of its own, started as a file, so that the sweep's Python never delays
a frame:

    tap_forwarder.py FD FD JSON

takes the two TAP devices as open file descriptors and a `Link` as JSON. Every line on standard input is
answered by a line of JSON on standard output: the report of each direction since the line before (`Wire.report`). It
ends when standard input closes; when the sweep is killed, the kernel closes it.

The link's rate is not applied here but by the kernel's token bucket on the TAP devices: there a full line
holds the sender back as a network card does; a program behind it cannot.
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
from collections import Counter, deque

FRAME_BYTES = 65536
HELD_FRAMES = 50_000
"""Most frames on the wire at once; a delay of 0.5 s at 1 Gbit/s has 42,000."""

IP_FRAMES = (b"\x08\x00", b"\x86\xdd")
"""Ethertypes of frames that may be lost: a lost address resolution would cost a second and measure nothing."""

PR_SET_TIMERSLACK = 29  # <linux/prctl.h>
WIRE_PRIORITY = 10


class Wire:
    """One direction of the link.

    Args:
        source: TAP device to read from, non-blocking.
        sink: TAP device to write to.
        link: fields of a `Link`.
        started_ns: start of the link on the monotonic clock, from which outages are counted.
    """

    def __init__(self, source: int, sink: int, link: dict[str, float], started_ns: int) -> None:
        self.source = source
        self._sink = sink
        self._delay_ns = link["delay_ms"] * 1e6
        self._jitter_ns = link["jitter_ms"] * 1e6
        self._loss = link["loss_percent"] / 100
        self._outage_every_ns = int(link["outage_every_s"] * 1e9)
        self._outage_ns = int(link["outage_ms"] * 1e6)
        self._started_ns = started_ns
        self._chance = random.Random()  # noqa: S311 - losses, not a secret
        self._last_due_ns = 0
        self._held: deque[tuple[int, bytes]] = deque()
        self._lateness_us: Counter[int] = Counter()
        self._counts: Counter[str] = Counter()

    def take(self) -> None:
        """Read the waiting frames and decide the fate of each: lost, or due at some time."""
        with contextlib.suppress(BlockingIOError):
            while True:
                frame = os.read(self.source, FRAME_BYTES)
                now_ns = time.monotonic_ns()
                fate = self._fate(frame, now_ns)
                self._counts[fate] += 1
                if fate == "carried":
                    due_ns = now_ns + max(0, int(self._chance.gauss(self._delay_ns, self._jitter_ns)))
                    self._last_due_ns = max(self._last_due_ns, due_ns)  # frames keep their order
                    self._held.append((self._last_due_ns, frame))

    def _fate(self, frame: bytes, now_ns: int) -> str:
        if self._outage_ns and self._in_outage(now_ns):
            return "in_outage"
        if self._loss and frame[12:14] in IP_FRAMES and self._chance.random() < self._loss:
            return "lost"
        return "carried" if len(self._held) < HELD_FRAMES else "overflow"

    def _in_outage(self, now_ns: int) -> bool:
        # At the end of each period, so that a link is up when it is new.
        return (now_ns - self._started_ns) % self._outage_every_ns >= self._outage_every_ns - self._outage_ns

    def release(self) -> None:
        """Write every frame that is due to the other side."""
        while self._held and self._held[0][0] <= time.monotonic_ns():
            due_ns, frame = self._held.popleft()
            try:
                os.write(self._sink, frame)
            except OSError:  # that side's device is down or its queue is full
                self._counts["refused"] += 1
            self._lateness_us[(time.monotonic_ns() - due_ns) // 1000] += 1

    @property
    def due_ns(self) -> int | None:
        """Time at which the next frame is due, None if the wire is empty."""
        return self._held[0][0] if self._held else None

    def report(self) -> dict[str, float | None]:
        """Return the frames by fate and the lateness of the carried ones, since the report before."""
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
    """Return the smallest value that at least this share of the counted values does not exceed, None without values."""
    wanted = share * counts.total()
    reached = 0
    for value in sorted(counts):
        reached += counts[value]
        if reached >= wanted:
            return value
    return None


def run_ahead_of_others() -> None:
    """Take real-time priority and no timer slack, where permitted: a wire does not wait for the CPU.

    Without the permission, the reported lateness grows.
    """
    ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, 1)
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(WIRE_PRIORITY))


def main() -> None:
    """Carry frames until standard input closes."""
    first, second = int(sys.argv[1]), int(sys.argv[2])
    link = json.loads(sys.argv[3])
    run_ahead_of_others()
    started_ns = time.monotonic_ns()
    wires = (Wire(first, second, link, started_ns), Wire(second, first, link, started_ns))
    asked = sys.stdin.fileno()
    while True:
        due_ns = [wire.due_ns for wire in wires if wire.due_ns is not None]
        wait_s = max(0.0, (min(due_ns) - time.monotonic_ns()) / 1e9) if due_ns else None
        # Not poll or epoll: their time-out is in whole milliseconds.
        ready, _, _ = select.select([first, second, asked], [], [], wait_s)
        for wire in wires:
            if wire.source in ready:
                wire.take()
            wire.release()
        if asked in ready:
            if not os.read(asked, 4096):
                return
            print(json.dumps({"from_ping": wires[0].report(), "from_relay": wires[1].report()}), flush=True)


if __name__ == "__main__":
    main()
