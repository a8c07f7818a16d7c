"""IP fragments: the datagram of a later fragment, and RTPS headers in it."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

from .rtps import LONGEST_FIELDS_BYTES, Submessage, walk_submessages

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
    """Datagrams by what their fragments have in common: addresses, identification, direction.

    Attributes:
        lost_trails: datagrams in which a submessage header was not seen, as a fragment was missing or out of order.
    """

    def __init__(self) -> None:
        self.lost_trails = 0
        self._datagrams: dict[Hashable, _Datagram[Owner]] = {}

    def begin(self, key: Hashable, owner: Owner, datagram_bytes: int, next_at: int, carried: bytes = b"") -> None:
        self._datagrams.pop(key, None)  # a reused identification becomes the newest
        if len(self._datagrams) >= REMEMBERED_DATAGRAMS:
            self._datagrams.pop(next(iter(self._datagrams)))
        self._datagrams[key] = _Datagram(owner, datagram_bytes, next_at, carried)

    def continue_with(self, key: Hashable, piece: Piece) -> tuple[Owner, list[Submessage]] | None:
        """Return the datagram's owner and the submessages that begin in this fragment; None if its first is unknown."""
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
        # What begins within this fragment is left to the walk over the fragment itself.
        submessages, at = [], 0
        for submessage in walk.submessages:
            if at >= len(datagram.carried):
                break
            submessages.append(submessage._replace(payload_at=None))  # it would be an index of `seam`
            at += submessage.wire_bytes
        datagram.next_at += at
        datagram.carried = b""
        return submessages
