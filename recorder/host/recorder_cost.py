"""The time that `TraceSink.record` takes on this machine."""

from __future__ import annotations

import itertools
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dds_trace.base.errors import OutputError
from dds_trace.base.files import output_error
from dds_trace.tracefile.format.descriptions import Session
from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink

Record = Callable[[int, int, int, int], object]


PACE_NS = 1_000_000
"""Time between two events: at 1 kHz, caches and draining thread are as in a node."""

STALL_EVENTS = 10
_TIMER_READINGS = 2_000
_COLD_TIMER_READINGS = 200
_CHUNK_SECONDS = 0.25  # a measurement of seconds closes several chunks


@dataclass(frozen=True, slots=True)
class RecorderCost:
    """The recorder's own cost in ns, with caches as cold as in a node at 1 kHz.

    Attributes:
        record_median_ns: recording one event; likewise `record_p99_ns` and `record_max_ns`.
        cold_timer_ns: one reading of the clock after a sleep, taken between the events and subtracted from their times.
    """

    timer_ns: float
    record_median_ns: float
    record_p99_ns: float
    record_max_ns: float
    stall_of_ten_ns: float
    events: int
    cold_timer_ns: float = 0.0


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
