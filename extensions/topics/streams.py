"""One publisher's messages at a tap: its description in the trace, counts, period and silence."""

from __future__ import annotations

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
    first_ns: int = 0
    last_ns: int = 0
    period_ns: float = 0.0
    stopped_at: int | None = None

    def count(self, now_ns: int, sequence: int, payload_bytes: int) -> None:
        if sequence:
            expected = self.last_sequence + 1
            if sequence >= expected:
                self.missing += sequence - expected if self.last_sequence else 0
                self.last_sequence = sequence
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
