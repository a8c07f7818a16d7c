"""Messages of a rosbag2 database of any version; of a damaged one also the rows of pages that SQLite no longer reaches.

The pages are read as https://www.sqlite.org/fileformat.html describes them: a row of `messages` is known by its columns (no value,
number, number, blob), one of `topics` by its texts.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import quote

from dds_trace.base.units import counted

from ..mcapfile.file import MAX_RECORD_BYTES
from ..reading.sqlite_source import COMPUTED, SQLITE_ERRORS, TABLES, bound_work, missing_bytes
from .recorded import Budget, Condition, RawMessage, RecordedTopic, UnreadableError

SQLITE_TABLES = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL,
  offered_qos_profiles TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
  encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
INSERT INTO schema VALUES (4, 'unknown');
"""
"""The tables that rosbag2 makes since ROS 2 Iron."""

SQLITE_MAGIC = b"SQLite format 3\0"
_TOPICS = "SELECT id, name, type, serialization_format, {}, {} FROM topics LIMIT 10000"
_MESSAGES = "SELECT id, topic_id, timestamp, data FROM messages ORDER BY id"
_PAGE_SIZE = struct.Struct(">16xH2xB")
_CELLS = struct.Struct(">H")
_LEAF = 0x0D
_MOST_COLUMNS = 7
_LEAST_REACHED = 0.1
"""Share of a database's bytes below which its tables may not reach all rows."""
_USUAL_PAGE_BYTES = 4096


def sqlite_messages(path: Path, condition: Condition) -> Iterator[RawMessage]:
    """Yield the messages in stored order, then messages of damaged pages; what is missing goes to `condition`."""
    budget, seen, rows = Budget(path.stat().st_size), set[int](), list[tuple[int, int, int, bytes]]()
    topics: dict[int, RecordedTopic] = {}
    fault, size_bytes, read_bytes = "", path.stat().st_size, 0
    try:
        lost_bytes = missing_bytes(path)
        if lost_bytes > 0:
            fault = f"{counted(lost_bytes, 'byte')} of it {'is' if lost_bytes == 1 else 'are'} missing"
        with closing(sqlite3.connect(f"file:{quote(str(path))}?mode=ro", uri=True)) as database:
            bound_work(database, path.stat().st_size, MAX_RECORD_BYTES)
            topics = _read_topics(database)
            for row_id, topic_id, time_ns, data in database.execute(_MESSAGES):
                budget.take()
                if topic_id in topics and isinstance(data, bytes):
                    seen.add(row_id)
                    read_bytes += len(data)
                yield from _message(topics, topic_id, time_ns, data)
    except SQLITE_ERRORS as err:
        fault = fault or f"it is damaged ({err})"
    if fault or read_bytes < size_bytes * _LEAST_REACHED:
        rows = _unreached_rows(path, budget, seen, topics)
        fault = fault or ("its tables do not reach all of its pages" if rows else "")
    if fault:
        if not topics:
            raise UnreadableError(f"it is no rosbag2 database that can be read: {fault}")
        more = f"; {counted(len(rows), 'message')} more from single pages" if rows else ""
        condition.damages.append(f"{fault}{more}")
    condition.topics |= set(topics.values())
    for _, topic_id, time_ns, data in rows:
        yield from _message(topics, topic_id, time_ns, data)


def _unreached_rows(
    path: Path, budget: Budget, seen: set[int], topics: dict[int, RecordedTopic]
) -> list[tuple[int, int, int, bytes]]:
    rows, definitions = list[tuple[int, int, int, bytes]](), dict[str, tuple[str, str]]()
    for row_id, values in _rows_of_pages(path, budget):
        kinds = [type(value) for value in values]
        if kinds == [type(None), int, int, bytes] and row_id not in seen:
            seen.add(row_id)
            rows.append((row_id, values[1], values[2], values[3]))
        elif kinds == [type(None), str, str, str, str] and values[2] in {"ros2msg", "ros2idl"}:
            definitions[values[1]] = values[3], values[2]
        elif kinds[:4] == [type(None), str, str, str] and len(values) < _MOST_COLUMNS and values[1].startswith("/"):
            qos = values[4] if len(values) > 4 and isinstance(values[4], str) else ""
            topics.setdefault(row_id, RecordedTopic(values[1], values[2], values[3], qos=qos))
    for row_id, topic in topics.items():
        if not topic.definition and topic.message_type in definitions:
            text, encoding = definitions[topic.message_type]
            topics[row_id] = replace(topic, definition=text, definition_encoding=encoding)
    return sorted(rows)


def _message(topics: dict[int, RecordedTopic], topic_id: Any, time_ns: Any, data: Any) -> Iterator[RawMessage]:
    # Columns of SQLite have no fixed type: a damaged page may contain anything.
    if topic_id in topics and isinstance(time_ns, int) and isinstance(data, bytes):
        yield RawMessage(topics[topic_id], time_ns, None, None, data)


