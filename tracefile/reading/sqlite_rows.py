"""Messages of a rosbag2 database of any version; of a damaged one also the rows of pages that SQLite no longer reaches.

The pages are read as https://www.sqlite.org/fileformat.html describes them: a row of `messages` is known by its columns (no value,
number, number, blob), one of `topics` by its texts.
"""

from __future__ import annotations

import os
import re
import shutil
import sqlite3
import struct
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any
from urllib.parse import quote

from dds_trace.base.files import open_regular
from dds_trace.base.units import counted

from ..mcapfile.blocks import most_unpacked_bytes
from ..mcapfile.file import MAX_RECORD_BYTES
from ..mcapfile.records import crc32
from .recorded import Budget, Condition, RawMessage, RecordedTopic, UnreadableError, full_type

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
# SQLite's steps are bounded: a hostile database has endless rows in few pages. An absurd size is reported as a lack of memory.
_UNSUSPECTED_STEPS = 100_000_000
_STEPS_A_BYTE = 4
_STEPS_A_CHECK = 1_000_000
_MOST_TOPICS = 10_000
_MOST_TEXT_BYTES = 8 << 20

# Every version of rosbag2's schema has these columns. Views, virtual tables and computed columns are not read.
_TABLES = "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND rootpage > 0 AND name IN ('topics', 'messages')"
_COMPUTED = (
    "SELECT (SELECT count(*) FROM pragma_table_xinfo('topics') WHERE hidden)"
    " + (SELECT count(*) FROM pragma_table_xinfo('messages') WHERE hidden)"
)
_TOPICS = "SELECT id, name, type, serialization_format, {}, {} FROM topics LIMIT {}"
_MESSAGES = "SELECT id, topic_id, timestamp, CASE WHEN length(data) <= ? THEN data END FROM messages ORDER BY id"
_HEADER = struct.Struct(">H2xB7xI")
"""After the magic: page size, bytes reserved in each page, and pages."""
_CELLS = struct.Struct(">H")
_LEAF_PAGE = re.compile(rb"(?=\x0d..[\x00-\x40]...[\x00-\x3c])", re.DOTALL)
_FRAME_BYTES = 24
_MOST_TRIES = _MOST_SEARCHES = 1000
_SEARCHED_BYTES = 1 << 20
_MOST_COLUMNS = 7
_LEAST_REACHED = 0.1
"""Share of a database's bytes below which its tables may not reach all rows."""
_USUAL_PAGE_BYTES = 4096


def sqlite_messages(path: Path, condition: Condition) -> Iterator[RawMessage]:
    """Yield the messages in stored order, then messages of damaged pages; what is missing goes to `condition`."""
    budget, seen, rows = Budget(path.stat().st_size), dict[int, int](), list[tuple[int, int, int, bytes]]()
    topics: dict[int, RecordedTopic] = {}
    fault, size_bytes, read_bytes = "", path.stat().st_size, 0
    with _joined(path, condition) as (joined, files):
        surplus_bytes = 0
        try:
            surplus_bytes = -_missing_bytes(joined)
            if surplus_bytes < 0:
                fault = f"{counted(-surplus_bytes, 'byte')} of it {'is' if surplus_bytes == -1 else 'are'} missing"
            for message in _rows_of_tables(joined, topics, budget, seen, condition):
                read_bytes += len(message.data)
                yield message
        except (sqlite3.Error, MemoryError) as err:
            fault = fault or f"it is damaged ({err})"
        has_gaps = not seen or max(seen) - min(seen) >= len(seen)
        is_in_doubt = fault or has_gaps or surplus_bytes or read_bytes < size_bytes * _LEAST_REACHED
        rows = _unreached_rows(
            [file for file in files if is_in_doubt or file.name.endswith("-wal")], budget, seen, topics
        )
        fault = fault or ("its tables do not reach all of its pages" if rows else "")
    if fault:
        topics = {row_id: topic for row_id, topic in topics.items() if topic.name.startswith("/")}
        if not topics:
            raise UnreadableError(f"it is no rosbag2 database that can be read: {fault}")
        more = f"; {counted(len(rows), 'message')} more from single pages" if rows else ""
        condition.damages.append(f"{fault}{more}")
    condition.topics |= set(topics.values())
    for _, topic_id, time_ns, data in rows:
        if topic_id in topics:
            yield RawMessage(topics[topic_id], time_ns, None, None, data)


