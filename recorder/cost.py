"""What the recorder itself costs on this machine, and the floor of the client library below every result."""

from __future__ import annotations

import statistics
import threading
import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from recorder.backends import open_node
from recorder.payloads import STRING
from tracefile import NoEchoError, TraceError, measure_recorder_cost

if TYPE_CHECKING:
    from recorder.backend import NodeOptions

BRIEF_S = 0.15
"""Enough for a median beside each session; `dds-record --self-test` takes its time."""
FLOOR_TOPIC = "dds_trace_floor"
FLOOR_MESSAGES = 200
FLOOR_PATIENCE_S = 10.0


@dataclass(frozen=True, slots=True)
class FloorCost:
    """From publish to callback within one node: what the client library and its middleware take at least, in ns."""

    median_ns: float
    p99_ns: float
    messages: int


def measured_cost() -> dict[str, Any]:
    """The session's `recorder_cost` object, times in ns; empty where nothing can be written."""
    try:
        cost = measure_recorder_cost(seconds=BRIEF_S)
    except TraceError:
        return {}  # a missing temporary folder is no reason not to record
    return {"recorder_cost": {name: round(value) for name, value in asdict(cost).items()}}


def measure_floor(backend: str, options: NodeOptions) -> FloorCost:
    """One message of a few bytes after the other, from a node to itself.

    Raises:
        BackendUnavailableError: the middleware is not on this machine.
        NoEchoError: the messages do not arrive.
    """
    arrived_ns, arrived = [0], threading.Event()

    def receive(_message: Any, _source_ns: int = 0, _received_ns: int = 0, /) -> None:
        arrived_ns[0] = time.monotonic_ns()
        arrived.set()

    times_ns: list[int] = []
    with open_node(backend, options) as node:
        node.create_subscription(FLOOR_TOPIC, STRING.type_name, receive)
        publisher = node.create_publisher(FLOOR_TOPIC, STRING.type_name)
        node.start()
        message = STRING.make(0, 0).messages[0].data
        end_s = time.monotonic() + FLOOR_PATIENCE_S
        while len(times_ns) < FLOOR_MESSAGES:
            arrived.clear()
            publish_ns = time.monotonic_ns()
            publisher.publish(message)
            if arrived.wait(0.2):
                times_ns.append(arrived_ns[0] - publish_ns)
            elif time.monotonic() > end_s:  # the first ones are lost while the two ends find each other
                raise NoEchoError(f"no message of a node on {backend} to itself arrives")
    return FloorCost(statistics.median(times_ns), statistics.quantiles(times_ns, n=100)[98], len(times_ns))
