"""A node without middleware that a tap listens on: a test decides what the graph shows and what arrives."""

from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Any

from fake_node import FakeNode, FakeSubscription

from dds_trace.base.errors import BackendUnavailableError
from dds_trace.recorder.backends.node import Publication, TopicPatterns
from dds_trace.tracefile.format.descriptions import Qos


@dataclass
class JsonSink:
    events: list[tuple[int, ...]] = field(default_factory=list)
    texts: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    payloads: list[tuple[Any, ...]] = field(default_factory=list)

    def record(self, *event: int) -> None:
        self.events.append(event)

    def keep_payload(self, *payload: Any) -> None:
        self.payloads.append(payload)

    def write_json(self, topic: str, value: dict[str, Any]) -> None:
        self.texts.append((topic, dict(value)))


class FakeTapNode(FakeNode):
    def __init__(self) -> None:
        super().__init__()
        self.graph: list[Publication] = []
        self.unknown: set[str] = set()
        self.definitions: dict[str, dict[str, str]] = {}
        self.subscribed: dict[str, Qos] = {}
        self.sources: dict[Hashable, str] = {}

    def list_publications(self, matches: TopicPatterns) -> list[Publication]:
        return [publication for publication in self.graph if matches(publication.topic)]

    def create_tap(self, topic: str, type_name: str, receive: Any, *, qos: Qos) -> FakeSubscription:
        if type_name in self.unknown:
            raise BackendUnavailableError(f"the message type {type_name} is not installed")
        self.subscribed[topic] = qos
        self.subscriptions[topic] = FakeSubscription(topic, receive)
        return self.subscriptions[topic]

    def publisher_of(self, source: Hashable) -> str | None:
        return self.sources.get(source)

    def members(self, type_name: str) -> dict[str, str] | None:
        return self.definitions.get(type_name)
