"""Text: a `std_msgs/msg/String`, the stamp and then random letters and digits."""

from __future__ import annotations

import random
import string
import struct
import threading
from collections.abc import Iterator

from dds_trace.base.errors import OptionError
from dds_trace.base.limits import MAX_PAYLOAD_BYTES

from ..backends.node import RawMessage, RosMessage
from ..backends.sizes import text_bytes
from .base import MOST_PADDING_BYTES, DataType, Form, Message, Payload, check_stop, sized_by_length
from .cdr import CdrWriter
from .stamp import RAW_STRING_STAMP, STAMP_BYTES, STRING_STAMP, stamp_text

PAPER_BYTES = (4, 91, 1405, 2675)
DEFAULT_BYTES = PAPER_BYTES[1]
MAX_BYTES = MAX_PAYLOAD_BYTES  # fits in the length of `data`
_ALPHABET = (string.ascii_letters + string.digits).encode()
_PIECE_BYTES = 1 << 20
_UINT32 = struct.Struct("<I")


def make_payload(size_bytes: int | None, seed: int, stop: threading.Event | None = None, /) -> Payload:
    """Make up `size_bytes` characters after the stamp (91 by default; the paper's: 4, 91, 1405, 2675)."""
    size = DEFAULT_BYTES if size_bytes is None else size_bytes
    if not 0 <= size <= MAX_BYTES:
        raise OptionError(f"--size {size}: a string payload has 0 to {MAX_BYTES} bytes")
    writer = CdrWriter()
    writer.string(stamp_text(0, 0), size, _letters(size, seed, stop))
    return Payload(STRING, (Message(writer.message(), size),), size)


def _letters(size: int, seed: int, stop: threading.Event | None) -> Iterator[bytes]:
    """Yield `random.Random(seed).choices(alphabet, k=size)` ten times as fast: numpy draws the same numbers."""
    import numpy as np  # noqa: PLC0415 - the help of every command loads this module without numpy

    alphabet = np.frombuffer(_ALPHABET, np.uint8)
    *words, position = random.Random(seed).getstate()[1]  # noqa: S311 - reproducible noise, no secret
    draw = np.random.RandomState()
    draw.set_state(("MT19937", np.array(words, np.uint32), position, 0, 0.0))
    for start in range(0, size, _PIECE_BYTES):
        check_stop(stop)
        indices = draw.random_sample(min(_PIECE_BYTES, size - start)) * len(alphabet)
        yield alphabet[indices.astype(np.intp)].tobytes()


def payload_bytes_of(message: RawMessage) -> int:
    (length,) = _UINT32.unpack_from(message, 4)
    if not STAMP_BYTES < length <= len(message) - 8:
        raise ValueError("the string is longer than its message")
    surplus = len(message) - 8 - length
    return int(length) - 1 - STAMP_BYTES + (surplus if surplus > MOST_PADDING_BYTES else 0)


def object_bytes_of(message: RosMessage) -> int:
    return text_bytes(message.data) - STAMP_BYTES


STRING = DataType(
    name="string",
    topic="string_data",
    type_name="std_msgs/msg/String",
    raw=Form(RAW_STRING_STAMP, payload_bytes_of, sized_by_length),
    objects=Form(STRING_STAMP, object_bytes_of),
    object_stamp=STRING_STAMP,
    make=make_payload,
)
