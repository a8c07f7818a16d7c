"""A command as a user runs it: a process from its start to its end, with all that it starts itself."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import psutil

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

LOOK_S = 0.05

_LAUNCH = """
import json, os, sys, time
began = time.perf_counter()
child = os.fork()
if not child:
    os.dup2(2, 1)
    os.execv(sys.argv[1], sys.argv[1:])
_, status, used = os.wait4(child, 0)
print(json.dumps([status, time.perf_counter() - began, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024]))
"""
# A small process that starts the command: the peak of one that this process starts itself counts this one's memory
# (`exec(2)` keeps it).


@dataclass(frozen=True, slots=True)
class Ran:
    """What a command took, with the processes that it started and waited for.

    Attributes:
        wall_s: from its start to its end.
        cpu_s: processor time of all threads.
        peak_bytes: most memory at once; of several processes the peak of their sum, looked at 20 times a second.
    """

    wall_s: float
    cpu_s: float
    peak_bytes: int


def run_command(command: Sequence[str], environment: Mapping[str, str]) -> Ran:
    """Run a command to its end.

    Args:
        command: its program's path, and its arguments.
        environment: variables that it has beside this process's.

    Raises:
        SystemExit: it fails.
    """
    with tempfile.TemporaryFile() as said:
        launched = subprocess.Popen(
            [sys.executable, "-S", "-c", _LAUNCH, *command],
            env={**os.environ, **environment},
            stdout=subprocess.PIPE,
            stderr=said,
        )
        peak_of_all = 0
        while launched.poll() is None:
            peak_of_all = max(peak_of_all, _bytes_of_children(launched.pid))
            time.sleep(LOOK_S)
        assert launched.stdout is not None
        status, wall_s, cpu_s, peak_bytes = json.loads(launched.stdout.read())
        if status:
            said.seek(0)
            words = said.read().decode(errors="replace")
            raise SystemExit(f"{' '.join(command)} ended with {os.waitstatus_to_exitcode(status)}: {words}")
    return Ran(wall_s, cpu_s, max(peak_bytes, peak_of_all))


def _bytes_of_children(pid: int) -> int:
    """Return the memory of all processes below one; what several share counts once (proc_pid_smaps(5), Pss)."""
    total = 0
    with suppress(psutil.Error):  # it has ended
        for child in psutil.Process(pid).children(recursive=True):
            with suppress(OSError, StopIteration):
                lines = Path(f"/proc/{child.pid}/smaps_rollup").read_text().splitlines()
                total += 1024 * int(next(line for line in lines if line.startswith("Pss:")).split()[1])
    return total


@dataclass(frozen=True, slots=True)
class SpeedRow:
    """A row of the table of speed in `benchmarks/performance.md`; ratios are medians over rounds, with start-up taken off unless it is all.

    Attributes:
        row: what a user types, and of what.
        peer: what `over_peer` is of.
        over_before: processor time over that of the other checkout.
        asked: bar of each figure that has one, by name: `over_peer=0.2 peak_mb=250`.
    """

    row: str
    cpu_s: float
    peak_mb: float
    peer: str = ""
    over_peer: float | None = None
    over_before: float | None = None
    asked: str = ""


def keep_row(path: Path | None, row: SpeedRow) -> None:
    """Write a row into a CSV file in the place of an earlier one, for `python scripts/quoted.py`; a ratio that was not measured stays."""
    if path is None:
        return
    values = {
        name: ""
        if value is None
        else f"{value:{'.3g' if value < 1000 else '.0f'}}"
        if isinstance(value, float)
        else value
        for name, value in asdict(row).items()
    }
    rows: dict[str, dict[str, str]] = {}
    if path.exists():
        with path.open(encoding="utf-8", newline="") as file:
            rows = {earlier["row"]: earlier for earlier in csv.DictReader(file)}
    before = rows.get(row.row, {})
    rows[row.row] = {name: value if value != "" else before.get(name, "") for name, value in values.items()}
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, values, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows.values())
