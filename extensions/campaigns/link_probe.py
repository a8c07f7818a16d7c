"""What a link carries, by pings of plain sockets: rate, delay, loss and queue."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from dds_trace.base.errors import BackendUnavailableError
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.reading.reader import read_trace

from .plan.cells import Cell
from .plan.link import Link
from .plan.plan import Plan
from .run.result import read_responses
from .sweep import compare_clocks
from .trials import Trials, open_trials

SECONDS, PROBE_S = 3.0, 25.0
"""Length of a run, and of all with their starts and the comparison of the clocks."""

DELAY = Cell(backend="socket", transport="udp", reliability="best_effort", size=64, rate=200.0)
STREAM = Cell(backend="socket", size=1 << 16, rate=math.inf, ping_share=1.0)

STARTED = 0.3
"""Share of a stream that is left out: TCP starts slowly, and fills the buffers of both sides first."""

FLOOD, MOST_FLOOD_HZ = 2.0, 2000.0
"""Times the stream's rate at which UDP is sent, which losses do not slow down, and most datagrams a second that a recorder sends on time."""

DATAGRAM_BYTES, DROPPED = 8000, 0.2
"""Size of a datagram of the flood, and share of lost ones by which a queue beyond this machine was full."""


def probe_link(plan: Plan, folder: Path, note: Callable[[str], None]) -> Link:
    """Return the link between the devices of a plan: rate of the slower direction, least delay of one, loss of single packets.

    `queue_ms` is the default where the link could not be filled. How far the clocks of both differ is noted.

    Raises:
        BackendUnavailableError: the sockets of both devices do not reach each other.
    """
    with open_trials(replace(plan, name="link", cells=(DELAY, STREAM)), folder / "link", note, SECONDS) as trials:
        if plan.has_two_devices:
            compare_clocks(plan, trials.runner.station, trials.runner.folder, note)
        _record(trials, DELAY)
        responses_ms = read_responses(trials.paths(DELAY)[0])
        arrived = np.isfinite(responses_ms)
        if not arrived.any():
            raise BackendUnavailableError(
                "no UDP packet came back from the other device; open ports 7400 and up on both"
            )
        least_ms = float(responses_ms[arrived].min())
        _record(trials, STREAM)
        mbit_s = min(
            arriving_mbit_s(path, stage) for path, stage in zip(trials.paths(STREAM), (Stage.T2, Stage.T3), strict=True)
        )
        queue_ms = Link().queue_ms
        flood_hz = FLOOD * mbit_s * 1e6 / (8 * DATAGRAM_BYTES)
        if flood_hz < MOST_FLOOD_HZ:
            flood = replace(DELAY, size=DATAGRAM_BYTES, rate=float(round(flood_hz)))
            _record(trials, flood)
            mbit_s = max(mbit_s, arriving_mbit_s(trials.paths(flood)[1], Stage.T3))
            waits_ms = read_responses(trials.paths(flood)[0])
            if np.isinf(waits_ms).mean() > DROPPED:  # else the sender was held up
                queue_ms = max(1.0, float(waits_ms[np.isfinite(waits_ms)].max()) - least_ms)
    loss = 1 - math.sqrt(arrived.mean())  # of both ways
    return Link(
        "measured",
        round(mbit_s, 1),
        round(least_ms / 2, 2),
        loss_percent=round(100 * loss, 2),
        queue_ms=round(queue_ms),
    )


def _record(trials: Trials, cell: Cell) -> None:
    if failure := trials.record([cell], SECONDS):
        raise BackendUnavailableError(f"the link could not be measured: {failure}")


def arriving_mbit_s(path: Path, stage: Stage) -> float:
    events = read_trace(path).events[stage]
    first = int(STARTED * len(events))
    span_ns = int(events.monotonic_ns[-1] - events.monotonic_ns[first]) if len(events) > first + 1 else 0
    return 8e3 * float(events.payload_bytes[first + 1 :].sum()) / span_ns if span_ns else 0.0
