"""The session that a trace of ours begins with, from its first chunk alone: a file of a gigabyte tells in a millisecond whose it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mcap.opcode import Opcode

from dds_trace.base.errors import TraceFormatError

from ..format.descriptions import Session
from ..format.framing import MAGIC, MESSAGE_HEADER, RECORD_HEADER
from ..format.string_cdr import decode_string
from ..mcapfile.chunks import DamagedChunkError, PackedChunk
from ..mcapfile.file import RecordFile, TornRecordError

if TYPE_CHECKING:
    from pathlib import Path

_CHUNKS = frozenset({Opcode.CHUNK})


def read_first_session(path: Path) -> Session | None:
    """Return the session that a file begins with; None if it does not begin as the files of our recorder do."""
    try:
        with RecordFile(path) as file:
            chunk = PackedChunk.at(file, file.header_at(len(MAGIC), _CHUNKS))
            return _session_in(chunk.unpack(file), path)
    except (TraceFormatError, TornRecordError, DamagedChunkError, ValueError):
        return None


def _session_in(records: memoryview, path: Path) -> Session | None:
    at = 0
    while at + RECORD_HEADER.size <= len(records):
        opcode, length = RECORD_HEADER.unpack_from(records, at)
        at += RECORD_HEADER.size
        if opcode == Opcode.MESSAGE:
            return Session.from_json(decode_string(records[at + MESSAGE_HEADER.size : at + length]), path)
        at += length
    return None
