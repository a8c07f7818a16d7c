"""A writer of the few CDR layouts that payloads need, so that a backend without ROS sends the same bytes."""

from __future__ import annotations

import itertools
import struct
from typing import TYPE_CHECKING

from dds_trace.tracefile.format.string_cdr import CDR_HEADER

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


class CdrWriter:
    """A serialized message in little-endian XCDR1, in the order of the calls; alignment counts from behind the encapsulation."""

    def __init__(self) -> None:
        self._data = bytearray(CDR_HEADER)

    def _align(self, size: int) -> None:
        self._data += bytes(-(len(self._data) - len(CDR_HEADER)) % size)

    def uint8(self, value: int) -> None:
        """Append one byte."""
        self._data.append(value)

    def uint32(self, value: int) -> None:
        """Append four bytes, aligned to four."""
        self._align(4)
        self._data += struct.pack("<I", value)

    def float64s(self, values: Sequence[float]) -> None:
        """Append a fixed array of doubles, aligned to eight."""
        self._align(8)
        self._data += struct.pack(f"<{len(values)}d", *values)

    def string(self, text: bytes, more_bytes: int = 0, more: Iterable[bytes] = ()) -> None:
        """Append the length with the terminating zero, the characters of `text` and of `more`, and the zero."""
        self.pieces(len(text) + more_bytes + 1, itertools.chain((text,), more))
        self._data += b"\0"

    def octets(self, data: bytes) -> None:
        """Append a sequence of bytes: its length, then the bytes."""
        self.pieces(len(data), (data,))

    def pieces(self, size: int, pieces: Iterable[bytes]) -> None:
        """Append a sequence of `size` bytes that comes in pieces, so that a large one is held once."""
        self.uint32(size)
        for piece in pieces:
            self._data += piece

    def header(self, frame_id: bytes) -> None:
        """Append a `std_msgs/Header` whose stamp is zero."""
        self.uint32(0)
        self.uint32(0)
        self.string(frame_id)

    def message(self) -> bytearray:
        """Return the whole serialized message."""
        return self._data
