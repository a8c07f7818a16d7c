from __future__ import annotations

import threading
from collections import Counter


class Strangers:
    """Counts of what peers sent and this process did not accept, by kind.

    Accepted messages never pay for its lock.
    """

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._noted: set[str] = set()

    def count(self, kind: str, number: int = 1) -> None:
        with self._lock:
            self._counts[kind] += number

    @property
    def counts(self) -> dict[str, int]:
        with self._lock:
            return dict(self._counts)

    def take_new(self) -> list[str]:
        new = sorted(self.counts.keys() - self._noted)
        self._noted.update(new)
        return new
