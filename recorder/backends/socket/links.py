"""The connections of a node on sockets (`Links`), and the greeting that opens each one.

A frame is a topic's name and a serialized message. The empty name is a greeting, JSON with the node's name, subscriptions
and publishers; a peer only gets the topics that it subscribes to.
"""

from __future__ import annotations

import json
import socket
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol, TypeAlias

from dds_trace.base.errors import OptionError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from ..node import RawMessage, Receive

RETRY_S = 0.2
"""Time between two attempts to reach a peer."""

Address: TypeAlias = tuple[str, int]
"""Host and port."""
Receivers: TypeAlias = "Mapping[str, tuple[Receive[RawMessage], ...]]"
"""Topic -> callbacks; looked up for each frame."""


@dataclass
class Greeting:
    """The introduction of a node: its name, and topic -> type of its subscriptions and publishers."""

    name: str = ""
    subscriptions: dict[str, str] = field(default_factory=dict)
    publishers: dict[str, str] = field(default_factory=dict)

    def to_bytes(self) -> bytes:
        """Return the greeting as JSON."""
        return json.dumps(vars(self)).encode()

    @classmethod
    def from_bytes(cls, data: RawMessage) -> Greeting | None:
        """Return the greeting in `data`, None if it is something else."""
        try:
            fields = json.loads(data)
            return cls(str(fields["name"]), dict(fields["subscriptions"]), dict(fields["publishers"]))
        except (ValueError, KeyError, TypeError):
            return None


class Links(Protocol):
    """The connections of one node."""

    @property
    def port(self) -> int:
        """Port at which peers reach the node; 0 if they do not."""

    def greetings(self) -> list[Greeting]:
        """Return the greetings of the connected peers."""

    def announce(self) -> None:
        """Send the node's own greeting to all peers."""

    def sender(self, topic: str) -> Callable[[RawMessage], None]:
        """Return a function that sends a copy of a message to all peers that subscribe to `topic`."""

    def poll(self) -> None:
        """Keep the connections up for one round of at most `ROUND_S`; raise the error of a callback."""

    def interrupt(self) -> None:
        """End a wait of another thread in sending."""

    def close(self) -> None:
        """End all connections; the thread that polls has ended."""


def bound_socket(kind: socket.SocketKind, address: Address) -> socket.socket:
    """Open a socket of `kind` at `address`.

    Raises:
        OptionError: the port is taken.
    """
    bound = socket.socket(socket.AF_INET, kind)
    try:
        if kind is socket.SOCK_STREAM:  # connections that have just ended do not block the port
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind(address)
    except OSError as err:
        bound.close()
        raise OptionError(
            f"port {address[1]} cannot be opened ({err.strerror}); the backend socket has one relay for each domain "
            "of a device: end the other one, or choose another --domain"
        ) from err
    return bound
