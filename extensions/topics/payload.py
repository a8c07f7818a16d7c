"""`topic:/NAME`: each message of a running topic becomes a ping when it arrives."""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import pairwise

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.units import SECOND_NS, counted
from dds_trace.recorder.backends.node import RELAY_SUFFIX, Endpoint, Node, ObjectNode, RosMessage
from dds_trace.recorder.choices import Durability, History, Reliability
from dds_trace.recorder.payloads.base import DataType, Message, Payload, PayloadContext, Source
from dds_trace.recorder.payloads.header import recognize_data_type
from dds_trace.tracefile.format.descriptions import Qos

MAX_WAITING = 64
"""Most messages that wait; further ones are dropped and counted."""
RATE_MESSAGES, MOST_RATE_MESSAGES = 10, 1000
"""Messages for the topic's rate; fewer are enough after `RATE_S`."""
RATE_BATCHES = 3
"""Batches for the rate of a topic in batches, likewise."""
RATE_S = 3.0
CHECK_PERIOD_S = 0.05


def check_name(name: str) -> None:
    limits.check(limits.TOPIC_NAME, name, "--data topic:")


@contextmanager
def open_payload(name: str, context: PayloadContext) -> Iterator[Payload]:
    """Open a topic's live payload on its own node: the one that stamps T2 must not be busy."""
    check_name(name)
    topic, where = name.strip("/"), f"--data topic:{name}"
    own_types, stop = context.own_types, context.stop
    own_topics = {data_type.topic for data_type in own_types.values()}
    if topic.startswith("data_") or topic.endswith(RELAY_SUFFIX) or topic in own_topics:
        raise OptionError(f"{where}: this is a topic of our own messages; name the topic of the sensor")
    deadline_s = time.monotonic() + context.wait_s
    with context.open_node() as node:
        if not isinstance(node, ObjectNode):
            raise OptionError(f"{where}: only --backend ros2 can send a running topic")
        publisher = _find_publisher(node, topic, where, deadline_s, stop)
        feed = LiveFeed(node, publisher.type_name, where, own_types)
        offered = publisher.qos or Qos(Reliability.BEST_EFFORT)
        qos = Qos(offered.reliability, Durability.VOLATILE, History.KEEP_LAST, MAX_WAITING)
        subscription = node.create_object_subscription(topic, publisher.type_name, feed.receive, qos=qos)
        node.start()
        try:
            yield feed.payload(deadline_s, stop, source=f"topic:{name}")
        finally:
            subscription.close()


class LiveFeed:
    def __init__(self, node: ObjectNode, type_name: str, where: str, own_types: Mapping[str, DataType]) -> None:
        self.skipped = 0
        self._node = node
        self._type_name = type_name
        self._where = where
        self._own_types = own_types
        self._data_type: DataType | None = None
        self._sample: Message | None = None
        self._sent_ns: deque[int] = deque(maxlen=MOST_RATE_MESSAGES)
        self._waiting: queue.SimpleQueue[tuple[Message, int]] = queue.SimpleQueue()
        self._has_begun = False
        self._error: OptionError | None = None

    def receive(self, message: RosMessage, source_ns: int = 0, _received_ns: int = 0, /) -> None:
        arrival_ns = time.monotonic_ns()
        if self._sample is None:
            self._take_sample(message)
        # After a stall messages arrive together, so the times of publication give the rate.
        self._sent_ns.append(source_ns or arrival_ns)
        if not self._has_begun or self._error is not None:
            return
        if self._waiting.qsize() >= MAX_WAITING:
            self.skipped += 1
        elif (converted := self._convert(message)) is not None:
            self._waiting.put((converted, arrival_ns))

    def begin(self) -> None:
        self._has_begun = True

    def take(self, stop: threading.Event) -> tuple[Message, int] | None:
        while not stop.is_set():
            with suppress(queue.Empty):
                return self._waiting.get(timeout=CHECK_PERIOD_S)
        return None

    def payload(self, deadline_s: float, stop: threading.Event, source: str) -> Payload:
        first_s: float | None = None
        while not stop.is_set() and time.monotonic() < deadline_s and self._error is None:
            arrivals = len(self._sent_ns)
            if arrivals and first_s is None:
                first_s = time.monotonic()
            is_time = first_s is not None and time.monotonic() - first_s > RATE_S
            if (arrivals > 1 and is_time) or (arrivals >= RATE_MESSAGES and shows_rate(list(self._sent_ns))):
                break
            time.sleep(CHECK_PERIOD_S)
        if self._error is not None:
            raise self._error
        sent_ns = list(self._sent_ns)
        if self._sample is None or self._data_type is None or len(sent_ns) < 2:
            raise OptionError(
                f"{self._where}: {counted(len(sent_ns), 'message')} arrived; check its publisher, "
                "or give a longer -o wait"
            )
        rate_hz = rate_of(sent_ns)
        return Payload(
            self._data_type,
            (self._sample,),
            self._sample.payload_bytes,
            rate_hz=float(f"{rate_hz:.2g}"),  # without the publisher's jitter
            source=source,
            feed=self,
        )

    def _take_sample(self, message: RosMessage) -> None:
        first_field_type = next(iter(message.get_fields_and_field_types().values()), "")
        try:
            self._data_type = recognize_data_type(self._type_name, first_field_type, self._where, self._own_types)
        except OptionError as error:  # `payload` raises it
            self._error = error
            return
        self._sample = self._convert(message)

    def _convert(self, message: RosMessage) -> Message | None:
        assert self._data_type is not None
        stamp = self._data_type.object_stamp
        if stamp.read(message) is not None:
            return None
        stamp.make_room(message)
        data = bytearray(self._node.message_to_cdr(message))
        return Message(data, self._data_type.raw.payload_bytes_of(data))


def _batch_starts(times_ns: Sequence[int]) -> list[int]:
    gaps_ns = [after - before for before, after in pairwise(times_ns)]
    return [number for number, gap_ns in enumerate(gaps_ns, 1) if 2 * gap_ns > max(gaps_ns)]


def shows_rate(sent_ns: Sequence[int]) -> bool:
    return len(_batch_starts(sorted(sent_ns))) >= RATE_BATCHES


def rate_of(sent_ns: Sequence[int]) -> float:
    times_ns = sorted(sent_ns)
    starts = _batch_starts(times_ns)
    has_batches = 1 < len(starts) < len(times_ns) - 1
    first, last = (starts[0], starts[-1]) if has_batches else (0, len(times_ns) - 1)
    return (last - first) / max(times_ns[last] - times_ns[first], 1) * SECOND_NS


def _find_publisher(node: Node, topic: str, where: str, deadline_s: float, stop: threading.Event) -> Endpoint:
    while not stop.is_set() and time.monotonic() < deadline_s:
        for publisher in node.look_at(topic).publishers:
            if publisher.type_name:
                return publisher
        time.sleep(CHECK_PERIOD_S)
    raise OptionError(
        f"{where}: it has no publisher in domain {node.options.domain_id}; start one, or give a longer -o wait"
    )


TOPIC = Source(name="topic", usage="topic:/NAME", open=open_payload, check=check_name, is_live=True)
