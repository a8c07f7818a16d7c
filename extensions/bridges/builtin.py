"""`builtin`: our own bridge, two ROS 2 nodes in one process that forward serialized messages both ways."""

from __future__ import annotations

import gc
import json
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

from dds_trace.base.errors import TraceError, TraceFormatError
from dds_trace.base.records import RecordReader, to_json
from dds_trace.base.units import counted
from dds_trace.base.version import __version__
from dds_trace.recorder.backends import open_node
from dds_trace.recorder.backends.node import Node, NodeOptions, RawMessage, Receive
from dds_trace.recorder.host.process import stop_at_signals, tuned_gc
from dds_trace.tracefile.format.descriptions import Qos

from .base import Bridge, BridgedTopic, BridgeOptions, BridgeSide

INSTALL_ROS2 = (
    "it needs ROS 2's rclpy: pip install 'dds-trace[ros2]' (in a clone '.[ros2]'), or source /opt/ros/DISTRO/setup.bash"
)
UP_LINE = "bridging"  # as its log starts

CHECK_PERIOD_S = 0.5


def options_to_json(options: BridgeOptions) -> str:
    topics = {topic.name: topic.type_name for topic in options.topics}
    return json.dumps({**to_json(options), "qos": options.qos.to_dict(), "topics": topics}, indent=2) + "\n"


def options_from_json(path: Path) -> BridgeOptions:
    try:
        values = json.loads(path.read_text())
        qos = values["qos"]
        policies = {name: qos.pop(name) for name in ("reliability", "durability", "history", "depth")}
        topics = tuple(BridgedTopic(*topic) for topic in values["topics"].items())
        options = RecordReader({"Sequence": Sequence}).read(
            BridgeOptions, {**values, "qos": {**policies, "extra": {}}, "topics": []}
        )
        return replace(options, topics=topics, qos=Qos(**policies, extra=qos))
    except (OSError, ValueError, KeyError, TypeError) as err:
        raise TraceFormatError(
            path, f"is not a configuration of a built-in bridge ({err}); `dds-trace bridge NAME --config` prints one"
        ) from err


def open_side(side: BridgeSide, options: BridgeOptions) -> Node:
    return open_node(
        "ros2",
        NodeOptions(
            domain_id=side.domain_id,
            name=f"dds_trace_bridge_{side.domain_id}",
            discovery=options.discovery,
            qos=options.qos,
            transport=options.transport,
            tuned=options.tuned,
        ),
    )


class Forwarder:
    """The routes of a bridge; each has its own count, as threads may differ."""

    def __init__(self) -> None:
        self._counts: list[list[int]] = []

    def forward(self, publish: Callable[[RawMessage], None]) -> Receive[RawMessage]:
        count = [0]
        self._counts.append(count)

        def receive(message: RawMessage, source_ns: int = 0, received_ns: int = 0, /) -> None:
            del source_ns, received_ns
            publish(message)
            count[0] += 1

        return receive

    @property
    def messages(self) -> int:
        return sum(count[0] for count in self._counts)


def serve(nodes: Sequence[Node], forwarder: Forwarder, what: str) -> None:
    stop = stop_at_signals()
    for node in nodes:
        node.start()
    with tuned_gc():
        print(f"{UP_LINE} {what}", flush=True)
        before = 0
        while not stop.wait(CHECK_PERIOD_S):
            for node in nodes:
                if node.error is not None:
                    raise node.error
            if before == (before := forwarder.messages):  # nothing is under way
                gc.collect()
    print(f"forwarded {counted(forwarder.messages, 'message')}", flush=True)


def run(main: Callable[[Path], None]) -> None:
    try:
        main(Path(sys.argv[1]))
    except TraceError as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)


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
