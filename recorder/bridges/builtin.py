"""`builtin`: our own bridge, two ROS 2 nodes in one process that forward serialized messages both ways."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path

from dds_trace.base.version import __version__

from .base import Bridge
from .builtin_common import INSTALL_ROS2, UP_LINE, Forwarder, open_side, options_from_json, options_to_json, run, serve

BRIDGE = Bridge(
    name="builtin",
    install=INSTALL_ROS2,
    tried="with every release",
    suffix=".json",
    configuration=options_to_json,
    find=lambda: Path(sys.executable) if find_spec("rclpy") else None,
    version=lambda _: __version__,
    arguments=lambda _: ("-m", __name__),
    up_pattern=f"^{UP_LINE}",
)


def main(configuration: Path) -> None:
    options = options_from_json(configuration)
    sides = options.sides()
    with ExitStack() as stack:
        nodes = [stack.enter_context(open_side(side, options)) for side in sides]
        forwarder = Forwarder()
        for side, source, there in zip(sides, nodes, reversed(nodes), strict=True):
            for name in side.takes:
                type_name = options.type_of(name)
                publisher = there.create_publisher(name, type_name)
                source.create_subscription(name, type_name, forwarder.forward(publisher.publish))
        serve(nodes, forwarder, f"domains {options.ping_domain_id} and {options.relay_domain_id}")


if __name__ == "__main__":
    run(main)
