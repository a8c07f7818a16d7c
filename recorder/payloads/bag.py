"""`bag:PATH#TOPIC`: the messages of a rosbag1, rosbag2 or MCAP file, with our stamp in their header."""

from __future__ import annotations

from contextlib import contextmanager, nullcontext
from difflib import get_close_matches
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.tracefile.format.bag_metadata import METADATA_NAME

from ..errors import StoppedError
from .base import DataType, Message, Payload, Source, check_size, check_stop
from .header import recognize_data_type

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection
    from rosbags.typesys.store import Typestore

    from dds_trace.tracefile.reading.recording_files import RecordingFiles

HEADER_TYPE = "std_msgs/msg/Header"
_UNEVEN = 1.5
"""Typical rate over mean rate from which on both are named: pauses, batches, a clock that was set."""
NAMED_FIELD = 2
"""rosbags' mark of a field that is a message."""


def load_payload(where: str, own_types: Mapping[str, DataType], stop: threading.Event | None = None) -> Payload:
    """Read the messages of `PATH#TOPIC` as CDR with room for the stamp, and their mean rate.

    Raises:
        OptionError: the bag, the topic or its type cannot be used.
        BackendUnavailableError: rosbags is not installed.
    """
    from dds_trace.tracefile.reading.recording_files import content_hash, copied_messages, missing_messages  # noqa: PLC0415 - SQLite

    name, topic = split_topic(where)
    path = Path(name)
    if path.exists() and not (path.is_file() or path.is_dir()):  # a pipe would wait for a writer
        raise OptionError(f"--data bag:{where}: {path} is not a file or a folder")
    with _open_reader(path) as (reader, unpack, recording):
        connections = _connections_of(reader, topic, path)
        type_name = connections[0].msgtype
        stamper = _Stamper(reader, type_name, path, own_types)
        messages, times_ns, size_bytes = [], [], 0
        contents = set()
        for _, time_ns, data in reader.messages(connections):
            check_stop(stop)
            check_size(size_bytes + len(data), path)
            unpacked = unpack(data) if reader.is2 else data
            contents.add((time_ns, content_hash(unpacked)))
            message = stamper(unpacked)
            messages.append(message)
            times_ns.append(time_ns)
            size_bytes += len(message.data)
            check_size(size_bytes, path)
    if not messages:
        raise OptionError(f"--data bag:{where}: the bag has no messages of that topic")
    name = connections[0].topic
    notes = [*recording.notes]
    if name in recording.claimed:
        notes += missing_messages({name: recording.claimed[name]}, {name: len(messages)}, METADATA_NAME)
    notes += copied_messages(name, len(messages) - len(contents))
    rate_hz, typical_hz = _rates_hz(times_ns)
    if rate_hz and typical_hz and typical_hz > _UNEVEN * rate_hz:
        notes.append(f"{name} has {rate_hz:.3g} Hz in the mean, typically {typical_hz:.3g} Hz: choose with --rate")
    return Payload(
        stamper.data_type,
        tuple(messages),
        max(message.payload_bytes for message in messages),
        rate_hz=rate_hz,
        source=f"bag:{where}",
        notes=tuple(notes),
    )


