"""The cost of recording on this machine, and the floor of the client library below every result."""

from __future__ import annotations

import secrets
import statistics
import threading
import time
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

from dds_trace.base.errors import TraceError
from dds_trace.tracefile.format.descriptions import Qos

from ..backends import load_backend
from ..errors import NoEchoError
from ..host.recorder_cost import measure_recorder_cost
from ..payloads import STRING

if TYPE_CHECKING:
    from dds_trace.tracefile.format.json_fields import Json

    from ..backends.node import NodeOptions, RawMessage
    from ..host.recorder_cost import RecorderCost

BRIEF_S = 0.15
"""Length of the measurement beside each session, enough for a median; `dds-record --self-test` takes its time."""
FLOOR_TOPIC = "dds_trace_floor"
FLOOR_MESSAGES = 200
BRIEF_FLOOR_MESSAGES = 50
"""Beside each session."""
FLOOR_PATIENCE_S = 10.0
BRIEF_FLOOR_PATIENCE_S = 2.0
COLDEST_GAP_S = 0.01
"""Longest time between two messages of the measurement: caches that rested for 10 ms are as cold as after 100 ms (a relay's
time from T3 to T4 was 51 us at 100 Hz, 52 us at 10 Hz, 14 us at 1 kHz)."""


@dataclass(frozen=True, slots=True)
class FloorCost:
    """The time from publish to callback within one process: what client library, middleware and interpreter take of one way.

    Attributes:
        median_ns: median over the messages, in ns; `p99_ns` likewise.
        messages: number of messages.
        rate_hz: messages a second; between two of them caches grow as cold as they do in a run of that rate.
    """

    median_ns: float
    p99_ns: float
    messages: int
    rate_hz: float


def measured_cost() -> dict[str, Json]:
    """Measure the session's `recorder_cost` object, times in ns; empty where nothing can be written."""
    try:
        cost = measure_recorder_cost(seconds=BRIEF_S)
    except TraceError:
        return {}  # a missing temporary folder is no reason not to record
    return {"recorder_cost": _rounded(cost)}


def measured_floor(backend: str, options: NodeOptions, rate_hz: float | None = None) -> dict[str, Json]:
    """Measure the session's `client_library_floor` object, times in ns; empty where it cannot be measured.

    The node of the measurement is closed again before the role's node opens.

    Args:
        backend: name of the backend.
        options: options of the role's node.
        rate_hz: messages a second of the run; None for a relay, which does not know it.
    """
    try:
        floor = measure_floor(backend, options, BRIEF_FLOOR_MESSAGES, BRIEF_FLOOR_PATIENCE_S, rate_hz)
    except TraceError:
        return {}  # the role's own node says what is wrong, with what to do about it
    return {"client_library_floor": _rounded(floor)}


def measure_floor(
    backend: str,
    options: NodeOptions,
    messages: int = FLOOR_MESSAGES,
    patience_s: float = FLOOR_PATIENCE_S,
    rate_hz: float | None = None,
) -> FloorCost:
    """Send small messages from a node to itself, at the rate of a run, and time them; none leaves this device.

    Where nodes do not hear themselves (sockets), from one node of this process to another.

    Args:
        backend: name of the backend.
        options: options of the role's node; its peers and its listening are left out.
        messages: number of messages.
        patience_s: longest time that the node's two ends may take to find each other.
        rate_hz: messages a second, at least one each `COLDEST_GAP_S`; that gap by default.

    Raises:
        BackendUnavailableError: the middleware is not on this machine.
        NoEchoError: the messages do not arrive.
    """
    arrived_ns, arrived = [0], threading.Event()

    def receive(_message: RawMessage, _source_ns: int = 0, _received_ns: int = 0, /) -> None:
        arrived_ns[0] = time.monotonic_ns()
        arrived.set()

    gap_s = COLDEST_GAP_S if rate_hz is None else min(1 / rate_hz, COLDEST_GAP_S)
    times_ns: list[int] = []
    topic = f"{FLOOR_TOPIC}_{secrets.randbits(64):016x}"  # so that no other device's floor is taken for ours
    alone = replace(options, name=topic, qos=Qos(), listens=False, peers=())
    here, there = load_backend(backend).open_pair(alone)
    with here, there:
        here.create_subscription(topic, STRING.type_name, receive)
        publisher = there.create_publisher(topic, STRING.type_name)
        here.start()
        if there is not here:
            there.start()
        message = STRING.make(0, 0).messages[0].data
        end_s = time.monotonic() + patience_s
        while len(times_ns) < messages:
            arrived.clear()
            time.sleep(gap_s)  # as a role does between two messages: back to back, everything is at hand
            publish_ns = time.monotonic_ns()
            publisher.publish(message)
            if arrived.wait(0.2):
                times_ns.append(arrived_ns[0] - publish_ns)
            elif time.monotonic() > end_s:  # the first ones are lost while the two ends find each other
                raise NoEchoError(f"no message of a node on {backend} to itself arrives")
    p99_ns = statistics.quantiles(times_ns, n=100)[98]
    return FloorCost(statistics.median(times_ns), p99_ns, len(times_ns), 1 / gap_s)


def _rounded(cost: RecorderCost | FloorCost) -> dict[str, int]:
    return {name: round(value) for name, value in asdict(cost).items()}
