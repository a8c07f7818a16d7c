"""A writer of the few CDR layouts that payloads need, so that a backend without ROS sends the same bytes."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from dds_trace.tracefile import CDR_HEADER

if TYPE_CHECKING:
    from collections.abc import Sequence


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

    def string(self, text: bytes) -> None:
        """Append the length with the terminating zero, the characters, and the zero."""
        self.uint32(len(text) + 1)
        self._data += text + b"\0"

    def octets(self, data: bytes) -> None:
        """Append a sequence of bytes: its length, then the bytes."""
        self.uint32(len(data))
        self._data += data

    def header(self, frame_id: bytes) -> None:
        """Append a `std_msgs/Header` whose stamp is zero."""
        self.uint32(0)
        self.uint32(0)
        self.string(frame_id)

    def message(self) -> bytearray:
        """Return the whole serialized message."""
        return self._data
