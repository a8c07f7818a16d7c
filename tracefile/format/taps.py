"""Events of a tap: messages of other programs as they arrived, in the layout of `events` under other names."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import blake2b
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .events import EventColumns

TAP_DEFINITION = """\
uint64 content_hash
uint64 publication_sequence
int64 monotonic_ns
int64 header_ns
int64 source_ns
int64 received_ns
uint32 payload_bytes
uint32 publisher_id
"""

PUBLISHER_TOPIC = "/dds_trace/publisher"
"""Topic of the publishers' descriptions, JSON objects (docs/trace-format.md)."""


@dataclass(frozen=True, slots=True, eq=False)
class TapColumns:
    """Events of taps as columns, in file order; all arrays are one-dimensional and equally long.

    Attributes:
        content_hash: identity of the serialized message (`hash_content`).
        publication_sequence: the publisher's number of the message; 0 if unknown.
        monotonic_ns: arrival on CLOCK_MONOTONIC of the recording device.
        header_ns: stamp of the message's first header, on its sender's clock; 0 if there is none.
        source_ns, received_ns: the middleware's source and reception time stamps, ns since 1970; 0 if unknown.
        payload_bytes: length of the serialized message.
        publisher_id: `publisher_id` of a description in the same session.
    """

    content_hash: NDArray[np.uint64]
    publication_sequence: NDArray[np.uint64]
    monotonic_ns: NDArray[np.int64]
    header_ns: NDArray[np.int64]
    source_ns: NDArray[np.int64]
    received_ns: NDArray[np.int64]
    payload_bytes: NDArray[np.uint32]
    publisher_id: NDArray[np.uint32]

    def __len__(self) -> int:
        return len(self.content_hash)

    @classmethod
    def from_events(cls, events: EventColumns) -> TapColumns:
        """Give the events of `Stage.TAP` their names; no copy."""
        return cls(
            content_hash=events.run_id,
            publication_sequence=events.sequence,
            monotonic_ns=events.monotonic_ns,
            header_ns=events.scheduled_ns,
            source_ns=events.source_ns,
            received_ns=events.received_ns,
            payload_bytes=events.payload_bytes,
            publisher_id=events.relay_id,
        )


def hash_content(message: bytes | bytearray | memoryview) -> int:
    """Return the identity of a serialized message, 1 to 2^64 - 1: its encapsulation and padding at the end do not count."""
    digest = blake2b(memoryview(message)[4:], digest_size=8)
    digest.update(bytes(-len(message) % 4))
    return int.from_bytes(digest.digest(), "little") or 1
