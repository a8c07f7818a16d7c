"""A backend in one file: nodes of one process that put each message into the queues of the others."""

from __future__ import annotations

import queue
from collections import defaultdict
from functools import partial
from typing import TYPE_CHECKING

from dds_trace.recorder.backends.base import Backend, Meeting
from dds_trace.recorder.backends.node import (
    ROUND_S,
    Endpoint,
    Middleware,
    NodeOptions,
    NodeSubscription,
    ThreadedNode,
    TopicView,
)
from dds_trace.recorder.host.environment import MiddlewareEnvironment

if TYPE_CHECKING:
    from collections.abc import Callable

    from dds_trace.recorder.backends.node import RawMessage, Receive
    from dds_trace.tracefile.format.descriptions import Qos

DOMAINS: defaultdict[int, list[ToyNode]] = defaultdict(list)
"""The open nodes of each domain."""


class ToyPublisher:
    """A publisher of every node of the domain's queue."""

    def __init__(self, node: ToyNode, topic: str) -> None:
        self.node, self.topic = node, topic

    def publish(self, message: RawMessage, /) -> None:
        """Put a copy of `message` into the queue of each node."""
        for node in list(DOMAINS[self.node.options.domain_id]):
            node.arrived.put((self.topic, bytes(message)))

    def close(self) -> None:
        """Take the publisher off the topic."""
        self.node.publishers.pop(self.topic, None)


class ToyNode(ThreadedNode):
    """A queue of messages and the thread that delivers them."""

    def __init__(self, options: NodeOptions) -> None:
        super().__init__(options)
        self._middleware = Middleware("toy", "toy", None, {"toy": "1.0"})
        self.arrived: queue.SimpleQueue[tuple[str, bytes]] = queue.SimpleQueue()
        self.publishers: dict[str, str] = {}
        self.subscriptions: dict[str, tuple[str, Receive[RawMessage]]] = {}
        DOMAINS[options.domain_id].append(self)

    def create_publisher(self, topic: str, type_name: str, *, qos: Qos | None = None) -> ToyPublisher:
        """Create a publisher."""
        del qos  # every message arrives
        self.publishers[topic] = type_name
        return ToyPublisher(self, topic)

    def create_subscription(
        self, topic: str, type_name: str, receive: Receive[RawMessage], *, qos: Qos | None = None
    ) -> NodeSubscription:
        """Create a subscription."""
        del qos
        self.subscriptions[topic] = type_name, receive
        return NodeSubscription(partial(self._withdraw, topic))

    def _withdraw(self, topic: str) -> None:
        self.subscriptions.pop(topic, None)

    def _make_round(self) -> Callable[[], None]:
        def receive_round() -> None:
            try:
                topic, message = self.arrived.get(timeout=ROUND_S)
            except queue.Empty:
                return
            if topic in self.subscriptions:
                self.subscriptions[topic][1](message)

        return receive_round

    def look_at(self, topic: str) -> TopicView:
        """Return the endpoints of the domain."""
        nodes = DOMAINS[self.options.domain_id]
        return TopicView(
            topic,
            tuple(Endpoint(n.options.name, n.publishers[topic]) for n in nodes if topic in n.publishers),
            tuple(Endpoint(n.options.name, n.subscriptions[topic][0]) for n in nodes if topic in n.subscriptions),
        )

    def count_participants(self) -> int:
        """Count the nodes of the domain."""
        return len(DOMAINS[self.options.domain_id])

    def _leave(self) -> None:
        DOMAINS[self.options.domain_id].remove(self)


BACKEND = Backend(
    name="toy",
    label="Toy Bus",
    make_node=ToyNode,
    find_installed=lambda: [None],
    install="it is a test's own",
    meeting=Meeting.DISCOVERY,
    meeting_needs="both run in one process",
    environment=MiddlewareEnvironment(settings=("TOY_SETTING",)),
)
