"""Submessages of an RTPS packet, from their headers (DDSI-RTPS 2.5, section 9.4), in later IP fragments too."""

from __future__ import annotations

import struct
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

HEADER_BYTES = 20
"""Of an RTPS packet: `RTPS`, version, vendor, and the sender's GUID prefix of 12 bytes at offset 8."""
PREFIX_BYTES = slice(8, 20)

# Submessage kinds (9.4.5.1.1).
PAD, ACKNACK, HEARTBEAT, GAP, INFO_TS = 0x01, 0x06, 0x07, 0x08, 0x09
INFO_SRC, INFO_REPLY_IP4, INFO_DST, INFO_REPLY = 0x0C, 0x0D, 0x0E, 0x0F
NACK_FRAG, HEARTBEAT_FRAG, DATA, DATA_FRAG = 0x12, 0x13, 0x15, 0x16
SECURE_KINDS = frozenset(range(0x30, 0x35))
CONTEXT_KINDS = frozenset((PAD, INFO_TS, INFO_SRC, INFO_REPLY_IP4, INFO_DST, INFO_REPLY))
"""Kinds that describe later submessages and carry nothing by themselves."""

_LITTLE_ENDIAN, _INLINE_QOS = 0x01, 0x02
_SUBMESSAGE_BYTES = 4
_ENTITY = struct.Struct(">I")
_SENTINEL, _MOST_PARAMETERS = 1, 32


class Submessage(NamedTuple):
    """One submessage.

    Attributes:
        sequence: of the sample; of an ACKNACK the first not received.
        fragment: its first fragment, from 1; 0 for a whole sample.
        asks: whether it requests something again (ACKNACK, NACK_FRAG).
        payload_at: index of the serialized sample's first byte, None if it does not begin in this submessage.
    """

    kind: int
    wire_bytes: int
    writer: int = 0
    sequence: int = 0
    fragment: int = 0
    fragments: int = 0
    sample_bytes: int = 0
    asks: bool = False
    payload_at: int | None = None


class Walk(NamedTuple):
    submessages: list[Submessage]
    next_at: int


class _Order(NamedTuple):
    length: struct.Struct
    sequence: struct.Struct
    fragment: struct.Struct
    word: struct.Struct


_ORDERS = {order: _Order(*(struct.Struct(order + fields) for fields in ("H", "iI", "IHHI", "I"))) for order in "<>"}

_Read = Callable[["memoryview", int, int, int, _Order], Submessage]
"""Read a submessage: memory, index of its header, its flags, its length, its byte order."""


def _read_data(memory: memoryview, at: int, flags: int, length: int, order: _Order) -> Submessage:
    high, low = order.sequence.unpack_from(memory, at + 16)
    payload_at = _payload_at(memory, at, flags, length, order)
    sample_bytes = 0 if payload_at is None else at + length - payload_at
    (writer,) = _ENTITY.unpack_from(memory, at + 12)
    return Submessage(DATA, length, writer, (high << 32) + low, 0, 1, sample_bytes, payload_at=payload_at)


