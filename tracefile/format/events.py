"""The event: the eight integers of a time stamp T1..T4 in a trace, as bytes, MCAP record and columns.

The layout is `docs/trace-format.md`; other programs depend on every name here.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from enum import Enum
from hashlib import blake2b
from typing import TypeAlias

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from .encoding import CDR_HEADER, MESSAGE_HEADER, RECORD_HEADER

EVENT_SCHEMA_NAME = "dds_trace_msgs/msg/TraceEvent"
TAP_SCHEMA_NAME = "dds_trace_msgs/msg/TapEvent"
EVENT_DEFINITION = """\
uint64 run_id
uint64 sequence
int64 monotonic_ns
int64 scheduled_ns
int64 source_ns
int64 received_ns
uint32 payload_bytes
uint32 relay_id
"""

EVENT_DTYPE = np.dtype(
    [(name, np.dtype(kind).newbyteorder("<")) for kind, name in map(str.split, EVENT_DEFINITION.splitlines())]
)
"""One event without its CDR header: 56 bytes, no padding."""

EVENT_CDR_BYTES = len(CDR_HEADER) + EVENT_DTYPE.itemsize
"""Length of a serialized event, 60 bytes."""


class Stage(Enum):
    """What an event is: T1 sent and T2 received by the ping, T3 received and T4 sent by the relay, or received by a tap (`taps`)."""

    T1 = "t1"
    T2 = "t2"
    T3 = "t3"
    T4 = "t4"
    TAP = "tap"

    __hash__ = object.__hash__  # of the name it would be a call of Python

    @property
    def topic(self) -> str:
        """Topic in the file."""
        return f"/dds_trace/{self.value}"

    @property
    def schema_name(self) -> str:
        """Schema of its events, all of one layout."""
        return TAP_SCHEMA_NAME if self is Stage.TAP else EVENT_SCHEMA_NAME


MOST_STAMP_NS = 1 << 62
"""Largest absolute value of a stamp, 146 years: differences of two fit into 64 bits, and none is a mark for "missing"."""

STAGE_OF_TOPIC = {stage.topic: stage for stage in Stage}
TOPIC_PREFIX = "/dds_trace/"
"""Start of our topics."""
SESSION_TOPIC = "/dds_trace/session"
RUN_TOPIC = "/dds_trace/run"
HOST_TOPIC = "/dds_trace/host"
WIRE_TOPIC = "/dds_trace/wire"


@dataclass(frozen=True, slots=True, eq=False)
class EventColumns:
    """Events of one stage as columns, in file order; all arrays are one-dimensional and equally long.

    Attributes:
        sequence: number of the message within its run.
        monotonic_ns: CLOCK_MONOTONIC of the recording device.
        scheduled_ns: T0 on the same clock (T1 only, else 0).
        source_ns, received_ns: the middleware's source and reception time stamps, ns since 1970; 0 if unknown.
        payload_bytes: application bytes.
        relay_id: 0 on T1.
    """

    run_id: NDArray[np.uint64]
    sequence: NDArray[np.uint64]
    monotonic_ns: NDArray[np.int64]
    scheduled_ns: NDArray[np.int64]
    source_ns: NDArray[np.int64]
    received_ns: NDArray[np.int64]
    payload_bytes: NDArray[np.uint32]
    relay_id: NDArray[np.uint32]

    def __len__(self) -> int:
        return len(self.run_id)

    @classmethod
    def from_records(cls, records: NDArray[np.void]) -> EventColumns:
        """Copy columns out of an array of `EVENT_DTYPE`."""
        return cls(**{name: np.ascontiguousarray(records[name]) for name in EVENT_DTYPE.names or ()})

    @classmethod
    def empty(cls) -> EventColumns:
        """Return no event."""
        return cls.from_records(np.empty(0, EVENT_DTYPE))

    @classmethod
    def concatenate(cls, parts: Iterable[EventColumns]) -> EventColumns:
        """Join the events of `parts` in order."""
        columns = list(parts) or [cls.empty()]
        return cls(**{name: np.concatenate([getattr(p, name) for p in columns]) for name in EVENT_COLUMNS})

    def take(self, index: NDArray[np.intp] | NDArray[np.bool_]) -> EventColumns:
        """Return the events at `index` (integer positions or a boolean mask)."""
        return EventColumns(**{name: getattr(self, name)[index] for name in EVENT_COLUMNS})


EVENT_COLUMNS = tuple(column.name for column in fields(EventColumns))


Records: TypeAlias = "NDArray[np.void]"
"""One-dimensional array of `EVENT_RECORD_DTYPE`, or of `EVENT_DTYPE` where documented."""

_DATA_AT = RECORD_HEADER.size + MESSAGE_HEADER.size
EVENT_RECORD_BYTES = _DATA_AT + EVENT_CDR_BYTES
"""Length of one event as a Message record, 91 bytes:

offset  type      field
0       uint8     opcode of a Message, 5
1       uint64    length of what follows: 82
9       uint16    channel id
11      uint32    number of the message in its channel (MCAP's `sequence`)
15      uint64    log time
23      uint64    publish time
31      4 bytes   CDR encapsulation
35      56 bytes  the event (`EVENT_DTYPE`)
"""

EVENT_RECORD_DTYPE = np.dtype(
    {
        "names": ["head", "length_top", "channel_id", "number", "times_ns", "cdr_header", "cdr", "event"],
        "formats": ["<u8", "u1", "<u2", "<u4", ("<u8", (2,)), f"V{len(CDR_HEADER)}", "<u2", f"V{EVENT_DTYPE.itemsize}"],
        "offsets": [0, 8, 9, 11, 15, _DATA_AT, _DATA_AT, _DATA_AT + len(CDR_HEADER)],
        "itemsize": EVENT_RECORD_BYTES,
    }
)
"""`head` is the opcode and the seven low bytes of the length, for one comparison; `length_top` the length's last byte;
`times_ns` log and publish time; `cdr` the first half of `cdr_header`.
"""

EVENT_HEAD = Opcode.MESSAGE | (MESSAGE_HEADER.size + EVENT_CDR_BYTES) << 8
"""`head` of every event; `length_top` is 0."""

EVENT_CDR = int.from_bytes(CDR_HEADER[:2], "little")


def fill_constants(records: Records) -> None:
    """Write the fields that are the same for every event."""
    records["head"] = EVENT_HEAD
    records["length_top"] = 0
    records["cdr_header"] = np.void(CDR_HEADER)


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
    """Events of taps (`TapEvent` of docs/trace-format.md) as columns, in file order."""

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
        """Give the events of `Stage.TAP` their names, in the order of the fields; no copy."""
        return cls(*(getattr(events, name) for name in EVENT_COLUMNS))


def event_fault(stage: Stage, encoding: str, schema_name: str | None) -> str | None:
    """Return why a topic's messages are no events of `stage`; a schema that is not known is none."""
    if encoding != "cdr":
        return f"its messages are encoded as {encoding!r}, not 'cdr'"
    is_other = schema_name not in {None, stage.schema_name}
    return f"its schema is {schema_name!r}, not {stage.schema_name!r}" if is_other else None


def hash_content(message: bytes | bytearray | memoryview) -> int:
    """Return the identity of a serialized message, 1 to 2^64 - 1: its encapsulation and padding at the end do not count."""
    digest = blake2b(memoryview(message)[4:], digest_size=8)
    digest.update(bytes(-len(message) % 4))
    return int.from_bytes(digest.digest(), "little") or 1
