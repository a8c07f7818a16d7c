"""A rosbag2 database (`.db3`) as batches."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base.errors import TraceFormatError

from ..format.events import EVENT_SCHEMA_NAME, STAGE_OF_TOPIC, TOPIC_PREFIX, Stage
from .recorded import Condition, RecordedTopic, UnreadableError
from .source import Batch, Text, event_batch, unpack_message
from .sqlite_rows import sqlite_messages

if TYPE_CHECKING:
    from collections.abc import Iterator

_BATCH_ROWS = 8192
_ROW_BYTES = 64
_BATCH_BYTES = 4 << 20


class SqliteSource:
    """`.db3` file as a `Source`."""

    written_events = 0

    def __init__(self, path: Path, shown_as: Path | None = None) -> None:
        self._path, self._shown_as, self._condition = path, shown_as or path, Condition()

    def close(self) -> None:
        """Do nothing: the database is closed after its last row."""

    @property
    def topics(self) -> frozenset[str]:
        return frozenset(topic.name for topic in self._condition.topics)

    def expected_events(self) -> dict[Stage, int]:
        return dict.fromkeys(Stage, self._path.stat().st_size // _ROW_BYTES)

    def batches(self) -> Iterator[Batch]:
        last, events, texts, size_bytes = Batch(), list[tuple[Stage, bytes]](), list[Text](), 0
        faulty = dict[str, str]()
        try:
            for topic, log_ns, _, _, data in sqlite_messages(self._path, self._condition):
                stage = STAGE_OF_TOPIC.get(topic.name)
                if stage and (fault := _fault(topic)):
                    faulty[topic.name] = fault
                    last.unreadable += 1
                elif stage:
                    events.append((stage, unpack_message(data)))
                elif topic.name.startswith(TOPIC_PREFIX):
                    texts.append(Text(topic.name, log_ns, unpack_message(data), self._shown_as, None))
                size_bytes += len(data)
                if len(events) >= _BATCH_ROWS or size_bytes >= _BATCH_BYTES:
                    yield from _batches(events, texts)
                    events, texts, size_bytes = [], [], 0
        except UnreadableError as err:
            if not self._condition.topics:
                raise TraceFormatError(self._shown_as, f"not a rosbag2 database ({err})") from err
            self._condition.damages.append(str(err))
        yield from _batches(events, texts)
        last.truncated = "; ".join(f"ends early, {damage}" for damage in self._condition.damages) or None
        last.unreadable += sum(self._condition.unreadable[name] for name in STAGE_OF_TOPIC)
        last.notes = [f"messages of {name} are not used: {why}" for name, why in faulty.items()]
        yield last


def _batches(events: list[tuple[Stage, bytes]], texts: list[Text]) -> Iterator[Batch]:
    batch = event_batch(events)
    batch.texts = texts
    yield batch


def _fault(topic: RecordedTopic) -> str:
    if topic.encoding != "cdr":
        return f"they are encoded as {topic.encoding!r}, not 'cdr'"
    return (
        ""
        if topic.message_type == EVENT_SCHEMA_NAME
        else f"their type is {topic.message_type!r}, not {EVENT_SCHEMA_NAME!r}"
    )