def _read_topics(database: sqlite3.Connection) -> dict[int, RecordedTopic]:
    database.execute("PRAGMA trusted_schema = OFF")
    ((tables,),) = database.execute(TABLES)
    ((computed,),) = database.execute(COMPUTED)
    if tables != 2 or computed:
        raise UnreadableError("it is no rosbag2 database: no tables 'topics' and 'messages' as it makes them")
    columns = {row[1] for row in database.execute("PRAGMA table_info(topics)")}
    later = [name if name in columns else "''" for name in ("offered_qos_profiles", "type_description_hash")]
    rows = database.execute(_TOPICS.format(*later))
    definitions: dict[str, tuple[str, str]] = {}
    with suppress(sqlite3.Error):  # before ROS 2 Iron there is no such table
        definitions = {
            str(kind): (str(text), str(encoding))
            for kind, encoding, text in database.execute(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            )
        }
    return {
        row_id: RecordedTopic(
            name,
            str(kind),
            str(encoding),
            *definitions.get(str(kind), ("", "")),
            qos=str(profiles),
            type_hash=str(type_hash),
        )
        for row_id, name, kind, encoding, profiles, type_hash in rows.fetchall()
        if isinstance(name, str)
    }


def _rows_of_pages(path: Path, budget: Budget) -> Iterator[tuple[int, list[Any]]]:
    with path.open("rb") as file:
        page_bytes, reserved = _PAGE_SIZE.unpack(file.read(_PAGE_SIZE.size).ljust(_PAGE_SIZE.size, b"\0"))
        page_bytes = 65536 if page_bytes == 1 else page_bytes
        if page_bytes < 512 or page_bytes & (page_bytes - 1):
            page_bytes, reserved = _USUAL_PAGE_BYTES, 0
        pages = _Pages(file, page_bytes, page_bytes - reserved)
        for number in range(-(-path.stat().st_size // page_bytes)):
            page = pages.read(number)
            start = 100 if number == 0 else 0
            if len(page) < page_bytes or page[start] != _LEAF:
                continue
            (cells,) = _CELLS.unpack_from(page, start + 3)
            for cell in range(min(cells, page_bytes // 4)):
                with suppress(ValueError, IndexError, struct.error):
                    (at,) = _CELLS.unpack_from(page, start + 8 + 2 * cell)
                    row_id, payload = pages.cell(page, at)
                    values = _values(payload)
                    budget.take()
                    yield row_id, values


class _Pages:
    def __init__(self, file: BinaryIO, page_bytes: int, usable_bytes: int) -> None:
        self._file, self._page_bytes, self._usable_bytes = file, page_bytes, usable_bytes

    def read(self, number: int) -> bytes:
        self._file.seek(number * self._page_bytes)
        return self._file.read(self._page_bytes)

    def cell(self, page: bytes, at: int) -> tuple[int, bytes]:
        size, at = _varint(page, at)
        row_id, at = _varint(page, at)
        if size > MAX_RECORD_BYTES:
            raise ValueError("no row is so long")
        usable = self._usable_bytes
        least = (usable - 12) * 32 // 255 - 23
        local = least + (size - least) % (usable - 4)
        local = size if size <= usable - 35 else local if local <= usable - 35 else least
        parts, remaining = [page[at : at + local]], size - local
        following = int.from_bytes(page[at + local : at + local + 4], "big") if remaining > 0 else 0
        while remaining > 0:
            page = self.read(following - 1) if following else b""
            if len(page) < self._page_bytes:
                raise ValueError("a page is missing")
            parts.append(page[4 : 4 + min(remaining, usable - 4)])
            remaining -= len(parts[-1])
            following = int.from_bytes(page[:4], "big")
        return row_id, b"".join(parts)


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for _ in range(8):
        value = value << 7 | data[at] & 0x7F
        at += 1
        if data[at - 1] < 0x80:
            return value, at
    return value << 8 | data[at], at + 1


_SIZES = (0, 1, 2, 3, 4, 6, 8)


def _values(payload: bytes) -> list[Any]:
    head_end, at = _varint(payload, 0)
    kinds = []
    while at < head_end:
        kind, at = _varint(payload, at)
        kinds.append(kind)
    values: list[Any] = []
    for kind in kinds:
        size = _SIZES[kind] if kind < len(_SIZES) else 8 if kind == 7 else 0 if kind < 12 else (kind - 12) // 2
        data = payload[at : at + size]
        if len(data) < size:
            raise ValueError("a row is cut off")
        at += size
        if kind in {8, 9}:
            values.append(kind - 8)
        elif 0 < kind < len(_SIZES):
            values.append(int.from_bytes(data, "big", signed=True))
        elif kind < 12:
            values.append(None)
        else:
            values.append(data if kind % 2 == 0 else data.decode())
    return values
