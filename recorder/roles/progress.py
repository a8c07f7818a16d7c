"""The progress of a role while it runs."""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass
from enum import Enum
from typing import Protocol, TypeAlias

import numpy as np

from dds_trace.base.units import SECOND_NS

from ..applied.applied import Traffic

PERCENTILE_SAMPLES = 10_000
"""Most messages, evenly picked, for a percentile on the screen."""
SILENCE_NS = 3 * SECOND_NS
"""Shortest silence that can mean a lost relay."""
CHANCE = 1e-6
"""Below this probability by the losses before it, a silence means that the relay is lost."""


@dataclass(frozen=True, slots=True)
class PingProgress:
    """Messages of a ping's run, warm-up included; `lost` lack a reply that a later one has, at the end any reply."""

    planned: int
    sent: int
    received: int
    lost: int
    rtt_p50_ns: int | None = None
    rtt_p99_ns: int | None = None
    warmup: int = 0
    warmup_received: int = 0
    warmup_lost: int = 0

    @property
    def messages(self) -> int:
        return self.received


@dataclass(frozen=True, slots=True)
class RelayProgress:
    relayed: int
    runs: int
    foreign: int

    @property
    def messages(self) -> int:
        return self.relayed


class Health(Enum):
    OK = "OK"
    SLOW = "SLOW"
    LATE = "LATE"
    STALE = "STALE"


@dataclass(frozen=True, slots=True)
class LiveRow:
    """One topic now.

    Attributes:
        expected_hz: given or learnt; None before that.
        age_ns, age_p99_ns: arrival minus the message's stamp, both by this device's wall clock, of the latest message and
            of the latest `KEPT_MESSAGES`; wrong by the difference of the clocks where the sender is another device.
        silence_ns: time since the latest message.
    """

    topic: str
    health: Health
    rate_hz: float
    expected_hz: float | None
    age_ns: int | None
    age_p99_ns: int | None
    missing: int
    silence_ns: int | None


@dataclass(frozen=True, slots=True)
class TapProgress:
    """`missing` are messages by their numbers; `rows` come with `--live`."""

    messages: int
    topics: int
    publishers: int
    missing: int
    rows: tuple[LiveRow, ...] = ()


@dataclass(frozen=True, slots=True)
class BeaconProgress:
    sent: int
    received: int
    clocks: tuple[str, ...] = ()

    @property
    def messages(self) -> int:
        return self.received


Progress: TypeAlias = "PingProgress | RelayProgress | TapProgress | BeaconProgress"


class Role(Protocol):
    """What a recording runs on its node."""

    @property
    def traffic(self) -> Traffic:
        """The messages so far, as the kernel must have counted them."""

    def progress(self) -> Progress: ...


class Watch(Protocol):
    """Called twice a second during a recording."""

    def note(self, text: str) -> None: ...

    def progress(self, progress: Progress) -> None: ...


@dataclass(frozen=True, slots=True)
class Silence:
    """The messages after the last answered one; of those `before` them, `answered` have a reply.

    `duration_ns` is the time since the first of them; after the run, until the last one.
    """

    messages: int
    duration_ns: int
    before: int
    answered: int

    @property
    def is_lasting(self) -> bool:
        if self.duration_ns < SILENCE_NS or self.messages <= 0:
            return False
        loss = (self.before - self.answered + 1) / (self.before + 2)  # Laplace's rule of succession
        return self.messages * math.log(loss) < math.log(CHANCE)


class Replies:
    """The messages of one run and their replies.

    The sending thread writes `publish_ns` and `payload_bytes`, the node's thread calls `note`; any thread may read.

    Attributes:
        publish_ns: T1 of each message by its sequence number; 0 before it is sent.
        highest: sequence number with a reply, -1 before the first.
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
        self._rtt_ns = array("q", [-1]) * messages  # of the first reply, which a coarse clock may give 0
        self._answered: dict[int, bytearray] = {}  # relay -> a byte for each message, 1 if answered
        self._counts: dict[int, int] = {}  # relay -> messages that it has answered

    def note(self, sequence: int, relay_id: int, receive_ns: int) -> None:
        answered = self._answered.get(relay_id)
        if answered is None:
            answered = self._answered[relay_id] = bytearray(len(self.publish_ns))
            self._counts[relay_id] = 0
        if not answered[sequence]:
            answered[sequence] = 1
            self._counts[relay_id] += 1
            self.last_ns = max(self.last_ns, receive_ns)
        if self._rtt_ns[sequence] < 0:
            self._rtt_ns[sequence] = rtt_ns = receive_ns - self.publish_ns[sequence]
            self.longest_rtt_ns = max(self.longest_rtt_ns, rtt_ns)
            self.received += 1
            self.highest = max(self.highest, sequence)

    def are_complete(self, published: int) -> bool:
        counts = list(self._counts.values())
        return published == 0 or (bool(counts) and min(counts) >= published)

    def received_of(self, messages: slice, timeout_ns: float = math.inf) -> int:
        return sum(0 <= rtt_ns <= timeout_ns for rtt_ns in self._rtt_ns[messages])

    def percentiles_ns(self) -> tuple[int | None, int | None]:
        values = np.frombuffer(self._rtt_ns, np.int64)
        values = values[:: len(values) // PERCENTILE_SAMPLES + 1]
        values = np.sort(values[values >= 0])
        if not len(values):
            return None, None
        # The nearest order statistics: np.percentile's first call imports for 0.1 s.
        p50, p99 = values[round(0.50 * (len(values) - 1))], values[round(0.99 * (len(values) - 1))]
        return int(p50), int(p99)
