"""Messages of a rosbag2 database of any version; of a damaged one also the rows of pages that SQLite no longer reaches.

In single pages a row of `messages` is declared by its columns (no value, number, number, blob), one of `topics` by its texts.
"""

from __future__ import annotations

import sqlite3
import struct
import sys
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from typing import Any
from urllib.parse import quote

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.units import counted
from dds_trace.tracefile.format.bag_metadata import MOST_TOPICS, RecordedTopic
from dds_trace.tracefile.format.events import EVENT_CDR_BYTES, STAGE_OF_TOPIC, TOPIC_PREFIX, Stage, event_fault
from dds_trace.tracefile.mcapfile.file import MAX_RECORD_BYTES
from dds_trace.tracefile.mcapfile.records import crc32
from dds_trace.tracefile.reading import source

from .kinds import MOST_TEXT_BYTES, SQLITE_MAGIC
from .recorded import Condition, MessageBatch, RawMessage, batched, full_type
from .sqlite_log import open_database
from .sqlite_pages import SQLITE_HEADER, Image, Tables, rows_of_pages

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

# SQLite's steps are bounded: a hostile database has endless rows in few pages. An absurd size is reported as a lack of memory.
_UNSUSPECTED_STEPS = 100_000_000
_STEPS_A_CHECK = 1_000_000

# Every version of rosbag2's schema has these columns. Views, virtual tables and computed columns are not read.
_TABLES = "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND rootpage > 0 AND name IN ('topics', 'messages')"
_COMPUTED = (
    "SELECT (SELECT count(*) FROM pragma_table_xinfo('topics') WHERE hidden)"
    " + (SELECT count(*) FROM pragma_table_xinfo('messages') WHERE hidden)"
)
_TOPICS = "SELECT id, name, type, serialization_format, {}, {} FROM topics LIMIT {}"
_MESSAGES = "SELECT id, topic_id, timestamp, CASE WHEN length(data) <= ? THEN data END FROM messages ORDER BY id"
_NO_TABLES = "it is no rosbag2 database: no tables 'topics' and 'messages' as it makes them"
_MANY_TOPICS = f"it has more than {MOST_TOPICS} topics"


def sqlite_messages(path: Path, condition: Condition) -> Iterator[RawMessage]:
    return (message for batch in sqlite_batches(path, condition) for message in batch.messages())


def sqlite_batches(path: Path, condition: Condition) -> Iterator[MessageBatch]:
    """Yield the messages in stored order, then messages of damaged pages; what is missing goes to `condition`."""
    before = path.stat()
    budget, seen, rows = source.Budget(before.st_size), dict[int, int](), list[tuple[int, int, int, bytes]]()
    topics: dict[int, RecordedTopic] = {}
    fault, read_bytes = "", 0
    with open_database(path, condition) as (joined, files):
        surplus_bytes = 0
        try:
            surplus_bytes = 0 if joined else -_missing_bytes(files[0])
            if surplus_bytes < 0:
                fault = f"{counted(-surplus_bytes, 'byte')} of it {'is' if surplus_bytes == -1 else 'are'} missing"
            tables = _rows_by_page(joined, topics) if joined else _rows_by_sqlite(path, topics)
            read_bytes = yield from _messages(tables, topics, budget, seen, condition)
        except (sqlite3.Error, MemoryError, ValueError, IndexError, struct.error) as err:
            why = "bytes are missing" if isinstance(err, IndexError | struct.error) else err
            fault = fault or f"it is damaged ({why})"
        has_gaps = not seen or max(seen) - (min(seen) if len(files) == 1 else 1) >= len(seen)
        is_in_doubt = fault or has_gaps or surplus_bytes or 4 * read_bytes < before.st_size  # perhaps not all rows
        has_wal = any(file.log_kind == "wal" for file in files)  # perhaps of another database
        doubtful = files if is_in_doubt else files[: 2 * has_wal]
        rows = _unreached_rows(doubtful, budget, seen, topics)
        fault = fault or ("its tables do not reach all of its pages" if rows else "")
    after = path.stat()  # nobody's lock is taken: pages of two moments may have met
    if (after.st_mtime_ns, after.st_size) != (before.st_mtime_ns, before.st_size):
        fault = "it was written while it was read: read it again when its recorder has ended"
    if fault:
        topics = {row_id: topic for row_id, topic in topics.items() if topic.name.startswith("/")}
        if not topics:
            raise source.UnreadableError(f"it is no rosbag2 database that can be read: {fault}")
        more = f"; {counted(len(rows), 'message')} from single pages" if rows else ""
        condition.damages.append(f"{fault}{more}")
    condition.topics |= set(topics.values())
    messages = (RawMessage(topics[at], time_ns, None, None, data) for _, at, time_ns, data in rows if at in topics)
    yield from batched(messages)


