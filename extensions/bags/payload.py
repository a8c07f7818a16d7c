"""`bag:PATH#TOPIC`: the messages of a recording, with our stamp in their header."""

from __future__ import annotations

import re
import threading
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from difflib import get_close_matches
from heapq import nsmallest
from importlib.util import find_spec
from itertools import pairwise
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base.errors import BackendUnavailableError, OptionError, TraceFormatError
from dds_trace.base.units import counted
from dds_trace.recorder.errors import StoppedError
from dds_trace.recorder.payloads.base import DataType, Message, Payload, Source, check_size, check_stop
from dds_trace.recorder.payloads.header import recognize_data_type

from .bounds import DAY_NS, WINDOW

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

    from dds_trace.tracefile.format.bag_metadata import RecordedTopic

    from .recorded import Condition

HEADER_TYPE = "std_msgs/msg/Header"
_ABOUT_TOPIC = re.compile(r" says that (.*) has \d", re.DOTALL)
_COMPARED_NAMES, _COMPARED_CHARACTERS = 100, 200
"""Of names of topics that may be misspelled; comparing takes time with the square of their length."""


def load_payload(where: str, own_types: Mapping[str, DataType], stop: threading.Event | None = None) -> Payload:
    """Read the messages of `PATH#TOPIC` as CDR with room for the stamp, and their mean rate; an `OptionError` for what cannot be used."""
    from .read import copied_messages  # noqa: PLC0415
    from .recorded import Condition  # noqa: PLC0415

    if find_spec("rosbags") is None:
        raise BackendUnavailableError(
            "reading a bag needs the Python package rosbags; pip install 'dds-trace[bags]' (in a clone '.[bags]')"
        )
    name, topic = split_topic(where)
    path = Path(name)
    if not path.exists():
        raise OptionError(f"--data bag:{path}: there is no such file or folder")
    if not (path.is_file() or path.is_dir()):  # a pipe would wait for a writer
        raise OptionError(f"--data bag:{where}: {path} is not a file or a folder")
    condition = Condition()
    messages_read = _read_topic(path, topic, condition, stop)
    chosen = _chosen_topic(condition.topics, topic, path)
    with _own_words(path):
        stamper = _Stamper(chosen, path, own_types)
        messages = list(_stamped(stamper, messages_read, is_damaged=bool(condition.damages)))
    unreadable = len(messages_read) - len(messages)
    if not messages:
        raise OptionError(f"--data bag:{where}: the bag has no messages of that topic")
    name = chosen.name
    others = {other.name for other in condition.topics if other.name != name}
    abouts = ((note, _ABOUT_TOPIC.search(note)) for note in (*condition.damages, *condition.notes))
    notes = [note for note, about in abouts if about is None or about[1] not in others]
    notes += copied_messages(
        name, len(messages_read) - len({(time_ns, hash(bytes(data))) for time_ns, data in messages_read})
    )
    notes += [f"{counted(unreadable, 'message')} of {name} left out: damaged"] * bool(unreadable)
    rate_hz, typical_hz, clocks = _rates_hz([time_ns for time_ns, _ in messages_read])
    if clocks > 1:
        notes.append(f"{name} has times of {clocks} clocks, years apart; the rate is of the intervals within each")
    if rate_hz and typical_hz and typical_hz > (1 + 1 / 2) * rate_hz:
        notes.append(f"{name} has {rate_hz:.3g} Hz in the mean, typically {typical_hz:.3g} Hz: choose with --rate")
    return Payload(
        stamper.data_type,
        tuple(messages),
        max(message.payload_bytes for message in messages),
        rate_hz=rate_hz,
        source=f"bag:{where}",
        notes=tuple(notes),
    )


def _read_topic(path: Path, topic: str, condition: Condition, stop: threading.Event | None) -> list[tuple[int, bytes]]:
    from .read import read_messages  # noqa: PLC0415 - SQLite

    messages_read, size_bytes = list[tuple[int, bytes]](), 0
    try:
        for message in read_messages(path, condition):
            check_stop(stop)
            if message.topic.name.lstrip("/") == topic.lstrip("/"):
                size_bytes += len(message.data)
                check_size(size_bytes, path)
                messages_read.append((message.log_ns, message.data))
    except TraceFormatError as err:
        raise OptionError(f"--data bag:{err}") from err
    return sorted(messages_read, key=itemgetter(0))


