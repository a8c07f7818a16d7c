"""`builtin-zenoh`: our own bridge over zenoh, domain 5 <-> zenoh <-> domain 10, one half on each device.

Each half is a ROS 2 node in its domain and a zenoh peer; the two peers meet over TCP at an address that both are
given. Run as `python -m dds_trace.recorder.bridges.builtin_zenoh CONFIGURATION` it serves one half until SIGINT or SIGTERM.
"""

from __future__ import annotations

import importlib
import json
import sys
from dataclasses import dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from .zenoh_link import zenoh_link

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from ..backends.node import RawMessage, Receive
    from .options import BridgeOptions

KEY_PREFIX = "dds_trace/bridge"
"""A topic travels between the halves as the zenoh key `dds_trace/bridge/TOPIC`."""


@dataclass(frozen=True, slots=True)
class BuiltinZenohBridge:
    """One ROS 2 node and one zenoh session in each half; see `Bridge` for the names."""

    name: str = "builtin-zenoh"
    install: str = f"it needs eclipse-zenoh (pip install eclipse-zenoh), and {INSTALL_ROS2}"
    halves: Halves = Halves.ALWAYS
    suffix: str = ".json"
    up_pattern: str | None = f"^{UP_LINE}"
    needs_ros_nodes: bool = False

    def configuration(self, options: BridgeOptions) -> str:
        """Return the options as JSON; the program needs nothing else."""
        return options_to_json(options)

    def find(self) -> Path | None:
        """Return this Python if it has rclpy and zenoh."""
        return Path(sys.executable) if find_spec("rclpy") and find_spec("zenoh") else None

    def version(self, program: Path) -> str:
        """Return our version and zenoh's."""
        del program
        return f"{__version__} (eclipse-zenoh {metadata.version('eclipse-zenoh')})"

    def command(self, program: Path, configuration: Path, options: BridgeOptions) -> Sequence[str]:
        """Return the command that runs this module."""
        del options
        return (str(program), "-m", __name__, str(configuration))

    def environment(self, program: Path, options: BridgeOptions) -> Mapping[str, str]:
        """Return no variables: the node sets its discovery range itself."""
        del program, options
        return {}


BRIDGE = BuiltinZenohBridge()


def main(configuration: Path) -> None:
    """Serve the half that the file `configuration` names."""
    zenoh: Any = importlib.import_module("zenoh")
    zenoh.init_log_from_env_or("error")
    options = options_from_json(configuration)
    (side,) = options.sides()
    forwarder = Forwarder()
    reliable = options.qos.reliability == "reliable"
    link = zenoh.Config.from_json5(json.dumps(zenoh_link(options, mode="peer")))
    with zenoh.open(link) as session, open_side(side, options) as node:
        for name in side.takes:
            key = session.declare_publisher(
                f"{KEY_PREFIX}/{name}",
                # A full queue waits as a reliable DDS writer does, or drops as a best-effort one does.
                congestion_control=zenoh.CongestionControl.BLOCK
                if reliable
                else zenoh.CongestionControl.DROP,
                reliability=zenoh.Reliability.RELIABLE if reliable else zenoh.Reliability.BEST_EFFORT,
                express=True,  # at once, not in a batch with the next message
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
        for subscriber in subscribers:  # before the node that they publish to is gone
            subscriber.undeclare()


def _from_zenoh(receive: Receive[RawMessage]) -> Callable[[Any], None]:
    return lambda sample: receive(sample.payload.to_bytes())


if __name__ == "__main__":
    run(main)
