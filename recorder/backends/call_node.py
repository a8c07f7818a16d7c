"""`CallNode`: a node with calls of typed messages as its data topics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

if TYPE_CHECKING:
    from dds_trace.tracefile.format.descriptions import Qos

    from .node import Publisher, RawMessage, Receive, Subscription


RELAY_SUFFIX = "_relay"
"""End of the name of a topic's way back."""


@dataclass(slots=True)
class CallMessage:
    """A request or response of a typed call; `data` is what a request carries, serialized, and empty in what is received."""

    stamp: str
    data: RawMessage = b""
    payload_bytes: int = 0
    built: Any = None


@runtime_checkable
class CallNode(Protocol):
    """A node with calls of typed messages as topics: a publisher calls, a subscription serves, and a relay's publisher responds."""

    def create_caller(self, topic: str, qos: Qos) -> Publisher[CallMessage]:
        """Create a client, or the responding end of a relay."""

    def create_server(self, topic: str, receive: Receive[CallMessage], qos: Qos) -> Subscription:
        """Serve requests, or take the responses of the clients."""


@runtime_checkable
class Caller(Protocol):
    def is_matched(self) -> bool: ...

    def describe(self) -> dict[str, int]:
        """Return times of its calls in ns, at the end of a run."""
