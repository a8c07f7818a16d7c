"""One round of chaos, in namespaces of its own: `chaos.py` makes them and starts this.

    unshare --mount --net --pid --fork --mount-proc --kill-child python chaos_round.py SEED FOLDER [BACKEND:BRIDGE ...]

As the first process there it sees every process that is left at the end, and the kernel ends all with it. A seed repeats
the moments of the faults in the same plan, not the scheduling of the machine.
"""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

from chaos_checks import (
    Call,
    forgotten_cells,
    left_files,
    left_memory,
    left_namespaces,
    untrue_exit,
    untrue_folder,
    whole_cells,
)
from chaos_draw import Fault, Round, draw_round, installed_combinations
from chaos_faults import Timetable, World, compile_slow_disk, find_target, running_processes

DISK_BYTES = 40 << 20
CALM_CALLS = 3
"""Calls without a fault after which every cell must be complete; a busy machine may fail one."""

LONGEST_CALL_S = 300.0
ENDED_S, KILLED_S = 60.0, 90.0
"""Time for the processes of a sweep that has ended, or was killed, to end; the latter close their traces."""

POLL_S = 0.02


class ChaosRound:
    def __init__(self, drawn: Round, folder: Path) -> None:
        self._drawn = drawn
        self._folder = folder
        self._home, self._temporary, self._disk = (folder / name for name in ("home", "tmp", "disk"))
        for path in (self._home, self._temporary, self._disk):
            path.mkdir(parents=True)
        self._world = World(self._disk, folder / "slow", random.Random(f"chaos strikes {drawn.seed}"))
        self._plan = folder / "chaos.toml"
        self._plan.write_text(drawn.plan)
        self._runs = self._disk / "runs" / "chaos"
        self.codes: list[int] = []
        self.faults: list[Fault] = []
        self.wrong: list[str] = []

    def run(self) -> None:
        """Disturb the sweep, then let it end; collect faults of ours in `wrong`."""
        self._make_world()
        for faults in self._drawn.calls:
            if self._call(faults) == 0:  # nothing is left that could be disturbed
                break
        for _ in range(CALM_CALLS):
            if self.wrong or self._call(()) == 0:
                break
        else:
            self.wrong.append(f"not every cell is complete after {CALM_CALLS} calls without a fault")
        if not self.wrong:
            self.wrong += untrue_folder(self._runs, self._drawn.cells)
            self.wrong += self._left(self._temporary, self._home)
        if self.wrong:
            shutil.copytree(self._disk, self._folder / "left", symlinks=True)

    def _make_world(self) -> None:
        """Give the round network, shared memory, names of namespaces and a disk of its own."""
        for words in (
            ("ip", "link", "set", "lo", "up"),
            ("mount", "-t", "tmpfs", "-o", "mode=1777", "tmpfs", "/dev/shm"),
            ("mkdir", "-p", "/run/netns"),
            ("mount", "-t", "tmpfs", "tmpfs", "/run/netns"),
            ("mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(self._disk)),
        ):
            subprocess.run(words, check=True, env={**os.environ, "PATH": f"{os.environ['PATH']}:/usr/sbin:/sbin"})
        self._environment = {
            **{name: value for name, value in os.environ.items() if name != "PYTHONPATH"},
            "HOME": str(self._home),
            "TMPDIR": str(self._temporary),
            "XDG_DATA_HOME": os.environ.get("XDG_DATA_HOME") or str(Path.home() / ".local" / "share"),
            "XDG_CACHE_HOME": str(self._folder / "cache"),
            "XDG_STATE_HOME": str(self._folder / "state"),
            "ROS_LOG_DIR": str(self._folder / "ros"),
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        if any(fault.kind == "slow-disk" for faults in self._drawn.calls for fault in faults):
            library = compile_slow_disk(self._folder)
            if library is not None:
                self._environment |= {
                    "LD_PRELOAD": str(library),
                    "CHAOS_DISK": str(self._disk),
                    "CHAOS_SLOW": str(self._world.slow),
                    "CHAOS_SLOW_MS": str(self._drawn.slow_ms),
                }

    def _call(self, faults: tuple[Fault, ...]) -> int:
        """Call `dds-trace sweep` once while these faults happen, and check what it did; return its exit code."""
        number = len(self.codes)
        before, killed_before = whole_cells(self._runs), len(self._world.killed)
        timetable = Timetable(faults, self._world)
        log = self._folder / f"call{number}.log"
        command = [Path(sys.executable).with_name("dds-trace"), "sweep", self._plan, "--out", self._disk / "runs"]
        with log.open("wb") as output:
            streams = {"stdin": subprocess.DEVNULL, "stdout": output, "stderr": subprocess.STDOUT}
            sweep = subprocess.Popen(command, env=self._environment, **streams)
            self._world.sweep = sweep.pid
            deadline = time.monotonic() + LONGEST_CALL_S
            while sweep.poll() is None and time.monotonic() < deadline:
                if find_target("ping", sweep.pid):
                    timetable.start()
                timetable.advance()
                time.sleep(POLL_S)
            timetable.end()
            if sweep.poll() is None:
                self.wrong.append(f"call {number} did not end: {[*map(str, running_processes().values())]}")
                sweep.kill()
            code = sweep.wait()
        self._wait_for_the_end(number, KILLED_S if code < 0 else ENDED_S)
        happened = tuple(timetable.happened)
        call = Call(code, log.read_text(errors="replace"), happened, tuple(self._world.killed[killed_before:]))
        self.codes.append(code)
        self.faults += happened
        wrong = [*untrue_exit(call, self._runs, self._drawn.cells), *forgotten_cells(before, self._runs)]
        if code >= 0:  # the next sweep cleans up after a killed one
            wrong += self._left(self._temporary)
        self.wrong += [f"call {number}: {fault}" for fault in wrong]
        return code

    def _left(self, *folders: Path) -> list[str]:
        return [*left_namespaces(), *left_memory(bool(self._world.killed)), *left_files(*folders)]

    def _wait_for_the_end(self, number: int, patience_s: float) -> None:
        deadline = time.monotonic() + patience_s
        while (left := running_processes()) and time.monotonic() < deadline:
            time.sleep(POLL_S)
            with suppress(ChildProcessError):  # orphans are ours, and would stay as zombies
                while os.waitpid(-1, os.WNOHANG)[0]:
                    pass
        self.wrong += [f"call {number}: process {process} is left" for process in left.values()]


def main() -> None:
    seed, folder, only = int(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:]
    combinations = installed_combinations()
    drawn = draw_round(seed, [pair for pair in combinations if not only or ":".join(pair) in only])
    # A parent may ignore Ctrl-C, which our children would inherit.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    played = ChaosRound(drawn, folder)
    began = time.monotonic()
    try:
        played.run()
    except Exception as err:
        played.wrong.append(f"the round itself failed: {err!r}")
        raise
    finally:
        line = {
            "seed": seed,
            "backend": drawn.combination[0],
            "bridge": drawn.combination[1],
            "network": drawn.network,
            "cells": drawn.cells,
            "faults": [*map(str, played.faults)],
            "codes": played.codes,
            "seconds": round(time.monotonic() - began, 1),
            "wrong": played.wrong,
        }
        (folder / "round.json").write_text(json.dumps(line, indent=1))


if __name__ == "__main__":
    main()
