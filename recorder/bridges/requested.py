"""The bridge that a ping's options request, for the topics of its data."""

from __future__ import annotations

from contextlib import ExitStack

from dds_trace.base.errors import OptionError

from ..backends import load_backend
from ..choices import Security
from ..options import PingOptions, RecordOptions
from ..payloads.base import DataType
from .base import BRIDGE_MODULES, BRIDGED_TOPICS, BridgedTopic, BridgeOptions, load_bridge, split_halves
from .process.running import RunningBridge, open_bridge


def open_requested_bridge(
    options: RecordOptions, ping: PingOptions, data_type: DataType, stack: ExitStack
) -> RunningBridge | None:
    bridge_options = check_requested_bridge(options, ping, data_type)
    if bridge_options is None:
        return None
    return stack.enter_context(open_bridge(ping.bridge, bridge_options))


def check_requested_bridge(options: RecordOptions, ping: PingOptions, data_type: DataType) -> BridgeOptions | None:
    """Return the requested bridge's options, None if there is none to start.

    Raises:
        OptionError: there is no such bridge, or it does not support the options or the backend.
    """
    if ping.bridge == "none":
        return None
    bridge = load_bridge(ping.bridge)
    # Also if it already runs: the trace keeps its name.
    if bridge.needs_ros_nodes and not load_backend(options.backend).has_ros:
        raise OptionError(
            f"--bridge {ping.bridge}: it finds nodes by ros_discovery_info, which nodes of the backend {options.backend} do "
            "not publish; use --backend ros2, or zenoh-bridge-dds"
        )
    if ping.bridge_running:
        return None
    node = options.node
    if node.security is not Security.OFF and not (bridge.secures_link and node.security is Security.ENCRYPT_RTPS):
        names = ", ".join(name for name in BRIDGE_MODULES if load_bridge(name).secures_link)
        raise OptionError(
            f"--security {node.security.value} with --bridge {ping.bridge}: what can be secured is the link between two halves, by "
            f"TLS (encrypt-rtps) of {names}"
        )
    topic = BridgedTopic(data_type.topic, data_type.type_name)
    bridge_options = BridgeOptions(
        node.domain_id,
        node.domain_id if ping.relay_domain_id is None else ping.relay_domain_id,
        topics=tuple(dict.fromkeys((*BRIDGED_TOPICS, topic))),
        qos=node.qos,
        discovery=node.discovery,
        transport=node.transport,
        tuned=node.tuned,
        listen=ping.bridge_listen,
        peers=ping.bridge_peers,
        keys=node.keys,
    )
    split_halves(bridge, bridge_options)
    return bridge_options
