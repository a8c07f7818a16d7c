"""The bridge of a ping's options: started around its recording, for the topics of its data."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .base import load_bridge
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
        OptionError: there is no such bridge, or it does not support the options.
        BackendUnavailableError: its program is not on this machine.
        BridgeError: it did not come up.
    """
    if asked.bridge == "none":
        return None
    if asked.bridge_running:
        load_bridge(asked.bridge)  # the trace keeps its name, so there must be one
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
    return stack.enter_context(open_bridge(asked.bridge, wanted))
