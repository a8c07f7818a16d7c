"""One publisher's messages at a tap: its description in the trace, counts, rate and silence; and publishers distinguished by their numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from dds_trace.base.units import SECOND_NS
from dds_trace.recorder.backends.node import Publication
from dds_trace.tracefile.format.descriptions import Qos
from dds_trace.tracefile.format.json_fields import JsonObject

SILENT_PERIODS = 10
SHORTEST_SILENCE_NS = 2 * SECOND_NS
"""A publisher is silent after `SILENT_PERIODS` of its periods, and at least this time."""
_LEARNING = 20
_WEIGHT = 32
"""The mean interval follows the last messages, about so many."""


class State(Enum):
    HEARD = "heard"
    STOPPED = "stopped"
    CLOSED = "closed"


@dataclass(slots=True, eq=False)
class Stream:
    """The messages of one publisher; the node's thread calls `count`, any thread may read.

    Attributes:
        publication: as the graph shows it; of several that share one stream, one of them.
        publisher_id: its number in the trace, from 1.
        publisher: its GUID; None if it is not sure.
        numbered: numbers from the first message heard to the latest, the missing ones included.
        first_sent_ns, last_sent_ns: when these were published, or arrived if that is unknown.
        last_ns: arrival of the latest message, monotonic; 0 before the first.
        stopped_at: its messages when it was reported as stopped; None while it is not.
    """

    publication: Publication
    publisher_id: int
    publisher: str | None
    subscribed: Qos
    has_header: bool
    messages: int = 0
    payload_bytes: int = 0
    missing: int = 0
    reordered: int = 0
    last_sequence: int = 0
    numbered: int = 0
    first_sent_ns: int = 0
    last_sent_ns: int = 0
    first_ns: int = 0
    last_ns: int = 0
    period_ns: float = 0.0
    stopped_at: int | None = None

    def count(self, now_ns: int, sequence: int, payload_bytes: int, sent_ns: int = 0) -> None:
        if sequence:
            sent_ns = sent_ns or now_ns
            expected = self.last_sequence + 1
            if not self.last_sequence:
                self.first_sent_ns, expected = sent_ns, sequence
            if sequence >= expected:
                self.missing += sequence - expected
                self.numbered += sequence - expected + 1
                self.last_sequence, self.last_sent_ns = sequence, sent_ns
            else:
                self.reordered += 1
                self.missing = max(self.missing - 1, 0)
        if self.messages:
            self.period_ns += (now_ns - self.last_ns - self.period_ns) / min(self.messages, _WEIGHT)
        else:
            self.first_ns = now_ns
        self.messages += 1
        self.payload_bytes += payload_bytes
        self.last_ns = now_ns

    @property
    def sent_period_ns(self) -> float:
        """The publisher's mean interval by its numbers; 0 if unknown."""
        return (self.last_sent_ns - self.first_sent_ns) / max(self.numbered - 1, 1)

    @property
    def rate_hz(self) -> float:
        """The publisher's rate by its numbers, else the rate of arrivals; 0 if unknown."""
        period_ns = self.sent_period_ns or (self.last_ns - self.first_ns) / max(self.messages - 1, 1)
        return SECOND_NS / period_ns if period_ns > 0 else 0.0

    @property
    def lost(self) -> str:
        """What did not arrive, in words, and how to receive it."""
        if not self.missing:
            return f", {self.missing} missing" if self.last_sequence else ""
        offered = self.publication.qos
        words = lost_words(self.subscribed.reliability, "unknown" if offered is None else offered.reliability)
        return f", {self.missing} missing: {words}"

    def steps_off(self, sequence: int, sent_ns: int) -> float:
        """Return by how many messages a number differs from the one that is due."""
        elapsed = (sent_ns - self.last_sent_ns) / self.sent_period_ns if self.sent_period_ns > 0 else 1.0
        return abs(sequence - self.last_sequence - elapsed)

    @property
    def is_back(self) -> bool:
        return self.stopped_at is not None and self.messages > self.stopped_at

    def silence_ns(self, now_ns: int) -> int | None:
        silence_ns = now_ns - self.last_ns
        usual_ns = max(SHORTEST_SILENCE_NS, SILENT_PERIODS * self.period_ns)
        return silence_ns if self.messages > _LEARNING and silence_ns > usual_ns else None

    def describe(self, state: State, session_id: int, now_ns: int) -> JsonObject:
        offered = self.publication.qos
        return {
            "session_id": f"{session_id:016x}",
            "publisher_id": self.publisher_id,
            "state": state.value,
            "topic": self.publication.topic,
            "type": self.publication.type_name,
            "publisher": self.publisher,
            "node": self.publication.node_name,
            "is_local": self.publication.is_local,
            "qos": {} if offered is None else offered.to_dict(),
            "subscribed": self.subscribed.to_dict(),
            "has_header": self.has_header,
            "sequence_is_given": self.last_sequence > 0,
            "monotonic_ns": now_ns,
            "messages": self.messages,
            "missing": self.missing if self.last_sequence else None,
        }


def lost_words(subscribed: str, offered: str) -> str:
    """Return who lost what did not arrive: a reliable publisher sends it again to those who ask."""
    cure = "; a reliable subscriber may have them: -o reliability=reliable" if offered != "best_effort" else ""
    return "lost on the way to this tap" + ("" if subscribed == "reliable" else f" (best effort{cure})")


def find_by_number(streams: Sequence[Stream], sequence: int, sent_ns: int) -> tuple[Stream | None, bool]:
    """Return the publisher with the number that is due, and whether that is sure.

    A publisher's numbers only rise: one that falls back is another's. The next number of a publisher is its own; one that is
    ahead of what is due by more than half of its step may be of a publisher that was not heard yet.
    """
    ahead = [stream for stream in streams if stream.last_sequence < sequence]
    following = [stream for stream in ahead if stream.last_sequence + 1 == sequence]
    best = min(following or ahead, key=lambda stream: stream.steps_off(sequence, sent_ns), default=None)
    if best is None or following:
        return best, True
    return best, 2 * best.steps_off(sequence, sent_ns) <= sequence - best.last_sequence
