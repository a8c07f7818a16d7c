"""The cost of recording, and the floor of the client library: the latency within one process."""

from __future__ import annotations

import secrets
import statistics
import threading
import time
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

from dds_trace.base.errors import TraceError
from dds_trace.tracefile.format.descriptions import Qos

from ..backends import load_backend
from ..choices import Call, ExecutorKind
from ..errors import NoEchoError
from ..host.recorder_cost import measure_recorder_cost
from ..payloads.string import STRING

if TYPE_CHECKING:
    from dds_trace.tracefile.format.json_fields import Json

    from ..backends.node import NodeOptions, RawMessage
    from ..host.recorder_cost import RecorderCost

BRIEF_S = 0.15
FLOOR_TOPIC = "dds_trace_floor"
FLOOR_MESSAGES = 200
BRIEF_FLOOR_MESSAGES = 50
FLOOR_PATIENCE_S = 10.0
BRIEF_FLOOR_PATIENCE_S = 2.0
COLDEST_GAP_S = 0.01
"""Longest time between two messages: after 10 ms caches are as cold as after 100 ms."""


@dataclass(frozen=True, slots=True)
class FloorCost:
    median_ns: float
    p99_ns: float
    messages: int
    rate_hz: float


def measured_cost() -> dict[str, Json]:
    try:
        cost = measure_recorder_cost(seconds=BRIEF_S)
    except TraceError:
        return {}  # must not prevent a recording
    return {"recorder_cost": _rounded(cost)}


def measured_floor(backend: str, options: NodeOptions, rate_hz: float | None = None) -> dict[str, Json]:
    """Measure the floor, and the floor with the single-threaded executor where the node runs another one."""
    nodes, floors = {"client_library_floor": options}, dict[str, "Json"]()
    with suppress(TraceError):  # the role's own node reports what is wrong
        if load_backend(backend).has_ros and options.executor is ExecutorKind.AUTO:
            nodes["single_executor_floor"] = replace(options, executor=ExecutorKind.SINGLE)
        for name, node in nodes.items():
            floor = measure_floor(backend, node, BRIEF_FLOOR_MESSAGES, BRIEF_FLOOR_PATIENCE_S, rate_hz)
            floors[name] = _rounded(floor)
    return floors


def measure_floor(
    backend: str,
    options: NodeOptions,
    messages: int = FLOOR_MESSAGES,
    patience_s: float = FLOOR_PATIENCE_S,
    rate_hz: float | None = None,
) -> FloorCost:
    """Time small messages within this process, at the rate of a run; a `NoEchoError` if none arrives for `patience_s`."""
    received_at_ns, arrived = [0], threading.Event()

    def receive(_message: RawMessage, _source_ns: int = 0, _received_ns: int = 0, /) -> None:
        received_at_ns[0] = time.monotonic_ns()
        arrived.set()

    gap_s = COLDEST_GAP_S if rate_hz is None else min(1 / rate_hz, COLDEST_GAP_S)
    times_ns: list[int] = []
    topic = f"{FLOOR_TOPIC}_{secrets.randbits(64):016x}"  # not another device's
    isolated = replace(options, name=topic, qos=Qos(), call=Call.NONE, listens=False, peers=())
    receiver, sender = load_backend(backend).open_pair(isolated)
    with receiver, sender:
        receiver.create_subscription(topic, STRING.type_name, receive)
        publisher = sender.create_publisher(topic, STRING.type_name)
        receiver.start()
        if sender is not receiver:
            sender.start()
        message = STRING.make(0, 0, None).messages[0].data
        end_s = time.monotonic() + patience_s
        while len(times_ns) < messages:
            time.sleep(gap_s)  # cools the caches as in a run
            arrived.clear()  # a late one's, too
            publish_ns = time.monotonic_ns()
            publisher.publish(message)
            if arrived.wait(0.2):
                times_ns.append(received_at_ns[0] - publish_ns)
                end_s = time.monotonic() + patience_s
            elif time.monotonic() > end_s:  # the first ones are lost before the endpoints have matched
                raise NoEchoError(f"no message of a node on {backend} to itself arrives")
    p99_ns = statistics.quantiles(times_ns, n=100)[98]
    return FloorCost(statistics.median(times_ns), p99_ns, len(times_ns), 1 / gap_s)


def _rounded(cost: RecorderCost | FloorCost) -> dict[str, int]:
    return {name: round(value) for name, value in asdict(cost).items()}
