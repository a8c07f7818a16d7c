"""Messages of one rosbag2 SQLite file (`.db3`) as batches."""

from __future__ import annotations

import os
import sqlite3
import struct
import sys
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from urllib.parse import quote

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.files import open_regular
from dds_trace.base.units import counted

from ..format.events import EVENT_SCHEMA_NAME, STAGE_OF_TOPIC, TOPIC_PREFIX, Stage
from .source import Batch, Text, event_batch, unpack_message

_HEADER = struct.Struct(">16xH10xI")  # page size, pages
# SQLite reports an absurd size as a lack of memory.
SQLITE_ERRORS = (sqlite3.Error, MemoryError)
_BATCH_ROWS = 8192
_BATCH_BYTES = 4 << 20

_MOST_TOPICS = 10_000

# A hostile database has endless rows in few pages: reused pages, computed columns. SQLite's steps are bounded, its rows (a
# recorded event needs 77 bytes), and their bytes.
_UNSUSPECTED_STEPS = 100_000_000
_STEPS_A_BYTE = 4
_STEPS_A_CHECK = 1_000_000
_UNSUSPECTED_ROWS = 2_000_000
_ROW_BYTES = 64
_LONGEST_VALUE_BYTES = 2 * _BATCH_BYTES

# Every version of rosbag2's schema has these columns. Views, virtual tables and computed columns are not read.
TABLES = "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND rootpage > 0 AND name IN ('topics', 'messages')"
COMPUTED = (
    "SELECT (SELECT count(*) FROM pragma_table_xinfo('topics') WHERE hidden)"
    " + (SELECT count(*) FROM pragma_table_xinfo('messages') WHERE hidden)"
)
_TOPICS = "SELECT id, name, type, serialization_format FROM topics LIMIT ?"
_LAST_ROW = "SELECT max(id) FROM messages"
_MESSAGES = (
    "SELECT topic_id, timestamp, CASE WHEN length(data) <= {limit} THEN data END"
    " FROM messages WHERE topic_id IN ({ids}) ORDER BY id"
)


class SqliteSource:
    """`.db3` file as a `Source`."""

    def __init__(self, path: Path, shown_as: Path | None = None) -> None:
        self._shown_as = shown_as or path
        with ExitStack() as undo:
            try:
                self._size = path.stat().st_size
                self._missing_bytes = missing_bytes(path)
                self._database = sqlite3.connect(f"file:{quote(str(path))}?mode=ro", uri=True)
                undo.callback(self.close)
                bound_work(self._database, self._size)
                self._database.execute("PRAGMA trusted_schema = OFF")
                if self._one(TABLES) != 2 or self._one(COMPUTED):
                    raise TraceFormatError(
                        self._shown_as, "not a rosbag2 database: no tables 'topics' and 'messages' as it makes them"
                    )
                topics = self._database.execute(_TOPICS, [_MOST_TOPICS + 1]).fetchall()
                if len(topics) > _MOST_TOPICS:
                    raise TraceFormatError(self._shown_as, f"not a rosbag2 database: more than {_MOST_TOPICS} topics")
                self._last_row = self._one(_LAST_ROW)
            except (*SQLITE_ERRORS, OSError, ValueError) as err:
                raise TraceFormatError(self._shown_as, f"not a rosbag2 database ({err!r})") from err
            undo.pop_all()
        # Columns of SQLite have no fixed type: a damaged page may contain anything.
        self._topics: list[tuple[int, str, str, str]] = [
            row for row in topics if isinstance(row[0], int) and isinstance(row[1], str)
        ]

    def close(self) -> None:
        self._database.close()

    @property
    def topics(self) -> frozenset[str]:
        return frozenset(name for _, name, *_ in self._topics)

    @property
    def written_events(self) -> int:
        return 0

    def expected_events(self) -> dict[Stage, int]:
        last_row = self._last_row if isinstance(self._last_row, int) else 0
        return dict.fromkeys(Stage, max(0, min(self._size, last_row)))

    def batches(self) -> Iterator[Batch]:
        rows_left, bytes_left = _UNSUSPECTED_ROWS + self._size // _ROW_BYTES, max(self._size, _BATCH_BYTES)
        names = {topic_id: name for topic_id, name, *_ in self._topics}
        ours = {topic_id: name for topic_id, name in names.items() if name.startswith(TOPIC_PREFIX)}
        faults = self._faults()
        ids = ",".join(map(str, ours))
        last = Batch(notes=[f"messages of {names[topic_id]} are not used: {why}" for topic_id, why in faults.items()])
        rows = _Rows(self._shown_as)
        try:
            with closing(self._database.execute(_MESSAGES.format(limit=_BATCH_BYTES, ids=ids))) as cursor:
                for topic_id, timestamp, data in cursor:
                    rows.add(ours[topic_id], timestamp, data, faulty=topic_id in faults)
                    rows_left -= 1
                    bytes_left -= len(data) if isinstance(data, bytes) else 0
                    if rows_left < 0 or bytes_left < 0:
                        last.truncated = "ends early: it has more rows, or larger ones, than so few bytes can hold"
                        break
                    if rows.full:
                        yield from rows.batches()
                        rows = _Rows(self._shown_as)
            if self._missing_bytes > 0 and not last.truncated:
                last.truncated = (
                    f"ends early, {counted(self._missing_bytes, 'byte')} of the database "
                    f"{'is' if self._missing_bytes == 1 else 'are'} missing"
                )
        except SQLITE_ERRORS as err:
            last.truncated = f"ends early, the database is damaged ({err!r}); all rows before are used"
        yield from rows.batches()
        yield last

    def _faults(self) -> dict[int, str]:
        faults = {}
        for topic_id, name, kind, encoding in self._topics:
            if name in STAGE_OF_TOPIC and encoding != "cdr":
                faults[topic_id] = f"they are encoded as {encoding!r}, not 'cdr'"
            elif name in STAGE_OF_TOPIC and kind != EVENT_SCHEMA_NAME:
                faults[topic_id] = f"their type is {kind!r}, not {EVENT_SCHEMA_NAME!r}"
        return faults

    def _one(self, query: str) -> object:
        (value,) = self._database.execute(query).fetchone()
        return value


