"""Time that passes only when somebody waits, so that a test can draw a timeline and assert every number."""

import heapq
import threading
from collections.abc import Callable

from dds_trace.recorder.host.clock import ClockAnchor


class FakeClock:
    """A `dds_trace.recorder.host.clock.Clock`; what is due is called while a wait passes its time."""

    def __init__(self, now_ns: int = 1_000_000_000_000, wall_offset_ns: int = 1_700_000_000_000_000_000) -> None:
        self.now_ns = now_ns
        self.wall_offset_ns = wall_offset_ns
        self._due: list[tuple[int, int, Callable[[], None]]] = []
        self._count = 0

    def monotonic_ns(self) -> int:
        return self.now_ns

    def anchor(self) -> ClockAnchor:
        return ClockAnchor(self.now_ns + self.wall_offset_ns, self.now_ns)

    def at(self, monotonic_ns: int, call: Callable[[], None]) -> None:
        self._count += 1
        heapq.heappush(self._due, (monotonic_ns, self._count, call))

    def advance_to(self, monotonic_ns: int) -> None:
        while self._due and self._due[0][0] <= monotonic_ns:
            due_ns, _, call = heapq.heappop(self._due)
            self.now_ns = max(self.now_ns, due_ns)
            call()
        self.now_ns = max(self.now_ns, monotonic_ns)

    def wait_until(self, monotonic_ns: int, stop: threading.Event) -> bool:
        if stop.is_set():
            return False
        self.advance_to(monotonic_ns)
        return not stop.is_set()
