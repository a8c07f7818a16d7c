"""Writes CDR, so that a backend without ROS sends the same bytes."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Iterable, Sequence

from dds_trace.tracefile.format.encoding import CDR_HEADER


class CdrWriter:
    """A serialized message in little-endian XCDR1; alignment counts from the end of the encapsulation."""

    def __init__(self) -> None:
        self._data = bytearray(CDR_HEADER)

    def _align(self, size: int) -> None:
        self._data += bytes(-(len(self._data) - len(CDR_HEADER)) % size)

    def uint8(self, value: int) -> None:
        self._data.append(value)

    def uint32(self, value: int) -> None:
        self._align(4)
        self._data += struct.pack("<I", value)

    def float64s(self, values: Sequence[float]) -> None:
        self._align(8)
        self._data += struct.pack(f"<{len(values)}d", *values)

    def string(self, text: bytes, more_bytes: int = 0, more: Iterable[bytes] = ()) -> None:
        self.pieces(len(text) + more_bytes + 1, itertools.chain((text,), more))
        self._data += b"\0"

    def octets(self, data: bytes) -> None:
        self.pieces(len(data), (data,))

    def pieces(self, size: int, pieces: Iterable[bytes]) -> None:
        """Append a sequence of `size` bytes in pieces: a large one is in memory once."""
        self.uint32(size)
        for piece in pieces:
            self._data += piece

    def header(self, frame_id: bytes) -> None:
        self.uint32(0)
        self.uint32(0)
        self.string(frame_id)

    def message(self) -> bytearray:
        return self._data
