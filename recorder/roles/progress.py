"""The progress of a role while it runs, computed for whoever asks and never for each message."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from array import array

PERCENTILE_SAMPLES = 10_000
"""Most messages, evenly picked, from which a percentile for the eye is taken: 0.1 ms of computing."""


@dataclass(frozen=True, slots=True)
class PingProgress:
    """The progress of a ping's run.

    Attributes:
        planned: messages of the schedule, warm-up included.
        sent: messages handed to the middleware.
        received: messages with at least one reply.
        lost: messages without one although a later message has one; at the end, all without one.
        rtt_p50_ns: median round trip so far, None before the first reply; likewise `rtt_p99_ns`.
        warmup: messages of the warm-up among those planned; of them `warmup_received` and `warmup_lost` so far.
    """

    planned: int
    sent: int
    received: int
    lost: int
    rtt_p50_ns: int | None = None
    rtt_p99_ns: int | None = None
    warmup: int = 0
    warmup_received: int = 0
    warmup_lost: int = 0


@dataclass(frozen=True, slots=True)
class RelayProgress:
    """The progress of a relay.

    Attributes:
        relayed: messages sent back, readiness probes not counted.
        runs: different runs among them.
        foreign: messages on our topics without our stamp, which were left alone.
    """

    relayed: int
    runs: int
    foreign: int


class Watch(Protocol):
    """An observer of a recording; called from the thread that called `record`, twice a second."""

    def note(self, text: str) -> None:
        """Take a line that the user should read now."""

    def progress(self, progress: PingProgress | RelayProgress) -> None:
        """Take the role's progress."""


def rtt_percentiles_ns(rtt_ns: array[int]) -> tuple[int | None, int | None]:
    """Return p50 and p99 of the round trips in `rtt_ns`, in ns; a 0 in it means no reply yet."""
    values = np.frombuffer(rtt_ns, np.int64)
    values = values[:: len(values) // PERCENTILE_SAMPLES + 1]
    values = np.sort(values[values > 0])
    if not len(values):
        return None, None
    # The nearest order statistics. np.percentile's first call imports for 0.1 s, in the middle of a run.
    p50, p99 = values[round(0.50 * (len(values) - 1))], values[round(0.99 * (len(values) - 1))]
    return int(p50), int(p99)
