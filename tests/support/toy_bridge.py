"""A bridge that is one file and one row: what its row in `BRIDGE_MODULES` points to, and the program that it runs.

It forwards in one process from one ROS 2 node to another, as `builtin` does.
"""

from __future__ import annotations

import sys
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from dds_trace.recorder.bridges.base import Halves
from dds_trace.recorder.bridges.builtin_common import (
    Forwarder,
    open_side,
    options_from_json,
    options_to_json,
    run,
    serve,
)


@dataclass(frozen=True)
class ToyBridge:
    name: str = "toy"
    install: str = "it is a test's own"
    halves: Halves = Halves.NEVER
    suffix: str = ".toy"
    up_pattern: str | None = "^bridging toys"
    needs_ros_nodes: bool = False

    def configuration(self, options):
        return options_to_json(options)

    def find(self):
        return Path(sys.executable)

    def version(self, _program):
        return "1.0-toy"

    def command(self, program, configuration, _options):
        return (str(program), __file__, str(configuration))

    def environment(self, _program, _options):
        return {"TOY": "yes"}


BRIDGE = ToyBridge()


def main(configuration):
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
