"""The greeting on each connection of a node on sockets, the bounds of what peers send, and how a socket is bound.

A frame is a topic's name and a serialized message. The empty name is a greeting, JSON with the node's name,
subscriptions and publishers; a peer gets only the topics that it subscribes to. Over UDP it also has the cookie that
the other side gave to this address, as anybody can write a source address.
"""

from __future__ import annotations

import errno
import json
import os
import socket
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from dds_trace.base.errors import OptionError

from ..node import RawMessage, Receive

RETRY_S = 0.2
MAX_PEERS = 64
"""Most connections, or over UDP addresses, of a node."""
MAX_GREETING_BYTES = 16_384
MAX_TOPICS = 256
"""Most topics that a greeting names on each side; a relay has four."""
MAX_MESSAGE_BYTES = 1 << 30
MEMORY_BYTES = min(2 * MAX_MESSAGE_BYTES, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2)
"""Memory for messages under way from all peers together."""

MALFORMED, CROWD, SLOW = "frame that is none", "connection too many", "subscriber that did not read"
HALF_OPEN, TOO_LARGE = "connection without a greeting", "frame too large for the memory"
UNSECURED = "connection without TLS or a certificate of ours"

Address: TypeAlias = tuple[str, int]
Receivers: TypeAlias = "Mapping[str, tuple[Receive[RawMessage], ...]]"


class PeerError(Exception):
    """A fault that ends a peer's connection; the text is the kind to count."""


@dataclass
class Greeting:
    """A node's name, topic -> type of its subscriptions and publishers, and the cookie of who gets it (UDP)."""

    name: str = ""
    subscriptions: dict[str, str] = field(default_factory=dict)
    publishers: dict[str, str] = field(default_factory=dict)
    cookie: str = ""

    def to_bytes(self, cookie: str = "") -> bytes:
        return json.dumps({**vars(self), "cookie": cookie}).encode()

    @classmethod
    def from_bytes(cls, data: RawMessage) -> Greeting | None:
        if len(data) > MAX_GREETING_BYTES:
            return None
        try:
            fields = json.loads(data)
            subscriptions, publishers = dict(fields["subscriptions"]), dict(fields["publishers"])
            name, cookie = fields["name"], fields.get("cookie", "")
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return None
        texts = (name, cookie, *subscriptions, *publishers, *subscriptions.values(), *publishers.values())
        if max(len(subscriptions), len(publishers)) > MAX_TOPICS or not all(
            isinstance(text, str) and text.isascii() and text.isprintable() for text in texts
        ):
            return None
        return cls(name, subscriptions, publishers, cookie)


def timeval(seconds: float) -> bytes:
    return struct.pack("@ll", int(seconds), round(seconds % 1 * 1e6))


def bound_socket(kind: socket.SocketKind, address: Address) -> socket.socket:
    bound = socket.socket(socket.AF_INET, kind)
    try:
        if kind is socket.SOCK_STREAM:  # ended connections do not block the port
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind(address)
    except OSError as err:
        bound.close()
        raise OptionError(
            f"port {address[1]} cannot be opened ({err.strerror}); the backend socket has one relay for each domain "
            "of a device: end the other one, or choose another --domain"
        ) from err
    return bound


def is_own_address(host: str) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as trial:
        try:
            trial.bind((host, 0))
        except OSError as err:
            return err.errno != errno.EADDRNOTAVAIL
    return True
