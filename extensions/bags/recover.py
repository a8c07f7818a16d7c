"""Recovery of recordings of other programs in new files; the originals stay."""

from __future__ import annotations

import os
import secrets
import shutil
import sqlite3
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from mcap.records import Attachment, Channel, Header, Metadata, Schema

from dds_trace.base.errors import OutputExistsError, TraceFormatError
from dds_trace.base.files import flush_to_disk, mode_within, output_error
from dds_trace.base.printable import printable
from dds_trace.base.units import counted, first_of, format_duration, utc_words
from dds_trace.base.version import __version__
from dds_trace.tracefile.format.bag_metadata import MOST_TOPICS, BagFile, RecordedTopic, write_bag_metadata
from dds_trace.tracefile.format.encoding import MAGIC
from dds_trace.tracefile.format.ring import RING_SUFFIX, ring_path
from dds_trace.tracefile.mcapfile.file import RecordFile
from dds_trace.tracefile.mcapfile.records import topic_of
from dds_trace.tracefile.reading.mcap_walk import McapWalk
from dds_trace.tracefile.reading.source import UnreadableError
from dds_trace.tracefile.reading.storage import ZSTD_SUFFIX
from dds_trace.tracefile.writing.event_chunks import LIBRARY, encode_record

from .bag1 import bag1_messages
from .bounds import SHOWN
from .kinds import function_at
from .mcap_copy import McapCopy
from .read import REMAINDER, REMAINDER_ID, McapItems, gone_of, is_remainder, kind_of, mark_of, open_recording
from .recorded import LATEST_NS, Condition, Int64, MessageBatch
from .sqlite_rows import SQLITE_TABLES, sqlite_messages

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

_OWN_START = MAGIC + encode_record(Header(profile="ros2", library=LIBRARY))
MOST_CHANNELS = np.iinfo(np.uint16).max
"""Ids of channels are of 16 bits, and the writer counts from 1."""


@dataclass(slots=True)
class RecordingRecovery:
    path: Path
    recovered: Path
    messages: int = 0
    doubtful: int = 0
    unchecked: int = 0
    first_ns: int = LATEST_NS
    last_ns: int = 0
    damages: list[str] = field(default_factory=list)
    gone: Counter[str] = field(default_factory=Counter)
    counted: str = ""
    """How many messages the original counts, and where."""

    def lines(self) -> list[str]:
        doubtful = f"; {self.doubtful:,} of them, out of damaged chunks, may be damaged" if self.doubtful else ""
        damages = first_of(self.damages, SHOWN, "more like these") or ["nothing was damaged"] * (not self.gone)
        if self.counted and (self.damages or self.gone):
            by_topic = first_of([f"{count:,} of {printable(topic)}" for topic, count in self.gone.items()], SHOWN)
            lost = f"{self.gone.total():,} of {self.counted} are not in it"
            damages = [f"{lost}: {', '.join(by_topic)}" if by_topic else lost, *damages]
        if self.unchecked:
            unchecked = counted(self.unchecked, "message has", "messages have")
            damages = [*damages, f"{unchecked} no checksum: damage inside is not seen"]
        original = f"The original is left as it is: {self.path}"
        span = f"{format_duration(self.last_ns - self.first_ns)} from {utc_words(self.first_ns)}"
        return [f"{counted(self.messages, 'message')} recovered, {span}{doubtful}", *damages, original]


@dataclass(slots=True)
class NewFile:
    path: Path
    messages: int = 0
    unchecked: int = 0
    first_ns: int = LATEST_NS
    last_ns: int = 0
    topics: Counter[RecordedTopic] = field(default_factory=Counter)
    counted: Counter[str] = field(default_factory=Counter)
    gone: Counter[str] = field(default_factory=Counter)

    def add(self, topic: RecordedTopic, count: int, first_ns: int, last_ns: int) -> None:
        self.messages += count
        self.first_ns, self.last_ns = min(self.first_ns, first_ns), max(self.last_ns, last_ns)
        self.topics[topic] += count

    @property
    def described(self) -> BagFile:
        first_ns = self.first_ns if self.messages else 0
        return BagFile(self.path.name, first_ns, min(self.last_ns, LATEST_NS) - first_ns, self.messages)


