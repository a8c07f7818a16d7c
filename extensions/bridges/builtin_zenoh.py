"""`builtin-zenoh`: our own bridge over zenoh, one half on each device."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Callable
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from dds_trace.base.version import __version__
from dds_trace.recorder.backends.node import RawMessage, Receive
from dds_trace.recorder.choices import Reliability

from .base import Bridge, Halves
from .builtin import INSTALL_ROS2, UP_LINE, Forwarder, open_side, options_from_json, options_to_json, run, serve
from .zenoh_link import zenoh_link

KEY_PREFIX = "dds_trace/bridge"
"""A topic's zenoh key is `dds_trace/bridge/TOPIC`."""


BRIDGE = Bridge(
    name="builtin-zenoh",
    install=f"it needs eclipse-zenoh (pip install eclipse-zenoh), and {INSTALL_ROS2}",
    tried="with every release, eclipse-zenoh 1.10",
    suffix=".json",
    configuration=options_to_json,
    find=lambda: Path(sys.executable) if find_spec("rclpy") and find_spec("zenoh") else None,
    version=lambda _: f"{__version__} (eclipse-zenoh {metadata.version('eclipse-zenoh')})",
    arguments=lambda _: ("-m", __name__),
    halves=Halves.ALWAYS,
    secures_link=True,
    up_pattern=f"^{UP_LINE}",
)


def main(configuration: Path) -> None:
    zenoh: Any = importlib.import_module("zenoh")
    zenoh.init_log_from_env_or("error")
    options = options_from_json(configuration)
    (side,) = options.sides()
    forwarder = Forwarder()
    is_reliable = options.qos.reliability == Reliability.RELIABLE
    congestion, reliability = zenoh.CongestionControl, zenoh.Reliability
    link = zenoh.Config.from_json5(json.dumps(zenoh_link(options, mode="peer")))
    with zenoh.open(link) as session, open_side(side, options) as node:
        for name in side.takes:
            key = session.declare_publisher(
                f"{KEY_PREFIX}/{name}",
                # When full, block as a reliable DDS writer does, or drop as a best-effort one does.
                congestion_control=congestion.BLOCK if is_reliable else congestion.DROP,
                reliability=reliability.RELIABLE if is_reliable else reliability.BEST_EFFORT,
                express=True,  # not batched with the next message
            )
            node.create_subscription(name, options.type_of(name), forwarder.forward(key.put))
        subscribers = [
            session.declare_subscriber(
                f"{KEY_PREFIX}/{name}",
                _from_zenoh(forwarder.forward(node.create_publisher(name, options.type_of(name)).publish)),
            )
            for name in side.puts
        ]
        serve([node], forwarder, f"domain {side.domain_id} and zenoh")
        for subscriber in subscribers:  # they publish to the node
            subscriber.undeclare()


def _from_zenoh(receive: Receive[RawMessage]) -> Callable[[Any], None]:
    return lambda sample: receive(sample.payload.to_bytes())


if __name__ == "__main__":
    run(main)