def _messages(
    rows: Iterator[Sequence[Any]],
    topics: dict[int, RecordedTopic],
    budget: source.Budget,
    seen: dict[int, int],
    condition: Condition,
) -> Generator[MessageBatch, None, int]:
    read_bytes = 0
    for part in source.in_parts(rows):
        count = budget.take(len(part))
        rows_of_topics = [row for row in part[:count] if row[1] in topics]
        # Columns of SQLite have no fixed type: a damaged page may contain anything.
        stored = [row for row in rows_of_topics if isinstance(row[3], bytes)]
        seen.update(zip(map(itemgetter(0), stored), map(crc32, map(itemgetter(3), stored)), strict=True))
        timed = [row for row in stored if isinstance(row[2], int)]
        if len(timed) < len(rows_of_topics):
            others = (row for row in rows_of_topics if not isinstance(row[3], bytes) or not isinstance(row[2], int))
            condition.unreadable.update(topics[row[1]].name for row in others)
        if timed:
            _, topic_ids, times_ns, contents = zip(*timed, strict=True)
            read_bytes += sum(map(len, contents))
            yield MessageBatch.of_columns(topics, topic_ids, times_ns, contents)
        if count < len(part):
            budget.take()
    return read_bytes


def _rows_by_sqlite(path: Path, topics: dict[int, RecordedTopic]) -> Iterator[Sequence[Any]]:
    """Yield the rows of a database that has no log; SQLite opens nothing else and makes no file next to it (`immutable`)."""
    with closing(sqlite3.connect(f"file:{quote(str(path))}?mode=ro&immutable=1", uri=True)) as database:
        _bound_work(database, path.stat().st_size)
        topics |= _read_topics(database)
        if sys.version_info >= (3, 11):
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_RECORD_BYTES + MOST_TEXT_BYTES)
        yield from database.execute(_MESSAGES, [MAX_RECORD_BYTES])


def _rows_by_page(joined: Image, topics: dict[int, RecordedTopic]) -> Iterator[Sequence[Any]]:
    tables = Tables(joined)
    if "topics" not in tables or "messages" not in tables:
        raise source.UnreadableError(_NO_TABLES)
    definitions = dict[str, tuple[str, str]]()
    for name in ("topics", "message_definitions"):
        for row_id, values in tables.rows(name) if name in tables else ():
            _take_description(row_id, values, topics, definitions)
            if len(topics) > MOST_TOPICS:
                raise source.UnreadableError(_MANY_TOPICS)
    _add_definitions(topics, definitions)
    for row_id, values in tables.rows("messages"):
        yield row_id, *values[1:4]


def _unreached_rows(
    files: list[Image], budget: source.Budget, seen: dict[int, int], topics: dict[int, RecordedTopic]
) -> list[tuple[int, int, int, bytes]]:
    rows, definitions = list[tuple[int, int, int, bytes]](), dict[str, tuple[str, str]]()
    stored = {*seen.items()} if files else set()
    for row_id, values in (row for file in files for row in rows_of_pages(file, budget)):
        if [type(value) for value in values] != [type(None), int, int, bytes]:
            _take_description(row_id, values, topics, definitions)
        elif (row_id, crc := crc32(values[3])) not in stored:
            stored.add((row_id, crc))
            rows.append((row_id, values[1], values[2], values[3]))
    _add_definitions(topics, definitions)
    return sorted(rows)


def _take_description(
    row_id: int, values: list[Any], topics: dict[int, RecordedTopic], definitions: dict[str, tuple[str, str]]
) -> None:
    kinds = [type(value) for value in values]
    if kinds == [type(None), str, str, str, str] and values[2] in {"ros2msg", "ros2idl"}:
        definitions[full_type(values[1])] = values[3], values[2]
    elif kinds[:4] == [type(None), str, str, str] and len(values[4:]) <= 2 and values[1].startswith("/"):
        qos, type_hash = (value if isinstance(value, str) else "" for value in [*values[4:], "", ""][:2])
        if row_id not in topics or not topics[row_id].name.startswith("/"):
            topics[row_id] = RecordedTopic(values[1], full_type(values[2]), values[3], qos=qos, type_hash=type_hash)


