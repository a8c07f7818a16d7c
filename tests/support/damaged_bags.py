"""Recordings with damages of every kind at random places, and the messages of which not a byte was touched."""

import random
import sqlite3
import struct
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import zstandard
from bags import ROS1, ROS2
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1

from dds_trace.extensions.bags.sqlite_rows import SQLITE_TABLES

START_NS = 1_700_000_000 * 10**9
MAGIC_BYTES = 8
PAGE_BYTES = 4096
MESSAGE, CHUNK, CHANNEL = 5, 6, 4
TOPICS = ("/camera", "/imu", "/chatter")
SCHEMAS = {
    "cdr": ("std_msgs/msg/String", "ros2msg", b"string data\n"),
    "ros1": ("std_msgs/String", "ros1msg", b"string data\n"),
    "json": ("Text", "jsonschema", b'{"type": "object"}'),
    "protobuf": ("Text", "protobuf", bytes(range(200))),
}
MCAPS = {
    "mcap zstd": (CompressionType.ZSTD, "cdr"),
    "mcap lz4": (CompressionType.LZ4, "cdr"),
    "mcap unpacked": (CompressionType.NONE, "cdr"),
    "mcap without chunks": (CompressionType.NONE, "cdr"),
    "mcap without crcs": (CompressionType.ZSTD, "cdr"),
    "mcap json": (CompressionType.LZ4, "json"),
    "mcap protobuf": (CompressionType.ZSTD, "protobuf"),
    "mcap ros1": (CompressionType.NONE, "ros1"),
}
BAGS1 = {"bag": None, "bag lz4": Writer1.CompressionFormat.LZ4, "bag bz2": Writer1.CompressionFormat.BZ2}
KINDS = (*MCAPS, *BAGS1, "sqlite3", "sqlite3 wal", "sqlite3 journal")
Key: TypeAlias = tuple[str, int, bytes]
Range: TypeAlias = tuple[int, int]


@dataclass(frozen=True)
class Good:
    """A recording, and the ranges of bytes that each message needs.

    Of `declared_at` one range must be whole; `lengths` has (offset, struct format) of the lengths of records.
    """

    kind: str
    content: bytes
    needs: dict[Key, list[Range]]
    declared_at: tuple[Range, ...]
    lengths: tuple[tuple[int, str], ...] = ()
    log: bytes = b""

    @property
    def name(self) -> str:
        return {"mcap": "x.mcap", "bag": "x.bag", "sqlite3": "x.db3"}[self.kind.split()[0]]

    def write(self, folder: Path, content: bytes) -> Path:
        path = folder / self.name
        path.write_bytes(content)
        if self.log:
            path.with_name(f"{path.name}-{self.kind.split()[1]}").write_bytes(self.log)
        return path


def text(rng: random.Random, size: int) -> bytes:
    data = bytes(rng.choices(range(32, 127), k=size))
    return b"\0\1\0\0" + struct.pack("<I", size + 1) + data + b"\0"


def make_good(kind: str, folder: Path, seed: int) -> Good:
    rng = random.Random(seed)
    large = {50: 9_000, 200: 30_000}
    messages = [
        (TOPICS[number % 3], START_NS + number * 10_000_000, text(rng, large.get(number) or rng.randrange(10, 600)))
        for number in range(300)
    ]
    if kind in MCAPS:
        return _good_mcap(kind, folder, messages)
    return _good_bag1(kind, folder, messages) if kind in BAGS1 else _good_sqlite(kind, folder, messages)


