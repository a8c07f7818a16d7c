"""Binary data: a `sensor_msgs/msg/Image` of one row of random bytes, which no layer can compress."""

from __future__ import annotations

import random
import struct
import threading
from collections.abc import Iterable, Iterator

from dds_trace.base.errors import OptionError
from dds_trace.base.limits import MAX_PAYLOAD_BYTES

from ..backends.node import RawMessage, RosMessage
from .base import DataType, Form, Message, Payload, check_stop
from .cdr import CdrWriter
from .stamp import HEADER_STAMP, RAW_HEADER_STAMP, stamp_text

DEFAULT_BYTES = 33_000
MAX_BYTES = MAX_PAYLOAD_BYTES  # within the four bytes of width, step and the length of `data`
_PIECE_BYTES = 1 << 20  # a multiple of four, so that pieces equal one draw
_UINT32 = struct.Struct("<I")
_ENCODING_OFFSET = 72
"""Offset of the encoding's length: encapsulation 4, time 8, frame_id with our stamp 4 + 47 + 1, height 4, width 4."""


def make_payload(size_bytes: int | None, seed: int, stop: threading.Event | None = None, /) -> Payload:
    size = DEFAULT_BYTES if size_bytes is None else size_bytes
    if not 1 <= size <= MAX_BYTES:
        raise OptionError(f"--size {size}: a binary payload has 1 to {MAX_BYTES} bytes")
    return Payload(BINARY, (image_message(size, _noise(size, seed, stop)),), size)


def _noise(size: int, seed: int, stop: threading.Event | None) -> Iterator[bytes]:
    """Yield `random.Random(seed).randbytes(size)` in pieces: one draw is limited to 256 MiB."""
    draw = random.Random(seed)  # noqa: S311 - reproducible noise, no secret
    for begin in range(0, size, _PIECE_BYTES):
        check_stop(stop)
        yield draw.randbytes(min(_PIECE_BYTES, size - begin))


def image_message(size: int, pieces: Iterable[bytes]) -> Message:
    writer = CdrWriter()
    writer.header(stamp_text(0, 0))
    writer.uint32(1)  # height
    writer.uint32(size)  # width
    writer.string(b"mono8")
    writer.uint8(0)  # is_bigendian
    writer.uint32(size)  # step
    writer.pieces(size, pieces)
    return Message(writer.message(), size)


def payload_bytes_of(message: RawMessage) -> int:
    try:
        data_offset = sizing_bytes_of(message)
        (data_bytes,) = _UINT32.unpack_from(message, data_offset - 4)
    except struct.error:
        return 0
    padding = len(message) - (data_offset + data_bytes)  # some vendors pad to four bytes
    return int(data_bytes) if 0 <= padding < 4 else 0


def sizing_bytes_of(message: RawMessage) -> int:
    (encoding_bytes,) = _UINT32.unpack_from(message, _ENCODING_OFFSET)
    step_offset = _ENCODING_OFFSET + 4 + encoding_bytes + 1  # is_bigendian is one byte
    return int(step_offset + -step_offset % 4 + 8)


def object_bytes_of(message: RosMessage) -> int:
    return len(message.data)


BINARY = DataType(
    name="binary",
    topic="binary_image",
    type_name="sensor_msgs/msg/Image",
    raw=Form(RAW_HEADER_STAMP, payload_bytes_of, sizing_bytes_of),
    objects=Form(HEADER_STAMP, object_bytes_of),
    object_stamp=HEADER_STAMP,
    make=make_payload,
)
