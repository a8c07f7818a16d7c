"""By how much the clocks of all pairs of devices differ before a sweep, from a beacon on each."""

from __future__ import annotations

import subprocess
from typing import TYPE_CHECKING

from dds_trace.base.errors import TraceError

from ...backends import load_backend
from ...backends.base import Meeting
from ..folder import TRACE_ENDINGS, log_path, make_parts, remove_files, segment_of

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from ..plan.plan import Plan
    from .devices import StartedProgram
    from .station import Station

SECONDS = 6
TIMEOUT_S = 60.0
SEGMENT, OWN = "0-0-0.mcap", "clocks.ping.mcap"
MARK = "your clocks differ"


def compare_clocks(plan: Plan, station: Station, folder: Path, note: Callable[[str], None]) -> None:
    """Note how the clocks of all pairs of devices differ, on the plan's first backend with discovery; a failure stops no sweep."""
    backends = (cell.backend for cell in plan.cells if not cell.environment)
    backend = next((name for name in backends if load_backend(name).meeting is Meeting.DISCOVERY), None)
    if backend is None:
        return
    words = ["--role", "beacon", "--rate", "5", "--backend", backend, "--domain", str(plan.run.domain)]
    words += ["--discovery", plan.discovery, "--no-own-cost", "--force"]
    out = make_parts(folder) / OWN
    names = [host.name or host.ssh or "" for host in plan.hosts] or [""]
    others: dict[str, StartedProgram] = {}
    seen: list[str] = []
    try:
        station.device.prepare()
        try:
            for number, name in enumerate(names):
                device_option = ["--device", name] if name else []
                segment = segment_of(SEGMENT, number + 1, number)
                long = [*words, *device_option, "--duration", str(int(TIMEOUT_S))]
                others[segment] = station.device.start(long, segment)
            command = [*station.ping_command, *words, "--duration", str(SECONDS), "--out", str(out)]
            ended = subprocess.run(
                command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False, errors="replace"
            )
        finally:
            for other in others.values():
                other.stop()
            for number, segment in enumerate(others, 1):
                log = log_path(out.parent, segment)
                latest = _latest(log.read_text(errors="replace")) if len(names) > 1 else {}
                seen += [f"seen from {names[number - 1]}: {latest[name]}" for name in names[number:] if name in latest]
                station.device.discard(segment)
            remove_files(out.parent, OWN, TRACE_ENDINGS)
    except (TraceError, OSError, subprocess.TimeoutExpired) as error:
        note(f"the clocks of both devices were not compared: {error}")
        return
    lines = _latest(ended.stderr)
    last = (ended.stderr.splitlines() or ["no answer"])[-1]
    for line in [*lines.values(), *seen] or [f"the clocks of both devices were not compared: {last}"]:
        note(line)
    for name in names:
        if name and lines and name not in lines:
            note(f"{name}: its clock was not compared; its beacon did not answer")


def _latest(text: str) -> dict[str, str]:
    return {line.partition(":")[0].split()[-1]: line for line in text.splitlines() if MARK in line}
