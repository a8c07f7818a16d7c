"""The tap role: joins matching topics as they appear, and stores an event for each message of every publisher."""

from __future__ import annotations

import os
import queue
import re
import threading
from collections.abc import Callable, Hashable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from dds_trace.base.errors import OptionError
from dds_trace.base.printable import printable
from dds_trace.base.threads import run_in_background
from dds_trace.base.units import SECOND_NS, counted, format_duration
from dds_trace.extensions.bags.header_stamps import Field, Fields, known_definition, plain_name, stamp_reader
from dds_trace.recorder.applied.applied import Traffic
from dds_trace.recorder.backends.dds_types import DDS_TYPES
from dds_trace.recorder.backends.node import ROUND_S, Publication, RawMessage, Subscription, TapNode, TopicPatterns
from dds_trace.recorder.host.clock import Clock, SystemClock
from dds_trace.recorder.roles.progress import TapProgress
from dds_trace.tracefile.format.bag_metadata import MOST_TOPICS, RecordedTopic
from dds_trace.tracefile.format.descriptions import Qos
from dds_trace.tracefile.format.events import PUBLISHER_TOPIC, TOPIC_PREFIX, hash_content
from dds_trace.tracefile.writing.sink import TraceSink

from .live import LiveTable, LiveTopic
from .streams import State, Stream, find_by_number

MOST_WAITING = 64
"""Messages that wait; when there are more, the receiving thread waits, and the middleware drops what its queue does not hold."""
NICENESS = 10


class Worker:
    def __init__(self, work: Callable[..., None]) -> None:
        self.error: BaseException | None = None
        self._work = work
        self._has_closed = False
        self._queue: queue.Queue[tuple[Any, ...] | None] = queue.Queue(MOST_WAITING)
        self._thread = threading.Thread(target=self._run, name="tap-worker", daemon=True)
        self._thread.start()

    def hand_over(self, item: tuple[Any, ...]) -> None:
        """Put an item into the queue and wait for room; after `close` it is lost."""
        while not self._has_closed:
            try:
                self._queue.put(item, timeout=ROUND_S)
            except queue.Full:
                continue
            return

    def _run(self) -> None:
        run_in_background()
        with suppress(OSError):  # of this thread only
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)
        while (item := self._queue.get()) is not None:
            if self.error is None:
                try:
                    self._work(*item)
                except BaseException as error:  # noqa: BLE001 - a thread has no caller
                    self.error = error

    def close(self) -> None:
        self._has_closed = True
        self._queue.put(None)
        self._thread.join()


TAP = 5
GRAPH_PERIOD_NS = SECOND_NS // 2
MOST_STREAMS = 10_000
MOST_NUMBERED = 16
"""Publishers of a topic that numbers distinguish at a time."""
MOST_ANNOUNCED = 1000
"""Pairs of topic and type that a tap joins or refuses."""
JOIN_NS = GRAPH_PERIOD_NS
_NAME = re.compile(r"/?\w[\w.:<>,-]*(?:/\w[\w.:<>,-]*)*", re.ASCII)
_NAME_CHARACTERS = 256


def _check_names(*names: str) -> None:
    if not all(len(name) <= _NAME_CHARACTERS and _NAME.fullmatch(name) for name in names):
        raise OptionError("no topic or type has such a name")


@dataclass(slots=True, eq=False)
class _Topic:
    name: str
    type_name: str
    read_stamp: Callable[[bytes], int | None] | None
    live: LiveTopic | None = None
    payload_topic: RecordedTopic | None = None
    publications: list[Publication] = field(default_factory=list)
    subscription: Subscription | None = None
    streams: dict[Hashable, Stream] = field(default_factory=dict)
    """By `source` of a message; None is the only publisher, or all of several that send no numbers."""

    numbered: list[Stream] = field(default_factory=list)
    """Publishers that only their numbers distinguish."""

    @property
    def is_unseen(self) -> bool:
        return not any(publication.is_seen for publication in self.publications)


