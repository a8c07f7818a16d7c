"""A check before a sweep of two devices: by how much their clocks differ, from a beacon on each."""

from __future__ import annotations

import subprocess
from typing import TYPE_CHECKING

from dds_trace.base.errors import TraceError

from ...backends import load_backend
from ...backends.base import Meeting
from ..folder import TRACE_ENDINGS, make_parts, remove_files

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from ..plan.plan import Plan
    from .station import Station

SECONDS = 6
TIMEOUT_S = 60.0
SEGMENT, OWN = "0-0-0.mcap", "clocks.ping.mcap"
"""Traces of both beacons, named as a sweep's unfinished ones."""
MARK = "your clocks differ"
"""In each line of a beacon about another one."""


def compare_clocks(plan: Plan, station: Station, folder: Path, note: Callable[[str], None]) -> None:
    """Note the difference of both devices' clocks, on the plan's first backend with discovery; a failure stops no sweep."""
    backends = (cell.backend for cell in plan.cells if not cell.environment)
    backend = next((name for name in backends if load_backend(name).meeting is Meeting.DISCOVERY), None)
    if backend is None:
        return
    words = ["--role", "beacon", "--rate", "5", "--backend", backend, "--domain", str(plan.run.domain)]
    words += ["--discovery", plan.discovery, "--no-own-cost", "--force"]
    out = make_parts(folder) / OWN
    try:
        station.device.prepare()
        other = station.device.start([*words, "--duration", str(int(TIMEOUT_S))], SEGMENT)
        try:
            command = [*station.ping_command, *words, "--duration", str(SECONDS), "--out", str(out)]
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False, errors="replace"
            )
        finally:
            other.stop()
            station.device.discard(SEGMENT)
            remove_files(out.parent, OWN, TRACE_ENDINGS)
    except (TraceError, OSError, subprocess.TimeoutExpired) as error:
        note(f"the clocks of both devices were not compared: {error}")
        return
    lines = [line for line in done.stderr.splitlines() if MARK in line]
    last = (done.stderr.splitlines() or ["no answer"])[-1]
    note(lines[-1] if lines else f"the clocks of both devices were not compared: {last}")
