"""MCAP's framing, the same for every record of every file (https://mcap.dev/spec): magic bytes, headers, checksum."""

from __future__ import annotations

import struct

try:  # a fifth of the time of reading lz4 is this checksum, and isal's is four times as fast
    from isal.isal_zlib import crc32
except ImportError:  # a device that only records, or a platform without a wheel of it
    from zlib import crc32

__all__ = ["MAGIC", "MESSAGE_HEADER", "RECORD_HEADER", "crc32"]

MAGIC = b"\x89MCAP0\r\n"
"""First and last bytes of a file."""

RECORD_HEADER = struct.Struct("<BQ")
"""Opcode of a record, length of the content that follows."""

MESSAGE_HEADER = struct.Struct("<HIQQ")
"""Channel id, sequence, log time and publish time (ns): what a Message record's content begins with."""