def is_of_others(path: Path) -> bool:
    """Return whether a recording is not a trace of ours: by its first record, unless a ring is next to it."""
    trace = path / f"{path.name}_0.mcap" if path.is_dir() else path
    if path.name.endswith(RING_SUFFIX) or ring_path(trace).exists() or not path.exists():
        return False
    if not trace.exists() or trace.suffix == ".db3":
        return True
    with closing(RecordFile(trace)) as file:
        header = McapWalk(file).header
        if file.size <= len(MAGIC) or header is not None:
            return header is not None and not header.library.startswith(LIBRARY)
        return LIBRARY.encode() not in file.read(0, min(len(_OWN_START), file.size))


def recover_recording(path: Path, destination: Path | None = None) -> RecordingRecovery:
    """Write every whole message into a new recording next to the original: `NAME.recovered.mcap`, or `NAME-recovered` of a folder."""
    path = path if path.name else path.absolute()
    is_folder = path.is_dir()
    name = f"{path.name}-recovered" if is_folder else f"{path.stem}.recovered{path.suffix}"
    target = path.with_name(name) if destination is None else destination
    _check_free(target)
    draft = target.with_name(
        f"{target.name}.{secrets.token_hex(4)}.part"
    )  # killed, it is not in the way of the next one
    try:
        report = _recover_into(draft, path, target)
        _check_free(target)
        draft.rename(target)
    except BaseException:
        if is_folder:
            shutil.rmtree(draft, ignore_errors=True)
        else:
            draft.unlink(missing_ok=True)
        raise
    return report


def _check_free(target: Path) -> None:
    if os.path.lexists(target):
        raise OutputExistsError(f"{target} is there already; choose another name with --out")


def _recover_into(draft: Path, path: Path, target: Path) -> RecordingRecovery:
    is_folder = path.is_dir()
    report, written = RecordingRecovery(path, target), list[NewFile]()
    with open_recording(path) as recording:
        described = recording.condition
        report.damages += described.damages
        try:
            (draft if is_folder else draft.parent).mkdir(parents=True, exist_ok=True)
            for source, original in zip(recording.files, recording.names, strict=True):
                new = NewFile(draft / original.name.removesuffix(ZSTD_SUFFIX) if is_folder else draft)
                try:
                    damages, doubtful = function_at(kind_of(source).recover)(source, new)
                except (TraceFormatError, UnreadableError) as err:
                    report.damages.append(f"{original.name}: {err.what if isinstance(err, TraceFormatError) else err}")
                    new.path.unlink(missing_ok=True)
                    continue
                new.path.chmod(mode_within(original.stat().st_mode))
                flush_to_disk(new.path)
                report.damages += [f"{original.name}: {damage}" for damage in damages]
                report.messages += new.messages
                report.first_ns, report.last_ns = min(report.first_ns, new.first_ns), max(report.last_ns, new.last_ns)
                report.doubtful += doubtful
                report.unchecked += new.unchecked
                written.append(new)
                report.gone += new.gone
            claims = described.claimed or sum((new.counted for new in written), Counter[str]())
            where = "metadata.yaml" if described.claimed else "its statistics"
            total = counted(sum(claims.values()) + described.gone.total(), "message")
            report.counted = f"{total} counted in {where}" if claims else ""
            report.gone |= _lacking(described.claimed, written) + described.gone
            if is_folder and written:
                topics = [item for new in written for item in new.topics.items()]
                storage = kind_of(written[0].path).storage
                is_remainder = described.is_remainder or bool(report.damages or report.gone)
                mark = {REMAINDER: mark_of(report.gone)} if is_remainder else {}
                write_bag_metadata(draft, storage, [new.described for new in written], topics, custom=mark)
        except OSError as err:
            raise output_error(target, err, "the recording") from err
        except sqlite3.Error as err:
            raise output_error(target, OSError(0, str(err)), "the recording") from err
    if not report.messages:
        raise TraceFormatError(path, f"holds no whole message: {'; '.join(report.damages[:3]) or 'it is empty'}")
    return report