def _add_definitions(topics: dict[int, RecordedTopic], definitions: dict[str, tuple[str, str]]) -> None:
    for row_id, topic in topics.items():
        if not topic.definition and topic.message_type in definitions:
            text, encoding = definitions[topic.message_type]
            topics[row_id] = replace(topic, definition=text, definition_encoding=encoding)


def _read_topics(database: sqlite3.Connection) -> dict[int, RecordedTopic]:
    database.execute("PRAGMA trusted_schema = OFF")
    ((tables,),) = database.execute(_TABLES)
    ((computed,),) = database.execute(_COMPUTED)
    if tables != 2 or computed:
        raise source.UnreadableError(_NO_TABLES)
    columns = {row[1] for row in database.execute("PRAGMA table_info(topics)")}
    later = [name if name in columns else "''" for name in ("offered_qos_profiles", "type_description_hash")]
    rows = database.execute(_TOPICS.format(*later, MOST_TOPICS + 1)).fetchall()
    if len(rows) > MOST_TOPICS:
        raise source.UnreadableError(_MANY_TOPICS)
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
        if isinstance(name, str)
        and isinstance(row_id, int)
        and "/" in (name[:1], *str(kind))  # else a row of another table
    }


def _bound_work(database: sqlite3.Connection, size_bytes: int) -> None:
    checks_left = (_UNSUSPECTED_STEPS + 4 * size_bytes) // _STEPS_A_CHECK

    def check() -> bool:
        nonlocal checks_left
        checks_left -= 1
        return checks_left < 0

    database.set_progress_handler(check, _STEPS_A_CHECK)
    if sys.version_info >= (3, 11):  # earlier Pythons cannot set it
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_TEXT_BYTES)


def _missing_bytes(database: Image) -> int:
    """Return how many bytes the file lacks by its header (https://www.sqlite.org/fileformat.html, 1.3)."""
    header = database[len(SQLITE_MAGIC) : len(SQLITE_MAGIC) + SQLITE_HEADER.size]
    if len(header) < SQLITE_HEADER.size:
        return 0  # SQLite will report what is wrong
    page_bytes, _, pages = SQLITE_HEADER.unpack(header)
    return int(65536 if page_bytes == 1 else page_bytes) * int(pages) - len(database)


class SqliteSource:
    written_events = 0

    def __init__(self, path: Path, shown_as: Path | None = None) -> None:
        self._path, self._shown_as, self._condition = path, shown_as or path, Condition()

    def close(self) -> None:
        """Do nothing: the database is closed after its last row."""

    @property
    def topics(self) -> frozenset[str]:
        return frozenset(topic.name for topic in self._condition.topics)

    def expected_events(self) -> dict[Stage, int]:
        return dict.fromkeys(Stage, self._path.stat().st_size // EVENT_CDR_BYTES)

    def batches(self) -> Iterator[source.Batch]:
        last, faulty = source.Batch(), dict[str, str]()
        try:
            for messages in sqlite_batches(self._path, self._condition):
                events, texts = list[tuple[Stage, bytes]](), list[source.Text]()
                for topic, log_ns, _, _, data in messages.messages():
                    stage = STAGE_OF_TOPIC.get(topic.name)
                    if stage and (fault := event_fault(stage, topic.encoding, topic.message_type)):
                        faulty[topic.name] = fault
                        last.unreadable += 1
                    elif stage:
                        events.append((stage, source.unpack_message(data)))
                    elif topic.name.startswith(TOPIC_PREFIX):
                        texts.append(source.Text(topic.name, log_ns, source.unpack_message(data), self._shown_as, None))
                yield replace(source.event_batch(events), texts=texts)
        except source.UnreadableError as err:
            if not self._condition.topics:
                raise TraceFormatError(self._shown_as, f"not a rosbag2 database ({err})") from err
            self._condition.damages.append(str(err))
        last.truncated = "; ".join(f"ends early, {damage}" for damage in self._condition.damages) or None
        last.unreadable += sum(self._condition.unreadable[name] for name in STAGE_OF_TOPIC)
        last.notes = [f"messages of {name} are not used: {why}" for name, why in faulty.items()]
        yield last