def _rates_hz(times_ns: Sequence[int]) -> tuple[float | None, float | None]:
    """Return the mean rate, and one from the median interval."""
    intervals_ns = sorted(after - before for before, after in pairwise(times_ns))
    span_ns = sum(intervals_ns)
    typical_ns = intervals_ns[len(intervals_ns) // 2] if intervals_ns else 0
    return len(intervals_ns) / span_ns * 1e9 if span_ns > 0 else None, 1e9 / typical_ns if typical_ns > 0 else None


def split_topic(where: str) -> tuple[str, str]:
    """Split `PATH#TOPIC`; raise an `OptionError` if one is missing."""
    name, hash_sign, topic = where.rpartition("#")
    if not (hash_sign and name and topic) or "\0" in where:
        raise OptionError(f"--data bag:{where}: write bag:PATH#TOPIC, for example bag:drive.mcap#/camera/image")
    return name, topic


@contextmanager
def _open_reader(path: Path) -> Iterator[tuple[AnyReader, Callable[[bytes], bytes], RecordingFiles]]:
    """Open a bag, with a function that unpacks a message; a damaged bag's error within the block becomes one line."""
    try:
        from rosbags.highlevel import AnyReader  # noqa: PLC0415 - only bags need it
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

        from dds_trace.tracefile.reading.bag_bounds import bounded_unpacking  # noqa: PLC0415
        from dds_trace.tracefile.reading.recording_files import open_recording  # noqa: PLC0415
    except ImportError as err:
        raise BackendUnavailableError(
            "reading a bag needs the Python package rosbags; pip install 'dds-trace[bags]' (in a clone '.[bags]')"
        ) from err
    try:
        # Bags of sqlite3 before ROS 2 Iron have no definitions; the stock types have hardly changed.
        with (
            open_recording(path) as recording,
            bounded_unpacking(path) as unpack,
            AnyReader(recording.files, default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader,
        ):
            yield reader, unpack, recording
    except (OptionError, BackendUnavailableError, StoppedError):
        raise
    except FileNotFoundError as err:
        raise OptionError(f"--data bag:{path}: there is no such file or folder") from err
    except Exception as err:  # rosbags and its codecs raise many kinds on a damaged file
        raise OptionError(f"--data bag:{path}: it cannot be read as a bag ({err})") from err


def _connections_of(reader: AnyReader, topic: str, path: Path) -> list[Connection]:
    connections = [other for other in reader.connections if other.topic.lstrip("/") == topic.lstrip("/")]
    if not connections:
        topics = sorted({other.topic for other in reader.connections})
        nearest = get_close_matches(topic, topics, 1, 0) or ["nothing at all"]
        raise OptionError(f"{path} has no topic {topic}; the nearest of its {len(topics)} is {nearest[0]}")
    types = sorted({connection.msgtype for connection in connections})
    if len(types) > 1:
        raise OptionError(f"{path} has {topic} with several types ({', '.join(types)}), which cannot be sent as one")
    return connections


class _Stamper:
    """Converts messages of one type to CDR with room for the stamp."""

    def __init__(self, reader: AnyReader, type_name: str, path: Path, own_types: Mapping[str, DataType]) -> None:
        fields = reader.typestore.fielddefs[type_name][1]
        kind, detail = fields[0][1] if fields else (0, "")
        first_field_type = detail if kind == NAMED_FIELD else ""
        self.data_type = recognize_data_type(type_name, str(first_field_type), str(path), own_types)
        self._reader = reader
        self._store = reader.typestore if reader.is2 else _store_of_ros2(reader.typestore)
        self._type_name = type_name
        self._bytes_of = self.data_type.raw.payload_bytes_of

    def __call__(self, data: bytes) -> Message:
        message = self._reader.deserialize(data, self._type_name)
        self.data_type.object_stamp.make_room(message)
        cdr = bytearray(self._store.serialize_cdr(message, self._type_name, little_endian=True))
        return Message(cdr, self._bytes_of(cdr))


def _store_of_ros2(ros1: Typestore) -> Typestore:
    """Return a ROS 1 bag's types as in ROS 2, whose header has no `seq`."""
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 - only bags need it

    types = dict(ros1.fielddefs)
    if HEADER_TYPE in types:
        constants, fields = types[HEADER_TYPE]
        types[HEADER_TYPE] = constants, [field for field in fields if field[0] != "seq"]
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    return store


BAG = Source(
    name="bag",
    usage="bag:PATH#TOPIC",
    open=lambda where, context: nullcontext(load_payload(where, context.own_types, context.stop)),
    check=split_topic,
)