def _lacking(claimed: Mapping[str, int], written: Iterable[NewFile]) -> Counter[str]:
    delivered = Counter[str]()
    for topic, count in (item for new in written for item in new.topics.items()):
        delivered[topic.name] += count
    return Counter(claimed) - delivered


class _NewChannels:
    def __init__(self, copy: McapCopy, walked: McapItems, new: NewFile) -> None:
        self._copy, self._walked, self._new = copy, walked, new
        self._schemas: dict[tuple[int, str], int] = {}
        self._ids: dict[tuple[int, str, int], int] = {}

    def id_of(self, channel: Channel) -> int:
        key = channel.id, channel.topic, channel.schema_id
        if key not in self._ids:
            if len(self._ids) == MOST_CHANNELS:
                return 0
            schema, schema_id = self._walked.channels.schemas.get(channel.schema_id), 0
            if schema is not None:
                if (schema.id, schema.name) not in self._schemas:
                    new_id = self._copy.add_schema(schema.name, schema.encoding, _definition(schema))
                    self._schemas[schema.id, schema.name] = new_id
                schema_id = self._schemas[schema.id, schema.name]
            self._ids[key] = self._copy.add_channel(channel, schema_id)
            self._new.topics.setdefault(topic_of(channel, self._walked.channels.schemas), 0)
        return self._ids[key]

    def ids_of(self, batch: MessageBatch) -> Int64:
        indices, firsts, inverse, counts = np.unique(
            batch.topic, return_index=True, return_inverse=True, return_counts=True
        )
        new_ids = np.zeros(len(indices), np.int64)
        for at in np.argsort(firsts).tolist():
            new_ids[at] = self.id_of(self._walked.records[indices[at]])
            if new_ids[at]:
                range_ns = int(batch.log_ns.min()), int(batch.log_ns.max())
                self._new.add(batch.topics[indices[at]], int(counts[at]), *range_ns)
        return new_ids[inverse]


def recover_mcap(source: Path, new: NewFile) -> tuple[list[str], int]:
    with closing(RecordFile(source)) as file, new.path.open("xb") as stream:
        walked = McapItems(file)
        items = iter(walked)
        item = next(items, None)  # now the header and the first chunk's compression are known
        library = walked.header.library if walked.header else "unknown"
        library, marks = f"{library}; recovered by {LIBRARY} {__version__}", list[Metadata]()
        copy, left_out = McapCopy(stream, _profile(walked), library, is_packed=not walked.walk.is_unpacked), 0
        channels = _NewChannels(copy, walked, new)
        while item is not None:
            if isinstance(item, Attachment):
                copy.add_attachment(item)
            elif isinstance(item, Metadata):
                (marks.append if item.name == REMAINDER else copy.add_metadata)(item)
            else:
                channel_ids = channels.ids_of(item)
                has_channel = channel_ids > 0
                left_out += int((~has_channel).sum())
                copy.add_messages(item.selected(has_channel), channel_ids[has_channel])
            item = next(items, None)
        unused = [channel for _, channel in walked.channels.items() if not channels.id_of(channel.record)]
        for channel_id, count in (walked.walk.claimed or {}).items() if walked.walk.is_checked else ():
            if declared := walked.channels.get(channel_id):
                new.counted[declared.topic] += count
        new.gone = sum((gone_of(mark.metadata.get(REMAINDER, "")) for mark in marks), _lacking(new.counted, [new]))
        if marks or walked.walk.damages or new.gone:
            copy.add_metadata(Metadata(name=REMAINDER, metadata={REMAINDER: mark_of(new.gone)}))
        copy.finish()
    new.unchecked = walked.unchecked
    lost = f"{counted(left_out, 'message')} of further ones, and {counted(len(unused), 'channel')} without any, are left out"
    beyond = f"it declares more than {MOST_CHANNELS:,} channels, which no MCAP file can have: {lost}"
    return [*walked.walk.damages, *[beyond] * (left_out + len(unused) > 0)], walked.doubtful


