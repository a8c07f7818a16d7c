r"""The ring file: events that are not yet in the trace, in memory that outlives the process.

`NAME.mcap.ring` is next to `NAME.mcap` until a clean close. The mapping is shared with the page cache, so that a killed
process loses no packed event. All numbers are little-endian:

    offset  type      field
    0       8 bytes   magic b"DDSRING\n", written last: a ring without it holds no event yet
    8       uint32    version of this layout: 1
    12      uint32    bytes of a slot: 64
    16      uint64    slots
    24      uint64    offset of the first slot, a multiple of 4096
    32      uint64    events dropped so far because no slot was free
    40      uint64    bytes of the JSON text
    48      UTF-8     {"format": 1, "session": {...}, "topics": {"1": "/dds_trace/t1", ...}}

A slot is one event and its mark:

    0       56 bytes  the event without its CDR header (`EVENT_DTYPE`)
    56      uint64    ticket + (stage << 56); stage 1..5, the key of its topic

Tickets number the events of a session: 0, 1, 2 ... Ticket t is in slot t modulo slots. The packer zeroes a slot first and
stores the mark last, so a slot is an event exactly if its mark has a stage and a ticket that belongs there. `stamp` and
`expect` pack an event before its time is known; time and mark follow in two stores. Events go to the trace in order of
their tickets, in whole chunks: if the complete chunks of the trace have n events, these are tickets 0..n-1, and the ring
adds every ticket from n on: a kill neither doubles nor loses an event.

A mark is believed if its ticket is below 2^40 and the event's run is not 0. A kill leaves every slot whole, and a power loss
every sector of eight slots, old or new; garbage has such a mark once in 10^11 slots. A bit that a disk flips within an
event is not noticed: a CRC per slot would double the time of packing (0.55 to 1.15 us).
"""

from __future__ import annotations

import fcntl
import json
import mmap
import os
import struct
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.files import OWNER_AND_GROUP, is_locked, open_regular

from .descriptions import Session
from .events import EVENT_DTYPE, Stage

RING_SUFFIX = ".ring"
RING_MAGIC = b"DDSRING\n"
RING_VERSION = 1
"""Version 1: first version (2026)."""

RING_HEADER = struct.Struct("<8sIIQQQQ")
DROPPED_AT = 32
"""Offset of the number of dropped events."""

MOST_RING_BYTES = 1 << 28
"""Largest ring that is read: four million events."""

SLOT_BYTES = 64
SLOT_STRUCT = struct.Struct("<QQqqqqIIQ")
"""A slot as it is packed: the event's eight fields, then the mark."""

SLOT_PAIR_STRUCT = struct.Struct("<QQqqqqIIQQQqqqqIIQ")
"""Two adjacent slots."""

SLOT_WORDS = SLOT_BYTES // 8
TIME_WORD, SOURCE_WORD, RECEIVED_WORD, MARK_WORD = 2, 4, 5, 7
"""Indices of monotonic time, the middleware's two times and mark among a slot's words."""

SLOT_DTYPE = np.dtype(
    {
        "names": ["event", "run_id", "monotonic_ns", "mark", "stage"],
        "formats": [f"V{EVENT_DTYPE.itemsize}", "<u8", "<i8", "<u8", "u1"],
        "offsets": [0, 0, 16, 56, 63],
        "itemsize": SLOT_BYTES,
    }
)
"""A slot as it is read: event, parts of it (run and monotonic time), the mark, and the mark's stage byte."""

STAGE_MARKS = (0, *(number << 56 for number in range(1, len(Stage) + 1)))
"""By the stage's number, what a slot's mark adds to the ticket."""

TICKET_MASK = np.uint64((1 << 56) - 1)  # numpy 1 mixes no Python int with a single uint64
_TICKETS = np.uint64(1 << 40)
"""More events than a session records or drops: twelve days at a million a second."""

STAGE_NUMBERS = dict(enumerate(Stage, start=1))
"""Number in slots, and of the channel in our files -> stage."""

Slots: TypeAlias = "NDArray[np.void]"
"""One-dimensional array of `SLOT_DTYPE`."""


