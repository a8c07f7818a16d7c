"""The greeting that opens each connection of a node on sockets, and how a socket is bound.

A frame is a topic's name and a serialized message. The empty name is a greeting, JSON with the node's name, subscriptions
and publishers; a peer only gets the topics that it subscribes to.
"""

from __future__ import annotations

import json
import socket
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

from dds_trace.base.errors import OptionError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..node import RawMessage, Receive

RETRY_S = 0.2
"""Time between two attempts to reach a peer."""

Address: TypeAlias = tuple[str, int]
"""Host and port."""
Receivers: TypeAlias = "Mapping[str, tuple[Receive[RawMessage], ...]]"
"""Topic -> callbacks; looked up for each frame."""


@dataclass
class Greeting:
    """A node's name, and topic -> type of its subscriptions and publishers."""

    name: str = ""
    subscriptions: dict[str, str] = field(default_factory=dict)
    publishers: dict[str, str] = field(default_factory=dict)

    def to_bytes(self) -> bytes:
        return json.dumps(vars(self)).encode()

    @classmethod
    def from_bytes(cls, data: RawMessage) -> Greeting | None:
        """Return the greeting in `data`, if it is one."""
        try:
            fields = json.loads(data)
            return cls(str(fields["name"]), dict(fields["subscriptions"]), dict(fields["publishers"]))
        except (ValueError, KeyError, TypeError):
            return None


def bound_socket(kind: socket.SocketKind, address: Address) -> socket.socket:
    """Open a socket of `kind` at `address`; raise an `OptionError` if the port is taken."""
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
