"""MCAP's framing, the same for every record of every file (https://mcap.dev/spec)."""

from __future__ import annotations

import struct

MAGIC = b"\x89MCAP0\r\n"
"""First and last bytes of a file."""

RECORD_HEADER = struct.Struct("<BQ")
"""Opcode of a record, length of the content that follows."""

MESSAGE_HEADER = struct.Struct("<HIQQ")
"""Channel id, sequence, log time and publish time (ns): what a Message record's content begins with."""
