"""The bridge of a ping's options: started around its recording, for the topics of its data."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dds_trace.base.errors import OptionError

from ..backends import load_backend
from .base import load_bridge, split_halves
from .options import BRIDGED_TOPICS, BridgedTopic, BridgeOptions
from .process.running import open_bridge

if TYPE_CHECKING:
    from contextlib import ExitStack

    from ..options import PingOptions, RecordOptions
    from ..payloads.base import DataType
    from .process.running import RunningBridge


def open_asked_bridge(
    options: RecordOptions, asked: PingOptions, data_type: DataType, stack: ExitStack
) -> RunningBridge | None:
    """Open the bridge that the ping's options name; it ends with `stack`.

    Returns:
        The bridge, or None if the options name none or say that it runs already.

    Raises:
        OptionError: there is no such bridge, or it does not support the options or the backend.
        BackendUnavailableError: its program is not on this machine.
        BridgeError: it did not come up.
    """
    wanted = check_asked_bridge(options, asked, data_type)
    return None if wanted is None else stack.enter_context(open_bridge(asked.bridge, wanted))


def check_asked_bridge(
    options: RecordOptions, asked: PingOptions, data_type: DataType
) -> BridgeOptions | None:
    """Return the options of the bridge that the ping's options name, None if there is none to be started.

    Raises:
        OptionError: there is no such bridge, or it does not support the options or the backend.
    """
    if asked.bridge == "none":
        return None
    bridge = load_bridge(asked.bridge)
    # Also of one that runs already: the trace keeps its name.
    if bridge.needs_ros_nodes and not load_backend(options.backend).has_ros:
        raise OptionError(
            f"--bridge {asked.bridge}: it knows nodes by ros_discovery_info, which those of the backend {options.backend} do "
            "not publish; use --backend ros2, or zenoh-bridge-dds"
        )
    if asked.bridge_running:
        return None
    node = options.node
    topic = BridgedTopic(data_type.topic, data_type.type_name)
    wanted = BridgeOptions(
        node.domain_id,
        node.domain_id if asked.relay_domain_id is None else asked.relay_domain_id,
        topics=tuple(dict.fromkeys((*BRIDGED_TOPICS, topic))),
        qos=node.qos,
        discovery=node.discovery,
        transport=node.transport,
        tuned=node.tuned,
        listen=asked.bridge_listen,
        peers=asked.bridge_peers,
    )
    split_halves(bridge, wanted)
    return wanted