def _rows_of_tables(
    path: Path, topics: dict[int, RecordedTopic], budget: Budget, seen: dict[int, int], condition: Condition
) -> Iterator[RawMessage]:
    with closing(sqlite3.connect(f"file:{quote(str(path))}?mode=ro", uri=True)) as database:
        _bound_work(database, path.stat().st_size)
        topics |= _read_topics(database)
        if sys.version_info >= (3, 11):
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_RECORD_BYTES + _MOST_TEXT_BYTES)
        for row_id, topic_id, time_ns, data in database.execute(_MESSAGES, [MAX_RECORD_BYTES]):
            budget.take()
            if topic_id not in topics:
                continue
            # Columns of SQLite have no fixed type: a damaged page may contain anything.
            if isinstance(data, bytes):
                seen[row_id] = crc32(data)
            if isinstance(data, bytes) and isinstance(time_ns, int):
                yield RawMessage(topics[topic_id], time_ns, None, None, data)
            else:
                condition.unreadable[topics[topic_id].name] += 1


@contextmanager
def _joined(database: Path, condition: Condition) -> Iterator[tuple[Path, list[Path]]]:
    """Yield a database, joined with its log in a copy, and all files with pages: first those that no page was written to too early."""
    wal, journal = (database.with_name(f"{database.name}-{suffix}") for suffix in ("wal", "journal"))
    has_wal, is_unfinished = wal.is_file() and wal.stat().st_size > 0, False
    if journal.is_file():
        with journal.open("rb") as stream:
            is_unfinished = stream.read(len(_JOURNAL_MAGIC)) == _JOURNAL_MAGIC
    if not has_wal and not is_unfinished:
        yield database, [database]
        return
    with tempfile.TemporaryDirectory(prefix="dds-trace-") as folder:
        copy = Path(folder) / database.name
        for file in [database, *[wal] * has_wal, *[journal] * is_unfinished]:
            shutil.copyfile(file, copy.with_name(file.name))
        try:
            with closing(sqlite3.connect(copy)) as joined:
                joined.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
                joined.execute("PRAGMA journal_mode=DELETE").fetchall()
        except sqlite3.Error as err:
            condition.damages.append(f"its log {(wal if has_wal else journal).name} cannot be read ({err})")
        if has_wal:
            condition.notes.append(f"the messages in {wal.name} are included")
        if is_unfinished:
            condition.notes.append(f"its last transaction was not finished, and is undone as {journal.name} says")
        yield copy, [database, wal, copy] if has_wal else [journal, copy, database]


_JOURNAL_MAGIC = bytes.fromhex("d9d505f920a163d7")


def _unreached_rows(
    files: list[Path], budget: Budget, seen: dict[int, int], topics: dict[int, RecordedTopic]
) -> list[tuple[int, int, int, bytes]]:
    rows, definitions = list[tuple[int, int, int, bytes]](), dict[str, tuple[str, str]]()
    for row_id, values in (
        row for file in files for row in _rows_of_pages(file, budget, in_frames=file.name.endswith("-wal"))
    ):
        kinds = [type(value) for value in values]
        if kinds == [type(None), int, int, bytes] and seen.get(row_id) != (crc := crc32(values[3])):
            seen[row_id] = crc
            rows.append((row_id, values[1], values[2], values[3]))
        elif kinds == [type(None), str, str, str, str] and values[2] in {"ros2msg", "ros2idl"}:
            definitions[full_type(values[1])] = values[3], values[2]
        elif kinds[:4] == [type(None), str, str, str] and len(values) < _MOST_COLUMNS and values[1].startswith("/"):
            qos = values[4] if len(values) > 4 and isinstance(values[4], str) else ""
            if row_id not in topics or not topics[row_id].name.startswith("/"):
                topics[row_id] = RecordedTopic(values[1], full_type(values[2]), values[3], qos=qos)
    for row_id, topic in topics.items():
        if not topic.definition and topic.message_type in definitions:
            text, encoding = definitions[topic.message_type]
            topics[row_id] = replace(topic, definition=text, definition_encoding=encoding)
    return sorted(rows)