def bound_work(database: sqlite3.Connection, size_bytes: int, longest_bytes: int = _LONGEST_VALUE_BYTES) -> None:
    checks_left = (_UNSUSPECTED_STEPS + _STEPS_A_BYTE * size_bytes) // _STEPS_A_CHECK

    def check() -> bool:
        nonlocal checks_left
        checks_left -= 1
        return checks_left < 0

    database.set_progress_handler(check, _STEPS_A_CHECK)
    if sys.version_info >= (3, 11):  # earlier Pythons cannot set it
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, longest_bytes)


def missing_bytes(path: Path) -> int:
    """Return how many bytes the file lacks by its header (https://www.sqlite.org/fileformat.html, 1.3)."""
    with open_regular(path) as stream:
        header = stream.read(_HEADER.size)
        size = stream.seek(0, os.SEEK_END)
    if len(header) < _HEADER.size:
        return 0  # SQLite will report what is wrong
    page_bytes: int
    pages: int
    page_bytes, pages = _HEADER.unpack(header)
    return (65536 if page_bytes == 1 else page_bytes) * pages - size


class _Rows:
    def __init__(self, path: Path) -> None:
        self._path = path
        self._events: list[tuple[Stage, bytes]] = []
        self._texts: list[Text] = []
        self._unreadable = 0
        self._bytes = 0

    def add(self, topic: str, timestamp: object, data: object, *, faulty: bool) -> None:
        stage = STAGE_OF_TOPIC.get(topic)
        if not isinstance(data, bytes) or not isinstance(timestamp, int) or faulty:
            self._unreadable += stage is not None
            return
        self._bytes += len(data)
        if stage:
            self._events.append((stage, unpack_message(data)))
        else:
            self._texts.append(Text(topic, timestamp, unpack_message(data), self._path, None))

    @property
    def full(self) -> bool:
        return len(self._events) >= _BATCH_ROWS or self._bytes >= _BATCH_BYTES

    def batches(self) -> Iterator[Batch]:
        batch = event_batch(self._events)
        batch.texts = self._texts
        batch.unreadable += self._unreadable
        yield batch
