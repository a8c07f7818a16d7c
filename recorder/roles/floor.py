"""The cost of recording (of `TraceSink.record` on this machine), and the floor of the client library: the latency within one process."""

from __future__ import annotations

import itertools
import secrets
import statistics
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dds_trace.base.errors import OutputError, TraceError
from dds_trace.base.files import output_error
from dds_trace.tracefile.format.descriptions import Qos, Session
from dds_trace.tracefile.format.json_fields import Json
from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink

from ..backends import load_backend
from ..backends.node import NodeOptions, RawMessage
from ..choices import Call, ExecutorKind
from ..errors import NoEchoError
from ..payloads.string import STRING

Record = Callable[[int, int, int, int], object]

BRIEF_S = 0.15
FLOOR_TOPIC = "dds_trace_floor"
FLOOR_MESSAGES = 200
BRIEF_FLOOR_MESSAGES = 50
FLOOR_PATIENCE_S = 10.0
BRIEF_FLOOR_PATIENCE_S = 2.0
COLDEST_GAP_S = 0.01
"""Longest time between two messages: after 10 ms caches are as cold as after 100 ms."""

PACE_NS = 1_000_000
"""Time between two events: at 1 kHz, caches and draining thread are as in a node."""

STALL_EVENTS = 10
_TIMER_READINGS = 2_000
_COLD_TIMER_READINGS = 200
_CHUNK_SECONDS = 0.25  # a measurement of seconds closes several chunks


@dataclass(frozen=True, slots=True)
class RecorderCost:
    """The recorder's own cost in ns, with caches as cold as in a node at 1 kHz (`recorder_cost` of docs/trace-format.md)."""

    timer_ns: float
    record_median_ns: float
    record_p99_ns: float
    record_max_ns: float
    stall_of_ten_ns: float
    events: int
    cold_timer_ns: float = 0.0


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


def measure_recorder_cost(folder: Path | None = None, seconds: float = 3.0) -> RecorderCost:
    count = max(int(seconds * 1e9) // PACE_NS, STALL_EVENTS)
    try:
        scratch = tempfile.TemporaryDirectory(prefix="dds-trace-cost-", dir=folder)
    except OSError as err:
        raise output_error(folder or Path(tempfile.gettempdir()), err) from err
    with scratch as name:
        destination = TraceDestination(Path(name) / "cost.mcap", chunk_seconds=_CHUNK_SECONDS)
        sink = TraceSink(destination, measuring_session())
        times, readings = time_paced_events(sink.record, count)
        closed = sink.close()
    if closed.error is not None:
        raise OutputError(*closed.error.args) from closed.error
    cold_timer_ns = statistics.median(readings.tolist())
    net = np.maximum(times - cold_timer_ns, 0.0)
    return RecorderCost(
        timer_ns=measure_timer_ns(),
        # numpy's medians load numpy.ma: 50 ms at the start of each recorder.
        record_median_ns=statistics.median(net.tolist()),
        record_p99_ns=statistics.quantiles(net.tolist(), n=100, method="inclusive")[98],
        record_max_ns=float(net.max()),
        stall_of_ten_ns=worst_stall_ns(net),
        events=count,
        cold_timer_ns=cold_timer_ns,
    )


def measure_timer_ns() -> float:
    now = time.monotonic_ns
    readings = np.fromiter((now() for _ in range(_TIMER_READINGS)), np.int64, _TIMER_READINGS)
    return float(statistics.median(np.diff(readings).tolist()))


def time_paced_events(record: Record, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Record `count` events at 1 kHz, and read the clock between them.

    Returns the times in ns of the events, shape (count,), each with one reading of the clock, and the times of readings without an event.
    Both are of the same seconds: on a machine that was busier before the events, earlier readings would be too slow.
    """
    now = time.monotonic_ns
    times, readings = np.zeros(count), []
    interval = max(count // _COLD_TIMER_READINGS, 1)
    start_ns, ticks = now(), itertools.count(1)
    for sequence in range(count):
        if sequence % interval == 0:
            time.sleep(max(start_ns + next(ticks) * PACE_NS - now(), 0) / 1e9)
            stamped_ns = now()
            readings.append(now() - stamped_ns)
        time.sleep(max(start_ns + next(ticks) * PACE_NS - now(), 0) / 1e9)
        stamped_ns = now()
        record(1, 1, sequence, stamped_ns)
        times[sequence] = now() - stamped_ns
    return times, np.array(readings, np.float64)


def worst_stall_ns(times: NDArray[np.float64]) -> float:
    sums = np.convolve(times, np.ones(STALL_EVENTS), "valid")
    return float(sums.max())


def measuring_session() -> Session:
    return Session(
        session_id=0,
        role="relay",
        device="cost",
        backend="none",
        vendor="none",
        rmw=None,
        domain_id=0,
        relay_id=None,
        connectivity="none",
        wall_anchor_ns=time.time_ns(),
        monotonic_anchor_ns=time.monotonic_ns(),
    )