def _read_topics(database: sqlite3.Connection) -> dict[int, RecordedTopic]:
    database.execute("PRAGMA trusted_schema = OFF")
    ((tables,),) = database.execute(_TABLES)
    ((computed,),) = database.execute(_COMPUTED)
    if tables != 2 or computed:
        raise UnreadableError("it is no rosbag2 database: no tables 'topics' and 'messages' as it makes them")
    columns = {row[1] for row in database.execute("PRAGMA table_info(topics)")}
    later = [name if name in columns else "''" for name in ("offered_qos_profiles", "type_description_hash")]
    rows = database.execute(_TOPICS.format(*later, _MOST_TOPICS + 1)).fetchall()
    if len(rows) > _MOST_TOPICS:
        raise UnreadableError(f"it is no rosbag2 database: more than {_MOST_TOPICS} topics")
    definitions: dict[str, tuple[str, str]] = {}
    with suppress(sqlite3.Error):  # before ROS 2 Iron there is no such table
        definitions = {
            full_type(str(kind)): (str(text), str(encoding))
            for kind, encoding, text in database.execute(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            )
        }
    return {
        row_id: RecordedTopic(
            name,
            full_type(str(kind)),
            str(encoding),
            *definitions.get(full_type(str(kind)), ("", "")),
            qos=str(profiles),
            type_hash=str(type_hash),
        )
        for row_id, name, kind, encoding, profiles, type_hash in rows
        if isinstance(name, str) and isinstance(row_id, int)
    }


def _bound_work(database: sqlite3.Connection, size_bytes: int) -> None:
    checks_left = (_UNSUSPECTED_STEPS + _STEPS_A_BYTE * size_bytes) // _STEPS_A_CHECK

    def check() -> bool:
        nonlocal checks_left
        checks_left -= 1
        return checks_left < 0

    database.set_progress_handler(check, _STEPS_A_CHECK)
    if sys.version_info >= (3, 11):  # earlier Pythons cannot set it
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MOST_TEXT_BYTES)


def _missing_bytes(path: Path) -> int:
    """Return how many bytes the file lacks by its header (https://www.sqlite.org/fileformat.html, 1.3)."""
    with open_regular(path) as stream:
        header = stream.read(len(SQLITE_MAGIC) + _HEADER.size)[len(SQLITE_MAGIC) :]
        size = stream.seek(0, os.SEEK_END)
    if len(header) < _HEADER.size:
        return 0  # SQLite will report what is wrong
    page_bytes, _, pages = _HEADER.unpack(header)
    return int(65536 if page_bytes == 1 else page_bytes) * int(pages) - size


def _rows_of_pages(path: Path, budget: Budget, *, in_frames: bool) -> Iterator[tuple[int, list[Any]]]:
    """Yield the rows of all leaf pages, wherever they are in the file."""
    with path.open("rb") as file:
        start = file.read(_SEARCHED_BYTES)
    _, _, header = start.partition(SQLITE_MAGIC)
    page_bytes, reserved, page_count = _HEADER.unpack_from(header.ljust(_HEADER.size, b"\0"))
    page_bytes = 65536 if page_bytes == 1 else page_bytes
    if page_bytes < 512 or page_bytes & (page_bytes - 1):
        page_bytes, reserved, page_count = _USUAL_PAGE_BYTES, 0, 0
    if not path.stat().st_size:
        return
    with path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as data:
        moved_bytes = len(data) - page_count * page_bytes
        pages = _Pages(data, page_bytes, page_bytes - reserved, moved_bytes, in_frames=in_frames)
        for match in _LEAF_PAGE.finditer(data):
            at = match.start()
            (cells,) = _CELLS.unpack_from(data, at + 3)
            if len(data) - at < page_bytes or cells > page_bytes // 4:
                continue
            page = data[at : at + page_bytes]
            offsets = struct.unpack_from(f">{cells}H", page, 8)
            if at % page_bytes and not all(8 + 2 * cells <= offset < page_bytes for offset in offsets):
                continue
            for offset in offsets:
                with suppress(ValueError, IndexError, struct.error):
                    row_id, payload = pages.cell(page, offset, at)
                    values = _values(payload)
                    budget.take()
                    yield row_id, values