def _good_mcap(kind: str, folder: Path, messages: list[Key]) -> Good:
    (compression, encoding), path = MCAPS[kind], folder / "good.mcap"
    with path.open("wb") as file:
        chunked = kind != "mcap without chunks"
        crcs = kind != "mcap without crcs"
        writer = Writer(file, chunk_size=8192, compression=compression, use_chunking=chunked, enable_crcs=crcs)
        writer.start("ros2" if encoding == "cdr" else "", "made for a test")
        schema = writer.register_schema(*SCHEMAS[encoding])
        channels = {topic: writer.register_channel(topic, encoding, schema) for topic in TOPICS}
        for number, (topic, log_ns, data) in enumerate(messages):
            writer.add_message(channels[topic], log_ns, data, log_ns, number)
        writer.finish()
    content = path.read_bytes()
    path.unlink()
    needs: dict[Key, list[Range]] = {}
    lengths = []
    declarations_end = 0
    for opcode, start, end in _records(content, MAGIC_BYTES, len(content) - MAGIC_BYTES):
        lengths.append((start - 8, "<Q"))
        if opcode == CHUNK:
            body, at = _chunk_body(content, start, end)
            is_packed = compression is not CompressionType.NONE
            for inner, first, last in _records(body, 0, len(body)):
                lengths += [] if is_packed else [(at + first - 8, "<Q")]
                if inner == MESSAGE:
                    needs[_key(body[first:last])] = [(start - 9, end) if is_packed else (at + first - 9, at + last)]
                elif not declarations_end or inner == CHANNEL:
                    declarations_end = max(declarations_end, end if is_packed else at + last)
        elif opcode == MESSAGE:
            needs[_key(content[start:end])] = [(start - 9, end)]
        elif opcode == CHANNEL and start < len(content) // 2:
            declarations_end = max(declarations_end, end)
    (summary,) = struct.unpack_from("<Q", content, len(content) - MAGIC_BYTES - 20)
    return Good(kind, content, needs, ((0, declarations_end), (summary, len(content))), tuple(lengths))


def _good_bag1(kind: str, folder: Path, messages: list[Key]) -> Good:
    path = folder / "good.bag"
    bag = Writer1(path)
    bag.chunk_threshold = 8192
    if BAGS1[kind]:
        bag.set_compression(BAGS1[kind])
    keys = [(topic, log_ns, data[4:]) for topic, log_ns, data in messages]
    with bag:
        connections = {
            topic: bag.add_connection(topic, "std_msgs/msg/String", typestore=ROS1, callerid="/x") for topic in TOPICS
        }
        for topic, log_ns, data in keys:
            bag.write(connections[topic], log_ns, data)
    content = path.read_bytes()
    path.unlink()
    needs: dict[Key, list[Range]] = {}
    records = _bag1_records(content, 13, len(content))
    lengths = [place for _, start, data_at, _ in records for place in ((start, "<I"), (data_at - 4, "<I"))]
    chunks = [record for record in records if record[0] == 5]
    for (_, start, data_at, end), chunk in zip(chunks, bag.chunks, strict=False):
        count = sum(map(len, chunk.connections.values()))
        ranges = [(start, end)] * count
        if not BAGS1[kind]:
            ranges = [inner[1::2] for inner in _bag1_records(content, data_at, end) if inner[0] == 2]
        needs |= {key: [part] for key, part in zip(keys[len(needs) :], ranges, strict=False)}
    index_at = next(start for opcode, start, *_ in records if opcode == 7)
    return Good(kind, content, needs, ((0, chunks[0][3]), (index_at, len(content))), tuple(lengths))


def _bag1_records(data: bytes, at: int, stop: int) -> list[tuple[int, int, int, int]]:
    found = []
    while at < stop:
        (header_bytes,) = struct.unpack_from("<I", data, at)
        data_at = at + 8 + header_bytes
        (data_bytes,) = struct.unpack_from("<I", data, data_at - 4)
        opcode = data[data.index(b"op=", at) + 3]
        found.append((opcode, at, data_at, data_at + data_bytes))
        at = data_at + data_bytes
    return found