class Tap:
    """The tap of `patterns` on a node; its thread stamps arrivals; `look` joins topics and finds those that stopped.

    With `has_worker` another thread does the rest, so that a message does not wait for the hash of the one before it.

    Attributes:
        refused: topic -> why it, or one of its types, cannot be joined.
        left_out: pairs of topic and type beyond `MOST_ANNOUNCED`, the most at a time.
    """

    def __init__(
        self,
        node: TapNode,
        sink: TraceSink,
        patterns: TopicPatterns,
        *,
        session_id: int,
        qos: Qos,
        note: Callable[[str], None],
        live: LiveTable | None = None,
        clock: Clock | None = None,
        has_worker: bool = False,
        keeps_payload: bool = False,
    ) -> None:
        self.streams: list[Stream] = []
        self.refused: dict[str, str] = {}
        self.left_out = 0
        self._node = node
        self._sink = sink
        self._patterns = patterns
        self._session_id = session_id
        self._qos = qos
        self._note = note
        self._live = live
        self._keeps_payload = keeps_payload
        self._now = (clock or SystemClock()).monotonic_ns
        self._worker = Worker(self.store) if has_worker else None
        self._hand_over = self._worker.hand_over if self._worker else lambda item: self.store(*item)
        self._topics: dict[tuple[str, str], _Topic] = {}
        self._described = 0
        self._looked_ns: int | None = None

    @property
    def messages(self) -> int:
        return sum(stream.messages for stream in self.streams)

    @property
    def topics(self) -> list[str]:
        return sorted({topic.name for topic in self._topics.values() if topic.subscription is not None})

    @property
    def unseen(self) -> list[str]:
        return sorted(
            {topic.name for topic in self._topics.values() if topic.subscription is not None and topic.is_unseen}
        )

    @property
    def traffic(self) -> Traffic:
        messages = self.messages
        return Traffic(0, messages, sum(stream.payload_bytes for stream in self.streams) // max(messages, 1))

    def progress(self) -> TapProgress:
        missing = sum(stream.missing for stream in self.streams)
        return TapProgress(self.messages, len(self.topics), len(self.streams), missing)

    def look(self) -> None:
        """Join new topics, and report publishers that stopped or are back; at most two looks at the graph a second."""
        if self._worker is not None and self._worker.error is not None:
            raise self._worker.error
        now_ns = self._now()
        for stream in self.streams[self._described :]:
            self._describe(stream, State.HEARD)
            self._described += 1
        if self._looked_ns is None or now_ns - self._looked_ns >= GRAPH_PERIOD_NS:
            self._looked_ns = now_ns
            self._look_at_graph()
        for stream in self.streams:
            self._look_at_stream(stream, now_ns)

    def close(self) -> None:
        for topic in self._topics.values():
            if topic.subscription is not None:
                topic.subscription.close()
        if self._worker is not None:
            self._worker.close()
        for stream in self.streams:
            self._describe(stream, State.CLOSED)

    def _look_at_graph(self) -> None:
        """Take what the graph has; the next look goes on with what this one did not join."""
        by_topic: dict[tuple[str, str], list[Publication]] = {}
        for publication in self._node.list_publications(self._patterns):
            by_topic.setdefault((publication.topic, publication.type_name), []).append(publication)
        for key, topic in self._topics.items():
            self._update(topic, by_topic.get(key, []))
        new = sorted(by_topic.keys() - self._topics.keys())
        end_ns, room = self._now() + JOIN_NS, MOST_ANNOUNCED - len(self._topics)
        for key in new[:room]:
            self._join(*key, by_topic[key])
            if self._now() > end_ns:
                return
        if len(new) > room and not self.left_out:
            self._note(
                f"{counted(len(new) - room, 'further topic')} with a type of its own left out: a tap takes {MOST_ANNOUNCED:,}; "
                "name fewer with --topics"
            )
        self.left_out = max(self.left_out, len(new) - room)

    def _join(self, name: str, type_name: str, publications: list[Publication]) -> None:
        try:
            if type_name or name not in self._patterns.texts:  # a key of zenoh that the user names has no type
                _check_names(name, type_name)
            read_stamp = reader_of(type_name, self._node.members)
            live = None if self._live is None else self._live.topic(name)
            topic = self._topics[name, type_name] = _Topic(
                name, type_name, read_stamp, live, self._payload_topic(name, type_name)
            )
            self._update(topic, publications)
            topic.subscription = self._node.create_tap(name, type_name, self._receiver(topic), qos=self._qos)
        except Exception as error:  # noqa: BLE001 - names are a stranger's: each library refuses them with errors of its own
            self._topics[name, type_name] = _Topic(name, type_name, None)
            shown, (reason, *_) = printable(name), [*str(error).splitlines(), type(error).__name__]
            if shown not in self.refused:
                self.refused[shown] = printable(reason).rstrip(":")
                self._note(f"{shown} is not joined: {self.refused[shown]}")
            return
        joined = (other for other in self._topics.values() if other.name == name and other.subscription is not None)
        other = next((other.type_name for other in joined if other is not topic), "")
        also = f"; the name is also announced as {other}" if other else ""
        if topic.is_unseen:
            self._note(f"joined {name}; the middleware does not show who publishes it")
        else:
            self._note(f"joined {name} ({type_name}), {counted(len(publications), 'publisher')}{also}")

    def _payload_topic(self, name: str, type_name: str) -> RecordedTopic | None:
        if not self._keeps_payload or name.startswith(TOPIC_PREFIX) or len(self._topics) >= MOST_TOPICS:
            return None
        is_ros = type_name.count("/") == 2
        definition = definition_of(type_name, self._node.members) if is_ros else ""
        return RecordedTopic(name, type_name, "cdr" if is_ros or name.startswith("/") else "", definition)

    def _update(self, topic: _Topic, publications: list[Publication]) -> None:
        if {p.publisher for p in publications} == {p.publisher for p in topic.publications} and topic.publications:
            return
        ended = {p.publisher for p in topic.publications} - {p.publisher for p in publications}
        topic.publications = publications
        topic.streams.pop(None, None)
        for stream in [stream for stream in topic.numbered if stream.publisher in ended]:
            topic.numbered.remove(stream)
        for stream in self.streams:
            if stream.publication.topic == topic.name and stream.publisher in ended and stream.stopped_at is None:
                self._note(f"{topic.name}: its publisher {printable(stream.publication.node_name)} left")
                self._stop(stream)
        unknown = [stream for stream in topic.numbered if stream.publisher is None]
        if len(unknown) == 1 and (publication := _only_unheard(topic)):
            unknown[0].publisher, unknown[0].publication = publication.publisher, publication

    def _stop(self, stream: Stream) -> None:
        stream.stopped_at = stream.messages
        self._describe(stream, State.STOPPED)

    def _receiver(self, topic: _Topic) -> Callable[[RawMessage, int, int, int, Hashable], None]:
        now, hand_over = self._now, self._hand_over

        def receive(message: RawMessage, source_ns: int, received_ns: int, sequence: int, source: Hashable, /) -> None:
            hand_over((topic, now(), message, source_ns, received_ns, sequence, source))

        return receive

    def store(
        self,
        topic: _Topic,
        arrival_ns: int,
        message: RawMessage,
        source_ns: int,
        received_ns: int,
        sequence: int,
        source: Hashable,
    ) -> None:
        if source is None and sequence:
            stream = self._by_number(topic, sequence, source_ns or arrival_ns)
        else:
            stream = topic.streams.get(source) or self._meet(topic, source)
        header_ns = 0 if topic.read_stamp is None else max(topic.read_stamp(bytes(message)) or 0, 0)
        payload_bytes = len(message)
        self._sink.record(
            TAP,
            hash_content(message),
            sequence,
            arrival_ns,
            header_ns,
            source_ns,
            received_ns,
            payload_bytes,
            stream.publisher_id,
        )
        stream.count(arrival_ns, sequence, payload_bytes, source_ns)
        if topic.payload_topic is not None:
            self._sink.keep_payload(topic.payload_topic, message, arrival_ns)
        if topic.live is not None:
            topic.live.count(arrival_ns, header_ns or source_ns, stream.publisher_id, stream.missing)

    def _by_number(self, topic: _Topic, sequence: int, sent_ns: int) -> Stream:
        stream, is_sure = find_by_number(topic.numbered, sequence, sent_ns)
        if stream is not None and not is_sure:  # lost messages, or the first one of a publisher that just came
            now = self._node.list_publications(TopicPatterns((topic.name,)))
            if sum(publication.type_name == topic.type_name for publication in now) > len(topic.numbered):
                stream = None
        if stream is not None:
            return stream
        is_first = all(other.publisher is not None for other in topic.numbered)
        publication = (_only_unheard(topic) if is_first else None) or Publication(topic.name, topic.type_name)
        stream = self._add_stream(topic, publication.publisher, publication)
        if len(topic.numbered) >= MOST_NUMBERED:
            topic.numbered.remove(min(topic.numbered, key=lambda other: other.last_ns))
        topic.numbered.append(stream)
        return stream

    def _add_stream(self, topic: _Topic, publisher: str | None, publication: Publication) -> Stream:
        if len(self.streams) >= MOST_STREAMS:
            return self.streams[-1]
        stream = Stream(publication, len(self.streams) + 1, publisher, self._qos, topic.read_stamp is not None)
        self.streams.append(stream)  # described by `look`: the next message would wait for the disk
        return stream

    def _meet(self, topic: _Topic, source: Hashable) -> Stream:
        publisher, publication = self._identify(topic, source)
        stream = next(
            (
                other
                for other in self.streams
                if (other.publisher, other.publication.topic, other.publication.type_name)
                == (publisher, topic.name, topic.type_name)
            ),
            None,
        )
        topic.streams[source] = stream or self._add_stream(topic, publisher, publication)
        return topic.streams[source]

    def _identify(self, topic: _Topic, source: Hashable) -> tuple[str | None, Publication]:
        publications = topic.publications
        if source is None:
            only = publications[0] if len(publications) == 1 else None
            return (None if only is None else only.publisher), only or Publication(topic.name, topic.type_name)
        publisher = self._node.publisher_of(source)
        matching = [publication for publication in publications if publication.publisher == publisher]
        likely = matching or (publications if len(publications) == 1 else [])
        return publisher, next(iter(likely), Publication(topic.name, topic.type_name, publisher))

    def _describe(self, stream: Stream, state: State) -> None:
        self._sink.write_json(PUBLISHER_TOPIC, stream.describe(state, self._session_id, self._now()))

    def _look_at_stream(self, stream: Stream, now_ns: int) -> None:
        topic = stream.publication.topic
        silence_ns = stream.silence_ns(now_ns)
        if stream.is_back:
            stream.stopped_at = None
            self._note(f"{topic} is back")
            self._describe(stream, State.HEARD)
        elif silence_ns is not None and stream.stopped_at is None:
            self._note(f"{topic} stopped: nothing for {format_duration(silence_ns, 's')}")
            self._stop(stream)


def summarize(streams: Iterable[Stream]) -> list[str]:
    lines = []
    for stream in sorted(streams, key=lambda by_topic: (by_topic.publication.topic, by_topic.publisher_id)):
        rate = f", {stream.rate_hz:.3g} Hz" if stream.rate_hz else ""
        ended = ", stopped before the end" if stream.stopped_at is not None else ""
        lines.append(f"{stream.publication.topic}: {counted(stream.messages, 'message')}{rate}{stream.lost}{ended}")
    return lines


def _only_unheard(topic: _Topic) -> Publication | None:
    """Return the publisher that is left when those that were heard are taken away, if it is one."""
    heard = {stream.publisher for stream in topic.numbered}
    unheard = [publication for publication in topic.publications if publication.publisher not in heard]
    return unheard[0] if len(unheard) == 1 else None


Members = Callable[[str], Mapping[str, str] | None]


_PLAIN = {"double": "float64", "float": "float32", "boolean": "bool"}


def reader_of(type_name: str, members: Members) -> Callable[[bytes], int | None] | None:
    return stamp_reader(type_name, definition_of(type_name, members), "cdr")


def definition_of(type_name: str, members: Members) -> str:
    remaining, sections = [plain_name(type_name)], dict[str, str]()
    while remaining:
        name = remaining.pop(0)
        if name in sections or "/" not in name:
            continue
        fields = _fields(name, members)
        if fields is None:
            return known_definition(type_name)
        brackets = ["" if field.length is None else f"[{field.length}]".replace("-1", "") for field in fields]
        kinds = [field.type.replace("octet", "byte") for field in fields]
        rows = zip(kinds, brackets, fields, strict=True)
        sections[name] = "".join(f"{kind}{bracket} {field.name}\n" for kind, bracket, field in rows)
        remaining += [field.type for field in fields]
    heads = {name: f"{'=' * 80}\nMSG: {name}\n" for name in list(sections)[1:]}
    return "".join(heads.get(name, "") + text for name, text in sections.items())


def _fields(name: str, members: Members) -> Fields | None:
    package, slash, short_name = name.partition("/")
    if not slash:
        return None
    full_name = f"{package}/msg/{short_name}"
    definition = members(full_name) or DDS_TYPES.get(full_name)
    return None if definition is None else tuple(_field(member, text) for member, text in definition.items())


def _field(name: str, text: str) -> Field:
    is_sequence = text.startswith("sequence<") or text.endswith("[]")
    element = text.removeprefix("sequence<").partition(",")[0].removesuffix("[]").removesuffix(">").partition("<")[0]
    element, bracket, length = element.partition("[")
    several = -1 if is_sequence else int(length.removesuffix("]")) if bracket else None
    return Field(name, plain_name(_PLAIN.get(element, element)), several)
