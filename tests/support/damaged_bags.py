"""Recordings that are cut or damaged at random places, and the messages of which not a byte was touched."""

from __future__ import annotations

import random
import sqlite3
import struct
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING

import zstandard
from bags import ROS2
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader

from dds_trace.tracefile.recordings.sqlite_rows import SQLITE_TABLES

if TYPE_CHECKING:
    from pathlib import Path

START_NS = 1_700_000_000 * 10**9
MAGIC_BYTES = 8
MESSAGE, CHUNK, CHANNEL, SCHEMA = 5, 6, 4, 3
TOPICS = ("/camera", "/imu", "/chatter")
KINDS = ("mcap zstd", "mcap lz4", "mcap unpacked", "mcap without chunks", "sqlite3")
Key = tuple[str, int, bytes]


@dataclass(frozen=True)
class Good:
    """A recording, and the parts of it that each message needs: each a list of (start, end) in bytes."""

    kind: str
    content: bytes
    needs: dict[Key, list[tuple[int, int]]]
    declared_at: tuple[tuple[int, int], tuple[int, int]]
    """The stretches of which one must be whole: the first declarations, and summary with footer."""


def text(rng: random.Random, size: int) -> bytes:
    data = bytes(rng.choices(range(32, 127), k=size))
    return b"\0\1\0\0" + struct.pack("<I", size + 1) + data + b"\0"


def make_good(kind: str, folder: Path, seed: int) -> Good:  # noqa: C901 - each kind has its own layout
    rng = random.Random(seed)
    messages = [
        (TOPICS[number % 3], START_NS + number * 10_000_000, text(rng, rng.randrange(10, 600))) for number in range(300)
    ]
    if kind == "sqlite3":
        return _good_sqlite(folder, messages)
    compression = {"mcap zstd": CompressionType.ZSTD, "mcap lz4": CompressionType.LZ4}.get(kind, CompressionType.NONE)
    path = folder / "good.mcap"
    with path.open("wb") as file:
        chunked = kind != "mcap without chunks"
        writer = Writer(file, chunk_size=8192, compression=compression, use_chunking=chunked)
        writer.start("ros2", "made for a test")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channels = {topic: writer.register_channel(topic, "cdr", schema) for topic in TOPICS}
        for number, (topic, log_ns, data) in enumerate(messages):
            writer.add_message(channels[topic], log_ns, data, log_ns, number)
        writer.finish()
    content = path.read_bytes()
    path.unlink()
    needs: dict[Key, list[tuple[int, int]]] = {}
    declarations_end = 0
    for opcode, start, end in _records(content, MAGIC_BYTES, len(content) - MAGIC_BYTES):
        if opcode == CHUNK:
            body, at = _chunk_body(content, start, end)
            for inner, first, last in _records(body, 0, len(body)):
                is_packed = compression is not CompressionType.NONE
                if inner == MESSAGE:
                    need = (start - 9, end) if is_packed else (at + first - 9, at + last)
                    needs[_key(body[first:last])] = [need]
                elif not declarations_end or inner == CHANNEL:
                    declarations_end = max(declarations_end, end if is_packed else at + last)
        elif opcode == MESSAGE:
            needs[_key(content[start:end])] = [(start - 9, end)]
        elif opcode == CHANNEL and not declarations_end:
            declarations_end = end
        elif opcode == CHANNEL and start < len(content) // 2:
            declarations_end = max(declarations_end, end)
    (summary,) = struct.unpack_from("<Q", content, len(content) - MAGIC_BYTES - 20)
    return Good(kind, content, needs, ((0, declarations_end), (summary, len(content))))


