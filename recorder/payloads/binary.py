"""Binary data: a `sensor_msgs/msg/Image` of one row of bytes, random ones, which no layer can compress, or the files of `file:PATH`."""

from __future__ import annotations

import os
import random
import struct
import threading
from collections.abc import Iterable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import BinaryIO

from dds_trace.base.errors import OptionError
from dds_trace.base.files import open_regular
from dds_trace.base.limits import MAX_PAYLOAD_BYTES

from ..backends.node import RawMessage, RosMessage
from .base import MOST_PADDING_BYTES, DataType, Form, Message, Payload, Source, check_size, check_stop
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
    padding = len(message) - (data_offset + data_bytes)
    return int(data_bytes) if 0 <= padding <= MOST_PADDING_BYTES else 0


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


def load_payload(where: str, stop: threading.Event | None = None) -> Payload:
    path = Path(where)
    try:
        files = _files(path)
        check_size(sum(file.stat().st_size for file in files), path)
        messages = tuple(_message(file, stop) for file in files)
    except OSError as err:
        raise OptionError(f"--data file:{where}: {err.strerror or err}; name a file or a folder of files") from err
    return Payload(BINARY, messages, max(message.payload_bytes for message in messages), source=f"file:{where}")


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    files = sorted(file for file in path.iterdir() if file.is_file() and not file.name.startswith("."))
    if not files:
        raise OptionError(f"--data file:{path}: the folder has no files")
    return files


def _message(file: Path, stop: threading.Event | None) -> Message:
    with open_regular(file) as stream:
        size = os.fstat(stream.fileno()).st_size
        check_size(size, file)
        if not size:
            raise OptionError(f"--data file:{file}: the file is empty; name one with content")
        return image_message(size, _pieces(stream, size, stop))


def _pieces(stream: BinaryIO, size: int, stop: threading.Event | None) -> Iterator[bytes]:
    while size:
        check_stop(stop)
        piece = stream.read(min(_PIECE_BYTES, size))
        if not piece:
            raise OSError("the file became shorter while it was read")
        size -= len(piece)
        yield piece


def check_path(where: str) -> None:
    if not where or "\0" in where:
        raise OptionError(f"--data file:{where}: write file:PATH, a file or a folder of files")


FILE = Source(
    name="file",
    usage="file:PATH",
    open=lambda where, context: nullcontext(load_payload(where, context.stop)),
    check=check_path,
)