def _read_data_frag(memory: memoryview, at: int, flags: int, length: int, order: _Order) -> Submessage:
    high, low = order.sequence.unpack_from(memory, at + 16)
    first, count, size, sample_bytes = order.fragment.unpack_from(memory, at + 24)
    count = min(count, -(-length // max(size, 1)))  # no more than there is room for
    (writer,) = _ENTITY.unpack_from(memory, at + 12)
    payload_at = _payload_at(memory, at, flags, length, order) if first == 1 else None
    return Submessage(DATA_FRAG, length, writer, (high << 32) + low, first, count, sample_bytes, payload_at=payload_at)


def _read_numbered(memory: memoryview, at: int, flags: int, length: int, order: _Order) -> Submessage:
    del flags
    (writer,) = _ENTITY.unpack_from(memory, at + 8)
    high, low = order.sequence.unpack_from(memory, at + 12)
    return Submessage(memory[at], length, writer, (high << 32) + low)


def _read_acknack(memory: memoryview, at: int, flags: int, length: int, order: _Order) -> Submessage:
    submessage = _read_numbered(memory, at, flags, length, order)
    (bits,) = order.word.unpack_from(memory, at + 20)
    return submessage._replace(asks=bits > 0)


_READERS: dict[int, tuple[_Read, int]] = {
    # kind -> reader, and bytes that it needs, header included
    DATA: (_read_data, 24),
    DATA_FRAG: (_read_data_frag, 36),
    HEARTBEAT: (_read_numbered, 28),
    HEARTBEAT_FRAG: (_read_numbered, 24),
    GAP: (_read_numbered, 20),
    ACKNACK: (_read_acknack, 24),
    NACK_FRAG: (lambda *head: _read_numbered(*head)._replace(asks=True), 28),
}
_PLAIN: tuple[_Read, int] = (
    lambda memory, at, _flags, length, _order: Submessage(memory[at], length),
    _SUBMESSAGE_BYTES,
)
LONGEST_FIELDS_BYTES = max(needed for _, needed in _READERS.values())


def walk_submessages(memory: memoryview, at: int, seen_end: int, end: int) -> Walk:
    """Read the submessages from `at` to `seen_end`; the packet's `end` may be later."""
    submessages: list[Submessage] = []
    memory = memory[:seen_end]  # the next bytes of a ring belong to another packet
    while at + _SUBMESSAGE_BYTES <= seen_end:
        kind, flags = memory[at], memory[at + 1]
        order = _ORDERS["<" if flags & _LITTLE_ENDIAN else ">"]
        (length,) = order.length.unpack_from(memory, at + 2)
        if length == 0 and kind not in (PAD, INFO_TS):
            length = end - at - _SUBMESSAGE_BYTES  # up to the packet's end (9.4.5.1.3)
        length += _SUBMESSAGE_BYTES
        read, needed = _READERS.get(kind, _PLAIN)
        if length < needed or at + length > end:  # not RTPS: the rest of the packet is one unknown submessage
            submessages.append(Submessage(0, end - at))
            return Walk(submessages, end)
        if at + needed > seen_end:
            break
        submessages.append(read(memory, at, flags, length, order))
        at += length
    return Walk(submessages, at)


def _payload_at(memory: memoryview, at: int, flags: int, length: int, order: _Order) -> int | None:
    position = at + 8 + order.length.unpack_from(memory, at + 6)[0]
    if flags & _INLINE_QOS:
        for _ in range(_MOST_PARAMETERS):
            if position + 4 > min(at + length, len(memory)):
                return None
            (parameter,) = order.length.unpack_from(memory, position)
            (size,) = order.length.unpack_from(memory, position + 2)
            position += 4 if parameter == _SENTINEL else 4 + size
            if parameter == _SENTINEL:
                break
        else:
            return None
    return position if position <= at + length else None


REMEMBERED_DATAGRAMS = 4096

Owner = TypeVar("Owner")


class Piece(NamedTuple):
    """A later fragment: its offset in the datagram, and where it begins and ends in `memory` (captured, and on the wire)."""

    offset: int
    memory: memoryview
    begin: int
    end: int
    wire_end: int
    is_last: bool


@dataclass(slots=True)
class _Datagram(Generic[Owner]):
    """An unfinished datagram; `next_at` is -1 if its next header is lost, `carried` the part of it seen."""

    owner: Owner
    length: int
    next_at: int
    carried: bytes


class FragmentTable(Generic[Owner]):
    """Datagrams by what their fragments share; in `lost_trails` of them a header was lost with a fragment."""

    def __init__(self) -> None:
        self.lost_trails = 0
        self._datagrams: dict[Hashable, _Datagram[Owner]] = {}

    def begin(self, key: Hashable, owner: Owner, length: int = 0, next_at: int = -1, carried: bytes = b"") -> None:
        self._datagrams.pop(key, None)  # a reused identification becomes the newest
        if len(self._datagrams) >= REMEMBERED_DATAGRAMS:
            self._datagrams.pop(next(iter(self._datagrams)))
        self._datagrams[key] = _Datagram(owner, length, next_at, carried)

    def continue_with(self, key: Hashable, piece: Piece) -> tuple[Owner, list[Submessage]] | None:
        datagram = self._datagrams.get(key)
        if datagram is None:
            return None
        submessages = self._walk(datagram, piece)
        if piece.is_last:
            del self._datagrams[key]
        return datagram.owner, submessages

    def _walk(self, datagram: _Datagram[Owner], piece: Piece) -> list[Submessage]:
        piece_end = piece.offset + piece.wire_end - piece.begin
        if datagram.next_at < 0 or datagram.next_at >= piece_end:
            return []
        if datagram.next_at + len(datagram.carried) != piece.offset and datagram.next_at < piece.offset:
            datagram.next_at = -1
            self.lost_trails += 1
            return []
        submessages = self._walk_seam(datagram, piece) if datagram.carried else []
        if datagram.next_at >= piece.offset:
            at = piece.begin + datagram.next_at - piece.offset
            walk = walk_submessages(piece.memory, at, piece.end, piece.begin + datagram.length - piece.offset)
            submessages += walk.submessages
            datagram.next_at = piece.offset + walk.next_at - piece.begin
            datagram.carried = bytes(piece.memory[walk.next_at : piece.end])
        return submessages

    @staticmethod
    def _walk_seam(datagram: _Datagram[Owner], piece: Piece) -> list[Submessage]:
        head = bytes(piece.memory[piece.begin : min(piece.end, piece.begin + LONGEST_FIELDS_BYTES)])
        seam = datagram.carried + head
        walk = walk_submessages(memoryview(seam), 0, len(seam), datagram.length - datagram.next_at)
        first = walk.submessages[:1]  # longer than what was carried; the walk over the fragment finds the next
        datagram.next_at += sum(submessage.wire_bytes for submessage in first)
        datagram.carried = b""
        return [submessage._replace(payload_at=None) for submessage in first]  # it would be an index of `seam`
