"""The ledger of a run: which messages went out, which relays answered them, and how long the answers took."""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass

from dds_trace.base.units import SECOND_NS

from .progress import rtt_percentiles_ns

SILENCE_NS = 3 * SECOND_NS
"""Shortest silence that can mean a lost relay."""
CHANCE = 1e-6
"""Probability of a silence by losses like those before it, below which it means a lost relay."""


@dataclass(frozen=True, slots=True)
class Silence:
    """The end of a run, or of what it has sent so far, that no relay answered.

    Attributes:
        messages: messages sent behind the last answered one.
        duration_ns: time since the first of them was sent; until the last one was, once the run has ended.
        before: messages sent before them.
        answered: messages with a reply among those.
    """

    messages: int
    duration_ns: int
    before: int
    answered: int

    @property
    def is_lasting(self) -> bool:
        """Whether it took longer and more messages than losses like those before it explain."""
        if self.duration_ns < SILENCE_NS or self.messages <= 0:
            return False
        loss = (self.before - self.answered + 1) / (self.before + 2)  # Laplace's rule of succession
        return self.messages * math.log(loss) < math.log(CHANCE)


class Replies:
    """The ledger of one run.

    The thread that sends writes `publish_ns` and `payload_bytes`, the node's thread calls `note`; everything else may
    be asked from any thread.

    Args:
        messages: messages of the schedule.

    Attributes:
        publish_ns: T1 of each message by its sequence number; 0 before it is sent.
        payload_bytes: application bytes of each message, likewise.
        received: messages with at least one reply.
        highest: highest sequence number with a reply, -1 before the first.
        last_ns: monotonic time of the last reply, 0 before the first.
        longest_rtt_ns: longest round trip.
    """

    __slots__ = (
        "_answered",
        "_counts",
        "_rtt_ns",
        "highest",
        "last_ns",
        "longest_rtt_ns",
        "payload_bytes",
        "publish_ns",
        "received",
    )

    def __init__(self, messages: int) -> None:
        self.publish_ns = array("q", bytes(8 * messages))
        self.payload_bytes = array("I", bytes(4 * messages))
        self.received = 0
        self.highest = -1
        self.last_ns = 0
        self.longest_rtt_ns = 0
        self._rtt_ns = array("q", bytes(8 * messages))  # of the first reply; 0 while there is none
        self._answered: dict[int, bytearray] = {}  # relay -> a byte for each message, 1 if answered
        self._counts: dict[int, int] = {}  # relay -> messages that it has answered

    def note(self, sequence: int, relay_id: int, receive_ns: int) -> None:
        """Enter the reply of `relay_id` to message `sequence`; a second one of the same relay counts as one."""
        answered = self._answered.get(relay_id)
        if answered is None:
            answered = self._answered[relay_id] = bytearray(len(self.publish_ns))
            self._counts[relay_id] = 0
        if not answered[sequence]:
            answered[sequence] = 1
            self._counts[relay_id] += 1
        if not self._rtt_ns[sequence]:
            self._rtt_ns[sequence] = rtt_ns = receive_ns - self.publish_ns[sequence]
            self.longest_rtt_ns = max(self.longest_rtt_ns, rtt_ns)
            self.received += 1
            self.highest = max(self.highest, sequence)
        self.last_ns = receive_ns

    def are_complete(self, published: int) -> bool:
        """Tell whether every relay that has answered anything has answered all `published` messages."""
        counts = list(self._counts.values())
        return published == 0 or (bool(counts) and min(counts) >= published)

    def received_before(self, sequence: int) -> int:
        """Return the number of messages before `sequence` with at least one reply."""
        return sum(map(bool, self._rtt_ns[:sequence]))

    def percentiles_ns(self) -> tuple[int | None, int | None]:
        """Return p50 and p99 of the round trips so far, in ns; None before the first reply."""
        return rtt_percentiles_ns(self._rtt_ns)
