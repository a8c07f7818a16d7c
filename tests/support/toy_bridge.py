"""A bridge that is one file and one row: what its row in `BRIDGE_MODULES` points to, and the program that it runs.

It forwards in one process from one ROS 2 node to another, as `builtin` does.
"""

from __future__ import annotations

import sys
from contextlib import ExitStack
from pathlib import Path

from dds_trace.extensions.bridges.base import Bridge
from dds_trace.extensions.bridges.builtin import Forwarder, open_side, options_from_json, options_to_json, run, serve

BRIDGE = Bridge(
    name="toy",
    install="it is a test's own",
    tried="in this test",
    suffix=".toy",
    configuration=options_to_json,
    find=lambda: Path(sys.executable),
    version=lambda _: "1.0-toy",
    arguments=lambda _: (__file__,),
    environment=lambda _: {"TOY": "yes"},
    up_pattern="^bridging toys",
)


def main(configuration: Path) -> None:
    """Forward between the two domains of the file `configuration`."""
    options = options_from_json(configuration)
    with ExitStack() as stack:
        nodes = [stack.enter_context(open_side(side, options)) for side in options.sides()]
        forwarder = Forwarder()
        for side, here, there in zip(options.sides(), nodes, reversed(nodes), strict=True):
            for name in side.takes:
                publisher = there.create_publisher(name, options.type_of(name))
                here.create_subscription(name, options.type_of(name), forwarder.forward(publisher.publish))
        serve(nodes, forwarder, "toys")


if __name__ == "__main__":
    run(main)
