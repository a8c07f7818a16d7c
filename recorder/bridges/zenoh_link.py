"""How two zenoh programs of a bridge meet: the part of a zenoh configuration that all our zenoh bridges share."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from recorder.backend import Discovery

if TYPE_CHECKING:
    from collections.abc import Mapping

    from recorder.bridges.bridge import BridgeOptions


def zenoh_link(options: BridgeOptions, mode: str) -> dict[str, Any]:
    """`mode`, `listen`, `connect` and `scouting` of a zenoh configuration.

    The addresses are all that is used to meet: multicast and gossip stay off, so that no other zenoh program of
    the network joins in. A half that only connects does not listen at all.
    """
    return {
        "mode": mode,
        "listen": {"endpoints": [f"tcp/{options.listen}"] if options.listen else []},
        "connect": {
            "endpoints": [f"tcp/{peer}" for peer in options.peers],
            "retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
        },
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
    }


# ROS 2's LOCALHOST range has no multicast: its nodes look for others at the well-known unicast ports of 127.0.0.1.
# Cyclone DDS takes such a port only with a participant index, and finds the nodes only as peers.
CYCLONE_LOCALHOST = (
    "<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>31</MaxAutoParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)

# Cyclone DDS sends fragments of 1344 bytes and receives into the system's default buffer unless it is told otherwise;
# a large message of another vendor then loses fragments faster than they are sent again.
CYCLONE_TUNED = (
    "<CycloneDDS><Domain><General><MaxMessageSize>65500B</MaxMessageSize><FragmentSize>60000B</FragmentSize></General>"
    '<Internal><SocketReceiveBufferSize min="default" max="4MB"/></Internal></Domain></CycloneDDS>'
)


def zenoh_environment(options: BridgeOptions) -> Mapping[str, str]:
    """What the Cyclone DDS inside a zenoh bridge needs to meet ROS 2 nodes, and the log as we read it."""
    parts = [
        os.environ.get("CYCLONEDDS_URI", ""),
        CYCLONE_LOCALHOST if options.discovery is Discovery.LOCALHOST else "",
        CYCLONE_TUNED if options.tuned else "",
    ]
    log = {"RUST_LOG": "z=info", "NO_COLOR": "1"}
    settings = ",".join(filter(None, parts))
    return {**log, "CYCLONEDDS_URI": settings} if settings else log