def ring_path(trace: Path) -> Path:
    """Return the path of a trace's ring."""
    return trace.with_name(trace.name + RING_SUFFIX)


def events_by_stage(slots: Slots) -> list[tuple[Stage, NDArray[np.void]]]:
    """Return the events of each stage that has some, as arrays of `EVENT_DTYPE`."""
    parts = [(stage, slots["event"][slots["stage"] == number]) for number, stage in STAGE_NUMBERS.items()]
    return [(stage, np.frombuffer(events.tobytes(), EVENT_DTYPE)) for stage, events in parts if len(events)]


class Ring:
    """Ring that this process writes, in a new file.

    Attributes:
        memory: the mapped file, to pack into (0.1 us faster than a memoryview of it).
        words: the slots as int64 (little-endian on every ROS 2 machine), stored in a third of the time of a `struct`.
    """

    __slots__ = ("_descriptor", "memory", "path", "slots", "slots_at", "words")

    def __init__(self, path: Path, slot_count: int, session: Session, *, mode: int = OWNER_AND_GROUP) -> None:
        self.path = path
        text = json.dumps(
            {
                "format": RING_VERSION,
                "session": json.loads(session.to_json()),
                "topics": {str(number): stage.topic for number, stage in STAGE_NUMBERS.items()},
            }
        ).encode()
        slots_at = -(-(RING_HEADER.size + len(text)) // mmap.PAGESIZE) * mmap.PAGESIZE
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
        try:
            with suppress(OSError):  # a file system without locks: recovery cannot see that this process lives
                fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            _fill(self._descriptor, slots_at + slot_count * SLOT_BYTES)
            self.memory = mmap.mmap(self._descriptor, 0)
        except OSError:
            os.close(self._descriptor)
            path.unlink(missing_ok=True)
            raise
        header = RING_HEADER.pack(b"", RING_VERSION, SLOT_BYTES, slot_count, slots_at, 0, len(text))
        self.memory[: len(header)] = header
        self.memory[RING_HEADER.size : RING_HEADER.size + len(text)] = text
        self.memory[: len(RING_MAGIC)] = RING_MAGIC
        self.slots_at = slots_at
        self.slots: Slots = np.frombuffer(self.memory, SLOT_DTYPE, slot_count, slots_at)
        self.words = memoryview(self.memory)[slots_at : slots_at + slot_count * SLOT_BYTES].cast("q")

    def pending(self, first: int, end: int) -> Slots:
        """Return the slots of tickets `first` up to `end`, or fewer if the ring wraps around; no copy."""
        start = first % len(self.slots)
        return self.slots[start : min(start + end - first, len(self.slots))]

    def note_dropped(self, dropped: int) -> None:
        """Write the number of dropped events into the header."""
        struct.pack_into("<Q", self.memory, DROPPED_AT, dropped)

    def close(self, *, delete: bool) -> None:
        """Unmap the ring; `delete` its file if every event is in the trace."""
        self.slots = self.slots[:0].copy()
        self.words.release()
        with suppress(BufferError):  # the traceback of a failed write may still refer to the slots
            self.memory.close()
        if delete:
            self.path.unlink(missing_ok=True)
        os.close(self._descriptor)


def _fill(descriptor: int, size: int) -> None:
    """Write `size` zeros: a mapped page without a block kills the process (SIGBUS) when the disk is full."""
    zeros = bytes(1 << 20)
    while size > 0:
        size -= os.write(descriptor, zeros[:size])


@dataclass(frozen=True, slots=True, eq=False)
class RingContents:
    """Content of a ring file that its trace does not have.

    Attributes:
        slots: array of `SLOT_DTYPE` by ticket.
        missing_events: tickets in neither file before the ring's last; only a power failure loses any.
        fault: damage of the header that costs no event, or None.
    """

    session: Session
    slots: Slots
    missing_events: int
    dropped_events: int
    recording: bool
    fault: str | None = None


def read_ring(path: Path, events_in_trace: int) -> RingContents | None:
    """Read the events that a ring (`ring_path(trace)`) has and its trace has not; None if it was killed before it was complete.

    `events_in_trace` sums, over the event topics, the highest MCAP sequence plus one in the complete chunks of the trace, which
    a damaged chunk in the middle does not change.
    """
    content, recording = _read(path)
    if len(content) < RING_HEADER.size or not any(content[: len(RING_MAGIC)]):
        return None
    magic, version, slot_bytes, slot_count, slots_at, dropped, text_bytes = RING_HEADER.unpack_from(content)
    if magic != RING_MAGIC:
        raise TraceFormatError(path, "this is not a ring file of dds-trace")
    if version != RING_VERSION or slot_bytes != SLOT_BYTES:
        raise TraceFormatError(path, f"ring of version {version}, this version reads {RING_VERSION}; update dds-trace")
    if len(content) < slots_at + slot_count * SLOT_BYTES or RING_HEADER.size + text_bytes > slots_at:
        raise TraceFormatError(path, "the ring file is shorter than its header says")
    session = _session(content[RING_HEADER.size : RING_HEADER.size + text_bytes], path)
    slots = np.frombuffer(content, SLOT_DTYPE, slot_count, slots_at)
    return _pending(slots, slot_count, events_in_trace, session, dropped, recording=recording)


def salvage_ring(path: Path, events_in_trace: int, session: Session | None) -> RingContents | None:
    """Read what is whole of a ring that `read_ring` refuses: one that was cut off, or with a damaged description.

    `session` is the trace's, for a ring that has none. Return None if that or the offset of the slots is unknown.
    """
    try:
        content, recording = _read(path)
    except TraceFormatError:
        return None
    if len(content) < RING_HEADER.size:
        return None
    _, version, slot_bytes, slot_count, slots_at, dropped, text_bytes = RING_HEADER.unpack_from(content)
    if (version, slot_bytes) != (RING_VERSION, SLOT_BYTES) or not 0 < slots_at <= len(content):
        return None
    try:
        session = _session(content[RING_HEADER.size : min(RING_HEADER.size + text_bytes, slots_at)], path)
    except TraceFormatError:
        if session is None:
            return None
    whole = min(slot_count, (len(content) - slots_at) // SLOT_BYTES)
    slots = np.frombuffer(content, SLOT_DTYPE, whole, slots_at)
    return _pending(slots, slot_count, events_in_trace, session, dropped, recording=recording)


def is_recorded(trace: Path) -> bool:
    """Return whether a living recorder has the trace's ring."""
    try:
        with open_regular(ring_path(trace)) as stream:
            return is_locked(stream.fileno())
    except OSError:
        return False


def _read(path: Path) -> tuple[bytes, bool]:
    """Return a ring's bytes, and whether a living recorder has it open."""
    with open_regular(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        if size > MOST_RING_BYTES:
            raise TraceFormatError(path, f"has {size} bytes, more than any ring of dds-trace; it was not read")
        recording = is_locked(stream.fileno())  # before its content: a recorder may end meanwhile
        return stream.read(), recording


def _pending(
    slots: Slots, slot_count: int, events_in_trace: int, session: Session, dropped: int, *, recording: bool
) -> RingContents:
    tickets = slots["mark"] & TICKET_MASK
    is_event = (slots["stage"] >= 1) & (slots["stage"] <= len(Stage))
    is_event &= (tickets < _TICKETS) & (slots["run_id"] != 0)
    is_event &= tickets % max(slot_count, 1) == np.arange(len(slots), dtype=np.uint64)
    pending = np.flatnonzero(is_event & (tickets >= events_in_trace))
    pending = pending[np.argsort(tickets[pending])]
    end = int(tickets[pending[-1]]) + 1 if len(pending) else events_in_trace
    return RingContents(
        session=session,
        slots=slots[pending],
        missing_events=end - events_in_trace - len(pending),
        dropped_events=dropped if dropped < _TICKETS else 0,
        recording=recording,
        fault=None if dropped < _TICKETS else "its number of dropped events is damaged",
    )


def _session(text: bytes, path: Path) -> Session:
    try:
        described = json.loads(text)["session"]
    except (ValueError, KeyError, TypeError, RecursionError) as err:
        raise TraceFormatError(path, f"the ring's header names no session ({err})", RING_HEADER.size) from err
    return Session.from_json(json.dumps(described), path)
