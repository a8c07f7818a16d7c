"""Messages of a rosbag1 file (format 2.0), without an index, so that a bag that was not closed is read, too."""

from __future__ import annotations

import bz2
import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from dds_trace.base.units import counted

from ..mcapfile.blocks import LARGEST_FILE_RATIO, most_unpacked_bytes
from ..mcapfile.chunks import DamagedChunkError, unpack_records
from ..mcapfile.file import MAX_RECORD_BYTES
from .recorded import Budget, Condition, RawMessage, RecordedTopic, UnreadableError

BAG1_MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _BAG_HEADER, _CHUNK, _CONNECTION = 2, 3, 5, 7
_LENGTH = struct.Struct("<I")
_TIME = struct.Struct("<II")
_MOST_HEADER_BYTES = 1 << 20
_BZ2_WEIGHT = 4
"""bz2 needs at least three times as long for a byte as lz4."""


def bag1_messages(path: Path, condition: Condition) -> Iterator[RawMessage]:
    """Yield the messages in file order, up to the first damage, which `condition` then has."""
    topics: dict[int, RecordedTopic] = {}
    with path.open("rb") as file:
        if file.read(len(BAG1_MAGIC)) != BAG1_MAGIC:
            raise UnreadableError("it is not a ROS 1 bag of format 2.0")
        try:
            yield from _file_messages(file, path.stat().st_size, topics, condition)
        except _DAMAGE as err:
            condition.damages.append(
                f"up to byte {file.tell()} it is cut off or damaged ({err}); nothing after it is read"
            )
        condition.topics |= set(topics.values())


_DAMAGE = (ValueError, KeyError, IndexError, struct.error, OSError, EOFError, DamagedChunkError)


def _file_messages(
    file: BinaryIO, size_bytes: int, topics: dict[int, RecordedTopic], condition: Condition
) -> Iterator[RawMessage]:
    budget, left_bytes = Budget(size_bytes), most_unpacked_bytes(size_bytes)
    for fields, data in _records(file):
        if fields["op"][0] == _BAG_HEADER and not int.from_bytes(fields["index_pos"], "little"):
            condition.damages.append("it was not closed: it has no index (`rosbag reindex` makes one)")
        elif fields["op"][0] == _CONNECTION:
            _add_topic(fields, data, topics)
        elif fields["op"][0] == _CHUNK:
            records, weight = _unpacked(fields, data)
            left_bytes -= weight * len(records)
            if left_bytes < 0:
                raise UnreadableError(f"it unpacks to more than {LARGEST_FILE_RATIO // weight} times its size")
            times_ns = []
            for message in _messages(BytesIO(records), topics):
                budget.take()
                times_ns.append(message.log_ns)
                yield message
            if times_ns:
                condition.chunks.append((min(times_ns), max(times_ns), len(times_ns)))


def _records(file: BinaryIO) -> Iterator[tuple[dict[str, bytes], bytes]]:
    while head := file.read(_LENGTH.size):
        header = _exactly(file, _LENGTH.unpack(head)[0], _MOST_HEADER_BYTES)
        data = _exactly(file, _LENGTH.unpack(file.read(_LENGTH.size))[0], MAX_RECORD_BYTES)
        yield _fields(header), data


def _fields(header: bytes) -> dict[str, bytes]:
    fields: dict[str, bytes] = {}
    at = 0
    while at < len(header):
        (length,) = _LENGTH.unpack_from(header, at)
        name, _, value = header[at + _LENGTH.size : at + _LENGTH.size + length].partition(b"=")
        fields[name.decode()] = value
        at += _LENGTH.size + length
    return fields


def _exactly(file: BinaryIO, size: int, most: int) -> bytes:
    if size > most:
        raise ValueError(f"it claims {counted(size, 'byte')}")
    data = file.read(size)
    if len(data) < size:
        raise ValueError("a record is cut off")
    return data


def _unpacked(fields: dict[str, bytes], packed: bytes) -> tuple[bytes | bytearray, int]:
    compression, (size,) = fields["compression"].decode(), _LENGTH.unpack(fields["size"])
    if compression != "bz2":
        return unpack_records("" if compression == "none" else compression, packed, size), 1
    if size > MAX_RECORD_BYTES:
        raise ValueError(f"a piece of it unpacks to more than {MAX_RECORD_BYTES >> 20} MiB")
    unpacked = bz2.BZ2Decompressor().decompress(packed, size + 1)
    if len(unpacked) != size:
        raise ValueError(f"a chunk holds {counted(len(unpacked), 'byte')} and claims {size}")
    return unpacked, _BZ2_WEIGHT


def _messages(file: BinaryIO, topics: dict[int, RecordedTopic]) -> Iterator[RawMessage]:
    for fields, data in _records(file):
        if fields["op"][0] == _CONNECTION:
            _add_topic(fields, data, topics)
        elif fields["op"][0] == _MESSAGE:
            seconds, nanoseconds = _TIME.unpack(fields["time"])
            (connection,) = _LENGTH.unpack(fields["conn"])
            yield RawMessage(topics[connection], seconds * 10**9 + nanoseconds, None, None, data)


def _add_topic(fields: dict[str, bytes], data: bytes, topics: dict[int, RecordedTopic]) -> None:
    about = _fields(data)
    package, _, name = about["type"].decode().partition("/")
    topics[_LENGTH.unpack(fields["conn"])[0]] = RecordedTopic(
        fields["topic"].decode(),
        f"{package}/msg/{name}",
        "ros1",
        about.get("message_definition", b"").decode(errors="replace"),
        "ros1msg",
        "durability: transient_local" if about.get("latching") == b"1" else "",
        about.get("callerid", b"").decode(errors="replace"),
    )