def _good_sqlite(folder: Path, messages: list[tuple[str, int, bytes]]) -> Good:
    path = folder / "good.db3"
    with closing(sqlite3.connect(path)) as database:
        database.executescript(SQLITE_TABLES)
        for number, topic in enumerate(TOPICS):
            database.execute(
                "INSERT INTO topics VALUES (?, ?, 'std_msgs/msg/String', 'cdr', '', '')", (number + 1, topic)
            )
        database.execute(
            "INSERT INTO message_definitions VALUES (1, 'std_msgs/msg/String', 'ros2msg', 'string data', '')"
        )
        for topic, log_ns, data in messages:
            row = (TOPICS.index(topic) + 1, log_ns, data)
            database.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", row)
        database.commit()
    content = path.read_bytes()
    path.unlink()
    needs: dict[Key, list[tuple[int, int]]] = {}
    for key in messages:
        at = content.find(key[2])
        page = at // 4096 * 4096
        needs[key] = [(page, page + 4096)] if at >= 0 else [(0, len(content))]
    at = content.find(b"/camera")
    return Good("sqlite3", content, needs, ((at // 4096 * 4096, at // 4096 * 4096 + 4096),) * 2)


def _records(data: bytes, at: int, stop: int) -> list[tuple[int, int, int]]:
    found = []
    while at + 9 <= stop:
        opcode, length = struct.unpack_from("<BQ", data, at)
        found.append((opcode, at + 9, at + 9 + length))
        at += 9 + length
    return found


def _chunk_body(content: bytes, start: int, end: int) -> tuple[bytes, int]:
    (size,) = struct.unpack_from("<I", content, start + 28)
    name = content[start + 32 : start + 32 + size]
    body = content[start + 40 + size : end]
    if name == b"zstd":
        return zstandard.ZstdDecompressor().decompress(body, 1 << 22), 0
    if name == b"lz4":
        import lz4.frame

        return lz4.frame.decompress(body), 0
    return body, start + 40 + size


def _key(content: bytes) -> Key:
    channel, _, log_ns, _ = struct.unpack_from("<HIQQ", content)
    return TOPICS[channel - 1], log_ns, content[22:]


def damage(good: Good, rng: random.Random) -> tuple[bytes, set[Key]]:
    """Cut or damage a recording; return its bytes, and the messages that are whole."""
    size = len(good.content)
    how = rng.choice(("cut", "flip", "flips", "zeros", "removed", "noise"))
    at = rng.randrange(MAGIC_BYTES, size)
    length = rng.randrange(1, 3000)
    content = bytearray(good.content)
    touched: list[tuple[int, int]] = []
    if how == "cut":
        del content[at:]
        touched = [(at, size)]
    elif how in {"flip", "flips"}:
        for place in {at, *(rng.randrange(MAGIC_BYTES, size) for _ in range(4 if how == "flips" else 0))}:
            content[place] ^= 1 << rng.randrange(8)
            touched.append((place, place + 1))
    else:
        touched = [(at, min(at + length, size))]
        if how == "removed":
            if good.kind == "sqlite3":  # every page would be displaced
                return damage(good, rng)
            del content[at : at + length]
            touched.append((good.declared_at[1][0], good.declared_at[1][0] + 1))  # its offsets are wrong now
        else:
            new = bytes(length) if how == "zeros" else rng.randbytes(length)
            content[at : at + length] = new[: touched[0][1] - at]

    def is_whole(start: int, end: int) -> bool:
        return not any(first < end and start < last for first, last in touched)

    if not any(is_whole(*part) for part in good.declared_at):
        return bytes(content), set()
    return bytes(content), {key for key, needs in good.needs.items() if all(is_whole(*need) for need in needs)}


def read_recovered(path: Path) -> set[Key]:
    with AnyReader([path], default_typestore=ROS2) as reader:
        by_rosbags = [(connection.topic, log_ns, data) for connection, log_ns, data in reader.messages()]
    if path.suffix == ".db3":
        return set(by_rosbags)
    with path.open("rb") as file:
        official = [
            (channel.topic, message.log_time, message.data) for _, channel, message in make_reader(file).iter_messages()
        ]
    assert sorted(official) == sorted(by_rosbags)
    return set(official)
