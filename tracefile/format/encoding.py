"""Framing of MCAP records (https://mcap.dev/spec), and `std_msgs/msg/String` as CDR."""

from __future__ import annotations

import struct

MAGIC = b"\x89MCAP0\r\n"
"""First and last bytes of a file."""

RECORD_HEADER = struct.Struct("<BQ")
"""Opcode of a record, length of the content."""

MESSAGE_HEADER = struct.Struct("<HIQQ")
"""Start of a Message record: channel id, sequence, log time and publish time (ns)."""

MESSAGE_FIELDS = {"sequence": 2, "log_time": 6, "publish_time": 14}
"""Their offsets."""

STRING_SCHEMA_NAME = "std_msgs/msg/String"
STRING_DEFINITION = "string data\n"

CDR_HEADER = b"\x00\x01\x00\x00"
"""XCDR1 in little-endian byte order, which we write."""

_LENGTHS = {b"\x00\x00": struct.Struct(">4xI"), b"\x00\x01": struct.Struct("<4xI")}
"""Representation of XCDR1 -> encapsulation and length of a string in that byte order."""

_TEXT_AT = len(CDR_HEADER) + 4


def encode_string(text: str) -> bytes:
    data = text.encode() + b"\0"
    return CDR_HEADER + struct.pack("<I", len(data)) + data


def decode_string(data: bytes | memoryview) -> str:
    """Return the text of a String message of either byte order; bytes after it are ignored."""
    length = _LENGTHS.get(bytes(data[:2]))
    size = length.unpack_from(data)[0] if length is not None and len(data) >= _TEXT_AT else 0
    if not 1 <= size <= len(data) - _TEXT_AT:
        raise ValueError(f"no serialized {STRING_SCHEMA_NAME}")
    try:
        return bytes(data[_TEXT_AT : _TEXT_AT + size - 1]).decode()
    except UnicodeDecodeError as err:
        raise ValueError(f"no UTF-8 text ({err})") from err