class _Pages:
    """Rows of pages that may be displaced; pages of a write-ahead log are `in_frames`, each after its number."""

    def __init__(self, data: mmap, page_bytes: int, usable_bytes: int, moved_bytes: int, *, in_frames: bool) -> None:
        self._data, self._page_bytes, self._usable_bytes = data, page_bytes, usable_bytes
        self._moved_bytes, self._in_frames = moved_bytes, in_frames
        self._frames: dict[int, dict[int, int]] = {}
        self._left_bytes, self._searches_left = most_unpacked_bytes(len(data)), _MOST_SEARCHES

    def cell(self, page: bytes, offset: int, page_at: int) -> tuple[int, bytes]:
        size, offset = _varint(page, offset)
        row_id, offset = _varint(page, offset)
        if size > MAX_RECORD_BYTES:
            raise ValueError("no row is so long")
        self._left_bytes -= size
        if self._left_bytes < 0:
            raise UnreadableError("its rows share their pages")
        usable = self._usable_bytes
        least = (usable - 12) * 32 // 255 - 23
        local = least + (size - least) % (usable - 4)
        local = size if size <= usable - 35 else local if local <= usable - 35 else least
        start, remaining = page[offset : offset + local], size - local
        if not remaining:
            return row_id, start
        return row_id, start + self._overflow(
            int.from_bytes(page[offset + local : offset + local + 4], "big"), remaining, page_at
        )

    def _overflow(self, number: int, size: int, page_at: int) -> bytes:
        parts, most, moved_bytes = list[bytes](), self._usable_bytes - 4, page_at % self._page_bytes
        while size > 0:
            at = self._frame(number, page_at) if self._in_frames else self._page(number, size, moved_bytes)
            if not number or not 0 <= at <= len(self._data) - self._page_bytes:
                raise ValueError("a page is missing")
            parts.append(self._data[at + 4 : at + 4 + min(size, most)])
            size -= len(parts[-1])
            moved_bytes = at - (number - 1) * self._page_bytes
            number = self._following(at)
        if number:
            raise ValueError("more pages follow than the row has")
        return b"".join(parts)

    def _following(self, at: int) -> int:
        return int.from_bytes(self._data[at : at + 4], "big") if at >= 0 else -1

    def _frame(self, number: int, page_at: int) -> int:
        stride = self._page_bytes + _FRAME_BYTES
        if (first := page_at % stride) not in self._frames:
            start = first if first >= _FRAME_BYTES else first + stride
            self._frames[first] = {
                self._following(at - _FRAME_BYTES): at for at in range(start, len(self._data), stride)
            }
        return self._frames[first].get(number, -1)

    def _page(self, number: int, size: int, moved_bytes: int) -> int:
        """Return the offset of a page of a row with `size` bytes from it on: pages of a row have consecutive numbers."""
        after = [number + step if size > step * (self._usable_bytes - 4) else 0 for step in (1, 2)]
        usual_at = (number - 1) * self._page_bytes
        placed = [usual_at + moved for moved in (moved_bytes, self._moved_bytes, moved_bytes - self._page_bytes, 0)]
        matching = [at for at in placed if self._following(at) == after[0]]
        is_searched = bool(after[0]) and not matching and self._searches_left > 0
        self._searches_left -= is_searched
        match_at = self._data.find(after[0].to_bytes(4, "big")) if is_searched else -1
        for _ in range(_MOST_TRIES):
            if match_at < 0 or self._following(match_at + self._page_bytes) == after[1]:
                break
            match_at = self._data.find(after[0].to_bytes(4, "big"), match_at + 1)
        return [*matching, *[match_at] * (match_at >= 0), *placed][0]


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
