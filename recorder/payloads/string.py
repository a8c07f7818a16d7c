"""Text: a `std_msgs/msg/String`, the stamp and then random letters and digits."""

from __future__ import annotations

import random
import string
import struct
from typing import TYPE_CHECKING

from dds_trace.tracefile import OptionError

from .base import DataType, Form, Message, Payload
from .cdr import CdrWriter
from .stamp import RAW_STRING_STAMP, STAMP_BYTES, STRING_STAMP, stamp_text

if TYPE_CHECKING:
    from ..backends.node import RawMessage, RosMessage

PAPER_BYTES = (4, 91, 1405, 2675)
DEFAULT_BYTES = PAPER_BYTES[1]
MAX_BYTES = (1 << 32) - 2 - STAMP_BYTES  # the length of `data` is uint32 and counts a terminating zero
_ALPHABET = (string.ascii_letters + string.digits).encode()
_UINT32 = struct.Struct("<I")


def make_payload(size_bytes: int | None, seed: int) -> Payload:
    """Make up one string of `size_bytes` characters behind the stamp (91 by default; the paper's: 4, 91, 1405, 2675).

    Raises:
        OptionError: a string cannot have that size.
    """
    size = DEFAULT_BYTES if size_bytes is None else size_bytes
    if not 0 <= size <= MAX_BYTES:
        raise OptionError(f"--size {size}: a string payload has 0 to {MAX_BYTES} bytes")
    letters = bytes(random.Random(seed).choices(_ALPHABET, k=size))  # noqa: S311 - reproducible noise, no secret
    writer = CdrWriter()
    writer.string(stamp_text(0, 0) + letters)
    return Payload(STRING, (Message(writer.message(), size),), size)


def payload_bytes_of(message: RawMessage) -> int:
    """Return the number of characters behind the stamp in a serialized string."""
    (length,) = _UINT32.unpack_from(message, 4)
    return int(length) - 1 - STAMP_BYTES


def object_bytes_of(message: RosMessage) -> int:
    """Return the number of characters behind the stamp of a string object."""
    return len(message.data) - STAMP_BYTES


STRING = DataType(
    name="string",
    topic="string_data",
    type_name="std_msgs/msg/String",
    raw=Form(RAW_STRING_STAMP, payload_bytes_of),
    objects=Form(STRING_STAMP, object_bytes_of),
    object_stamp=STRING_STAMP,
    make=make_payload,
)
