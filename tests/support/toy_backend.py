"""A backend in one file: nodes of one process that put each message into the queues of the others."""

from __future__ import annotations

import queue
from collections import defaultdict
from functools import partial

from dds_trace.recorder.backends.base import Backend, Meeting
from dds_trace.recorder.backends.node import Endpoint, Middleware, TopicView
from dds_trace.recorder.backends.threaded import ROUND_S, NodeSubscription, ThreadedNode
from dds_trace.recorder.host.environment import MiddlewareEnvironment

DOMAINS = defaultdict(list)
"""The open nodes of each domain."""


class ToyPublisher:
    def __init__(self, node, topic):
        self.node, self.topic = node, topic

    def publish(self, message, /):
        for node in list(DOMAINS[self.node.options.domain_id]):
            node.arrived.put((self.topic, bytes(message)))

    def close(self):
        self.node.publishers.pop(self.topic, None)


class ToyNode(ThreadedNode):
    def __init__(self, options):
        super().__init__(options)
        self._middleware = Middleware("toy", "toy", None, {"toy": "1.0"})
        self.arrived = queue.SimpleQueue()
        self.publishers, self.subscriptions = {}, {}
        DOMAINS[options.domain_id].append(self)

    def create_publisher(self, topic, type_name, *, qos=None):
        del qos  # every message arrives
        self.publishers[topic] = type_name
        return ToyPublisher(self, topic)

    def create_subscription(self, topic, type_name, receive, *, qos=None):
        del qos
        self.subscriptions[topic] = type_name, receive
        return NodeSubscription(partial(self.subscriptions.pop, topic, None))

    def _make_round(self):
        def receive_round():
            try:
                topic, message = self.arrived.get(timeout=ROUND_S)
            except queue.Empty:
                return
            if topic in self.subscriptions:
                self.subscriptions[topic][1](message)

        return receive_round

    def look_at(self, topic):
        nodes = DOMAINS[self.options.domain_id]
        return TopicView(
            topic,
            tuple(Endpoint(n.options.name, n.publishers[topic]) for n in nodes if topic in n.publishers),
            tuple(
                Endpoint(n.options.name, n.subscriptions[topic][0]) for n in nodes if topic in n.subscriptions
            ),
        )

    def count_participants(self):
        return len(DOMAINS[self.options.domain_id])

    def _leave(self):
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