def _definition(schema: Schema) -> bytes:
    """Return the definition of a type; nothing if it is damaged text, so that a reader that knows the type opens the file."""
    is_text = schema.encoding in {"ros1msg", "ros2msg", "ros2idl"}
    return b"" if is_text and not _is_text(schema.data.decode(errors="surrogateescape")) else schema.data


def _is_text(text: str) -> bool:
    return all(letter.isprintable() or letter.isspace() for letter in text)


def _profile(walked: McapItems) -> str:
    encodings = {schema.encoding for schema in walked.channels.schemas.values()}
    implied = "ros2" if encodings & {"ros2msg", "ros2idl"} else "ros1" if "ros1msg" in encodings else ""
    profile = walked.header.profile if walked.header else implied
    return profile if profile in {"", "ros1", "ros2"} or not implied else implied


def recover_sqlite(source: Path, new: NewFile) -> tuple[list[str], int]:
    condition, ids = Condition(), dict[RecordedTopic, int]()
    messages = sqlite_messages(source, condition)
    with closing(sqlite3.connect(new.path)) as database:
        database.executescript(SQLITE_TABLES)

        def declared(topic: RecordedTopic) -> int:
            if topic not in ids:
                ids[topic] = len(ids) + 1
                row = (ids[topic], topic.name, topic.message_type, topic.encoding, topic.qos, topic.type_hash)
                database.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)", row)
                if topic.definition and _is_text(topic.definition):
                    definition = (topic.message_type, topic.definition_encoding, topic.definition, topic.type_hash)
                    database.execute(
                        "INSERT INTO message_definitions (topic_type, encoding, encoded_message_definition, "
                        "type_description_hash) VALUES (?, ?, ?, ?)",
                        definition,
                    )
                new.topics.setdefault(topic, 0)
            return ids[topic]

        for message in messages:
            row = (declared(message.topic), message.log_ns, message.data)
            database.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", row)
            new.add(message.topic, 1, message.log_ns, message.log_ns)
        for topic in condition.topics:
            declared(topic)
        if condition.damages or is_remainder(source):
            database.execute(f"PRAGMA application_id = {int.from_bytes(REMAINDER_ID, 'big')}")
        database.commit()
    return condition.damages, 0


def recover_bag1(source: Path, new: NewFile) -> tuple[list[str], int]:
    try:
        from rosbags.rosbag1 import Writer as Bag1Writer  # noqa: PLC0415 - only ROS 1 bags need it
    except ImportError as err:
        raise UnreadableError("writing a ROS 1 bag needs the package rosbags: pip install 'dds-trace[bags]'") from err
    condition = Condition()
    connections: dict[RecordedTopic, Connection] = {}
    bag = Bag1Writer(new.path)
    bag.set_compression(Bag1Writer.CompressionFormat.LZ4)
    with bag:
        for message in bag1_messages(source, condition):
            topic = message.topic
            if topic not in connections and len(connections) == MOST_TOPICS:  # rosbags compares each with all others
                raise UnreadableError(f"it has more than {MOST_TOPICS} topics")
            if topic not in connections:
                connections[topic] = bag.add_connection(
                    topic.name,
                    topic.message_type,
                    msgdef=topic.definition,
                    md5sum=topic.type_hash or "*",
                    callerid=topic.publisher or None,
                    latching=1 if topic.qos else None,
                )
            bag.write(connections[topic], message.log_ns, message.data)
            new.add(message.topic, 1, message.log_ns, message.log_ns)
    return condition.damages, 0