def _good_sqlite(kind: str, folder: Path, messages: list[Key]) -> Good:
    path = folder / "good.db3"
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.executescript(SQLITE_TABLES)
        for number, topic in enumerate(TOPICS):
            database.execute(
                "INSERT INTO topics VALUES (?, ?, 'std_msgs/msg/String', 'cdr', '', '')", (number + 1, topic)
            )
        database.execute(
            "INSERT INTO message_definitions VALUES (1, 'std_msgs/msg/String', 'ros2msg', 'string data', '')"
        )
        half = len(messages) if kind == "sqlite3" else len(messages) // 2
        _insert(database, messages[:half])
        log = b""
        if kind == "sqlite3 wal":
            database.execute("PRAGMA journal_mode=WAL")
            database.execute("PRAGMA wal_autocheckpoint=0")
            _insert(database, messages[half:])
            content, log = path.read_bytes(), path.with_name("good.db3-wal").read_bytes()
        elif kind == "sqlite3 journal":
            database.execute("PRAGMA cache_size=5")  # pages of the unfinished transaction reach the file
            database.execute("BEGIN")
            database.execute("UPDATE messages SET timestamp = 0")
            _insert(database, messages[half:])
            content, log = path.read_bytes(), path.with_name("good.db3-journal").read_bytes()
            database.execute("ROLLBACK")
            messages = messages[:half]
        else:
            content = path.read_bytes()
    path.unlink()
    needs: dict[Key, list[Range]] = {}
    for key in messages:
        parts = [content.find(key[2][at : at + 60]) for at in range(0, len(key[2]), 60)]
        pages = sorted({at // PAGE_BYTES * PAGE_BYTES for at in parts if at >= 0})
        needs[key] = [(page, page + PAGE_BYTES) for page in pages]
    at = content.find(b"/camera") // PAGE_BYTES * PAGE_BYTES
    return Good(kind, content, needs, ((at, at + PAGE_BYTES),), log=log)


def _insert(database: sqlite3.Connection, messages: list[Key]) -> None:
    rows = [(TOPICS.index(topic) + 1, log_ns, data) for topic, log_ns, data in messages]
    database.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", rows)


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


def _flipped(good: Good, at: int) -> bytes:
    return bytes([good.content[at] ^ 8])


HOWS = (
    *("cut", "short", "first bytes", "no first bytes", "before the magic", "flip", "flips", "zeros", "noise"),
    *("inserted", "removed", "moved", "doubled", "swapped", "length"),
)


def damage(good: Good, rng: random.Random, how: str = "") -> tuple[bytes, set[Key]]:
    """Cut or damage a recording; return its bytes, and the messages that are whole."""
    how, size = how or rng.choice(HOWS), len(good.content)
    at, to = rng.randrange(size), rng.randrange(size)
    end, few = min(at + rng.randrange(1, 3000), size), rng.randrange(1, 101)
    a, b, c, d = sorted(rng.sample(range(size), 4))
    if good.kind.startswith("sqlite3") and rng.random() < 0.5:
        at, end, to, a, b, c, d = (place // PAGE_BYTES * PAGE_BYTES for place in (at, end + PAGE_BYTES, to, a, b, c, d))
    if how == "length" and good.lengths:
        at, kind = rng.choice(good.lengths)
        (right,) = struct.unpack_from(kind, good.content, at)
        other = struct.unpack_from(kind, good.content, rng.choice(good.lengths)[0])[0]
        wrong = rng.choice((0, right + few, max(right - few, 0), right + other + 9, 2**31, rng.randrange(2**32)))
        new, end = struct.pack(kind, wrong), at + struct.calcsize(kind)
    else:
        new = bytes(end - at) if how == "zeros" else rng.randbytes(end - at)
    parts: list[Range | bytes] = {
        "cut": [(0, at)],
        "short": [(0, size - few)],
        "first bytes": [rng.randbytes(few), (few, size)],
        "no first bytes": [(few, size)],
        "before the magic": [rng.randbytes(few), (0, size)],
        "inserted": [(0, at), new, (at, size)],
        "removed": [(0, at), (end, size)],
        "moved": [(0, a), (b, c), (a, b), (c, size)],
        "doubled": [(0, end), (at, size)],
        "swapped": [(0, a), (c, d), (b, c), (a, b), (d, size)],
        "flips": [(0, a), _flipped(good, a), (a + 1, b), _flipped(good, b), (b + 1, size)],
        "flip": [(0, at), _flipped(good, at), (at + 1, size)],
    }.get(how, [(0, at), new, (end, size)])
    return joined(good, parts)


def joined(good: Good, parts: Sequence[Range | bytes]) -> tuple[bytes, set[Key]]:
    content = b"".join(part if isinstance(part, bytes) else good.content[slice(*part)] for part in parts)
    kept = [part for part in parts if not isinstance(part, bytes)]

    def is_whole(start: int, end: int) -> bool:
        return any(first <= start and end <= last for first, last in kept)

    if not any(is_whole(*part) for part in good.declared_at):
        return content, set()
    return content, {key for key, needs in good.needs.items() if all(is_whole(*need) for need in needs)}


def read_recovered(path: Path) -> set[Key]:
    if path.suffix == ".mcap":
        with path.open("rb") as file:
            official = [
                (channel.topic, message.log_time, message.data)
                for _, channel, message in make_reader(file).iter_messages()
            ]
        if b"std_msgs/msg" not in path.read_bytes():
            return set(official)
    with AnyReader([path], default_typestore=ROS2) as reader:
        by_rosbags = [(connection.topic, log_ns, bytes(data)) for connection, log_ns, data in reader.messages()]
    assert path.suffix != ".mcap" or sorted(official) == sorted(by_rosbags)
    return set(by_rosbags)
