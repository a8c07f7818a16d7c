"""`socket`: plain TCP or UDP without a middleware (docs/reference/middlewares.md).

The relay listens at a port that follows from the domain, the ping connects. `-o transport=default` is TCP without
Nagle's delay, `udp` is UDP with fragments of 60 KB and no retransmission.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from ...choices import Discovery, Reliability, Security, Transport
from ..base import Backend, Meeting
from .node import PROTOCOLS, SocketNode

if TYPE_CHECKING:
    from ..node import Node, NodeOptions


def _make_node(options: NodeOptions) -> Node:
    peers = () if options.listens else BACKEND.peer_addresses(options)
    return SocketNode(options, BACKEND.port_of(options.domain_id), peers)


def _make_pair(options: NodeOptions) -> tuple[Node, Node]:
    local = replace(options, discovery=Discovery.LOCALHOST, peers=())
    if options.transport is Transport.UDP:
        local = replace(local, qos=replace(options.qos, reliability=Reliability.BEST_EFFORT))
    subscribes = SocketNode(replace(local, listens=True), 0, ())
    try:
        return subscribes, SocketNode(replace(local, listens=False), 0, [("127.0.0.1", subscribes.port)])
    except BaseException:
        subscribes.close()
        raise


BACKEND = Backend(
    name="socket",
    label="Socket",
    make_node=_make_node,
    find_installed=lambda: [None],
    install="it needs nothing",
    meeting=Meeting.PEERS,
    meeting_needs=(
        "both have --backend socket and the same --domain and -o transport, --peer names the relay's device, and nothing "
        "blocks its port {port}"
    ),
    relay_port=8,
    make_pair=_make_pair,
    has_congestion_control=True,
    transports=tuple(PROTOCOLS),
    security=(Security.ENCRYPT_RTPS,),
    sizes={Transport.DEFAULT: ("buffer",), Transport.UDP: ("buffer", "fragment")},
)
