"""A node without middleware: what is published is kept, and a test decides when which callback gets what."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from dds_trace.recorder.backends.node import Middleware, Node, NodeOptions, TopicView
from dds_trace.recorder.backends.other_side import Strangers
from dds_trace.recorder.host.clock import Clock
from dds_trace.tracefile.format.descriptions import Qos, Run


@dataclass
class FakePublisher:
    topic: str
    on_publish: Callable[[bytes], None] | None = None
    sent: list[bytes] = field(default_factory=list)
    is_open: bool = True

    def publish(self, message: Any, /) -> None:
        self.sent.append(bytes(message))  # the buffer may be changed as soon as this returns
        if self.on_publish is not None:
            self.on_publish(bytes(message))

    def close(self) -> None:
        self.is_open = False


@dataclass
class FakeSubscription:
    topic: str
    receive: Callable[..., None]
    is_open: bool = True

    def close(self) -> None:
        self.is_open = False


class FakeNode:
    describe_others = Node.describe_others

    def __init__(self, options: NodeOptions | None = None) -> None:
        self.options = options or NodeOptions(name="me")
        self.middleware = Middleware("ros2", "fakedds", "rmw_fake")
        self.publishers: dict[str, FakePublisher] = {}
        self.subscriptions: dict[str, FakeSubscription] = {}
        self.views: dict[str, TopicView] = {}
        self.participants: int | None = 1
        self.error: BaseException | None = None
        self.strangers = Strangers()
        self.publisher_settings: dict[str, str] = {}

    def create_publisher(self, topic: str, type_name: str, *, qos: Qos | None = None) -> FakePublisher:
        del type_name, qos
        return self.publishers.setdefault(topic, FakePublisher(topic))

    def create_subscription(
        self, topic: str, type_name: str, receive: Any, *, qos: Qos | None = None
    ) -> FakeSubscription:
        del type_name, qos
        self.subscriptions[topic] = FakeSubscription(topic, receive)
        return self.subscriptions[topic]

    def deliver(self, topic: str, message: bytes, source_ns: int = 0, received_ns: int = 0) -> None:
        self.subscriptions[topic].receive(message, source_ns, received_ns)

    def read_security(self) -> str:
        return ""

    def explain_security(self) -> str:
        return ""

    def look_at(self, topic: str) -> TopicView:
        return self.views.get(topic, TopicView(topic))

    def count_participants(self) -> int | None:
        return self.participants


@dataclass
class ListSink:
    """A `TraceSink` that keeps events as tuples: stage, run_id, sequence, monotonic_ns ... as `record` takes them."""

    clock: Clock
    events: list[tuple[int, ...]] = field(default_factory=list)
    runs: list[Run] = field(default_factory=list)
    expected: tuple[int, ...] | None = None
    foreseen: int = 0

    def record(self, *event: int) -> None:
        self.events.append(event)

    def stamp(
        self,
        stage: int,
        run_id: int,
        sequence: int,
        scheduled_ns: int = 0,
        source_ns: int = 0,
        received_ns: int = 0,
        payload_bytes: int = 0,
        relay_id: int = 0,
    ) -> int:
        monotonic_ns = self.clock.monotonic_ns()
        self.record(
            *(stage, run_id, sequence, monotonic_ns, scheduled_ns), *(source_ns, received_ns, payload_bytes, relay_id)
        )
        return monotonic_ns

    def record_and_stamp(
        self,
        stages: tuple[int, int],
        run_id: int,
        sequence: int,
        monotonic_ns: int,
        source_ns: int,
        received_ns: int,
        payload_bytes: int,
        relay_id: int,
    ) -> int:
        self.record(*(stages[0], run_id, sequence, monotonic_ns, 0, source_ns, received_ns, payload_bytes, relay_id))
        return self.stamp(stages[1], run_id, sequence, 0, 0, 0, payload_bytes, relay_id)

    def expect(
        self, stages: tuple[int, int], run_id: int, sequence: int, payload_bytes: int, relay_id: int
    ) -> tuple[int, ...]:
        self.expected = (*stages, run_id, sequence, payload_bytes, relay_id)
        return self.expected

    def record_expected(self, expected: tuple[int, ...], monotonic_ns: int, source_ns: int, received_ns: int) -> bool:
        if expected is not self.expected:
            return False
        arrival, departure, *rest = expected
        run_id, sequence, payload_bytes, relay_id = rest
        self.foreseen += 1
        self.record_and_stamp(
            (arrival, departure), run_id, sequence, monotonic_ns, source_ns, received_ns, payload_bytes, relay_id
        )
        return True

    def write_run(self, run: Run) -> None:
        self.runs.append(run)

    def of_stage(self, stage: int) -> list[tuple[int, ...]]:
        return [event[1:] for event in self.events if event[0] == stage]