def _stamped(stamper: _Stamper, messages_read: Sequence[tuple[int, bytes]], *, is_damaged: bool) -> Iterator[Message]:
    for _, data in messages_read:
        with suppress(Exception) if is_damaged else nullcontext():  # rosbags raises many kinds
            yield stamper(data)


def _rates_hz(times_ns: Sequence[int]) -> tuple[float | None, float | None, int]:
    steps_ns = sorted(after - before for before, after in pairwise(times_ns))
    intervals_ns = [step_ns for step_ns in steps_ns if step_ns < WINDOW * DAY_NS]
    span_ns = sum(intervals_ns)
    typical_ns = intervals_ns[len(intervals_ns) // 2] if intervals_ns else 0
    return (
        len(intervals_ns) / span_ns * 1e9 if span_ns > 0 else None,
        1e9 / typical_ns if typical_ns > 0 else None,
        len(steps_ns) - len(intervals_ns) + 1,
    )


def split_topic(where: str) -> tuple[str, str]:
    name, hash_sign, topic = where.rpartition("#")
    if not (hash_sign and name and topic) or "\0" in where:
        raise OptionError(f"--data bag:{where}: write bag:PATH#TOPIC, for example bag:drive.mcap#/camera/image")
    return name, topic


@contextmanager
def _own_words(path: Path) -> Iterator[None]:
    try:
        yield
    except (OptionError, BackendUnavailableError, StoppedError):
        raise
    except Exception as err:  # rosbags raises many kinds on a damaged message
        raise OptionError(f"--data bag:{path}: its messages cannot be read ({err})") from err


def _chosen_topic(topics: Collection[RecordedTopic], topic: str, path: Path) -> RecordedTopic:
    matching = [other for other in topics if other.name.lstrip("/") == topic.lstrip("/")]
    if not matching:
        names = sorted({other.name for other in topics})
        similar = nsmallest(_COMPARED_NAMES, names, key=lambda name: abs(len(name) - len(topic)))
        whole_names = {name[:_COMPARED_CHARACTERS]: name for name in similar}
        nearest = get_close_matches(topic[:_COMPARED_CHARACTERS], whole_names, 1, 0)
        known = whole_names[nearest[0]] if nearest else "nothing at all"
        raise OptionError(f"{path} has no topic {topic}; the nearest of its {len(names)} is {known}")
    types = sorted({other.message_type for other in matching})
    if len(types) > 1:
        raise OptionError(f"{path} has {topic} with several types ({', '.join(types)}), which cannot be sent as one")
    return matching[0]


def _types_of(topic: RecordedTopic) -> Typestore:
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore  # noqa: PLC0415 - only bags need it

    if not topic.definition:
        return get_typestore(Stores.ROS1_NOETIC if topic.encoding == "ros1" else Stores.ROS2_JAZZY)
    store = get_typestore(Stores.EMPTY)
    if topic.definition_encoding.endswith("idl"):
        for text in topic.definition.split(f"{'=' * 80}\n"):
            store.register(get_types_from_idl(text.partition("\n")[2] if text.startswith("IDL: ") else text))
    else:
        store.register(get_types_from_msg(topic.definition, topic.message_type))
    return store


class _Stamper:
    def __init__(self, topic: RecordedTopic, path: Path, own_types: Mapping[str, DataType]) -> None:
        from rosbags.interfaces import Nodetype  # noqa: PLC0415 - only bags need it

        store, type_name = _types_of(topic), topic.message_type
        is_ros1 = topic.encoding == "ros1"
        fields = store.fielddefs[type_name][1]
        kind, detail = fields[0][1] if fields else (0, "")
        first_field_type = detail if kind == Nodetype.NAME else ""
        self.data_type = recognize_data_type(type_name, str(first_field_type), str(path), own_types)
        self._deserialize = store.deserialize_ros1 if is_ros1 else store.deserialize_cdr
        self._store = _store_of_ros2(store) if is_ros1 else store
        self._type_name = type_name
        self._bytes_of = self.data_type.raw.payload_bytes_of

    def __call__(self, data: bytes) -> Message:
        message = self._deserialize(data, self._type_name)
        self.data_type.object_stamp.make_room(message)
        cdr = bytearray(self._store.serialize_cdr(message, self._type_name, little_endian=True))
        return Message(cdr, self._bytes_of(cdr))


def _store_of_ros2(ros1: Typestore) -> Typestore:
    """Return a ROS 1 bag's types as in ROS 2: its header has no `seq`."""
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
