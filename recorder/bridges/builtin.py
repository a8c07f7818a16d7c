"""`builtin`: our own bridge, two ROS 2 contexts in one process, raw forwarding in both directions.

Run as `python -m dds_trace.recorder.bridges.builtin CONFIGURATION` it serves until SIGINT or SIGTERM.
"""

from __future__ import annotations

import sys
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base.version import __version__

from .base import Halves
from .builtin_common import (
    INSTALL_ROS2,
    UP_LINE,
    Forwarder,
    open_side,
    options_from_json,
    options_to_json,
    run,
    serve,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from .options import BridgeOptions


@dataclass(frozen=True, slots=True)
class BuiltinBridge:
    """Two ROS 2 nodes in one process; see `Bridge` for the names."""

    name: str = "builtin"
    install: str = INSTALL_ROS2
    halves: Halves = Halves.NEVER
    suffix: str = ".json"
    up_pattern: str | None = f"^{UP_LINE}"
    needs_ros_nodes: bool = False

    def configuration(self, options: BridgeOptions) -> str:
        """Return the options as JSON; the program needs nothing else."""
        return options_to_json(options)

    def find(self) -> Path | None:
        """Return this Python if it has rclpy."""
        return Path(sys.executable) if find_spec("rclpy") else None

    def version(self, program: Path) -> str:
        """Return our version."""
        del program
        return __version__

    def command(self, program: Path, configuration: Path, options: BridgeOptions) -> Sequence[str]:
        """Return the command that runs this module."""
        del options
        return (str(program), "-m", __name__, str(configuration))

    def environment(self, program: Path, options: BridgeOptions) -> Mapping[str, str]:
        """Return no variables: the nodes set their discovery range themselves."""
        del program, options
        return {}


BRIDGE = BuiltinBridge()


def main(configuration: Path) -> None:
    """Serve the two domains that the file `configuration` names."""
    options = options_from_json(configuration)
    sides = options.sides()
    with ExitStack() as stack:
        nodes = [stack.enter_context(open_side(side, options)) for side in sides]
        forwarder = Forwarder()
        for side, here, there in zip(sides, nodes, reversed(nodes), strict=True):
            for name in side.takes:
                type_name = options.type_of(name)
                publisher = there.create_publisher(name, type_name)
                here.create_subscription(name, type_name, forwarder.forward(publisher.publish))
        serve(nodes, forwarder, f"domains {options.ping_domain_id} and {options.relay_domain_id}")


if __name__ == "__main__":
    run(main)
