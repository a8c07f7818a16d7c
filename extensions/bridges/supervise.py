"""A bridge's program as a child of `guard.py`, never orphaned."""

from __future__ import annotations

import contextlib
import json
import re
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil

from dds_trace.recorder.errors import BridgeError
from dds_trace.recorder.host.child import Child

STOP_PATIENCE_S = 4.0
"""Time to end after SIGINT, then after SIGTERM, before SIGKILL."""

LAST_LINES = 40

LAST_LINES_BYTES = 8 * 1024

_COLOUR_CODE = re.compile(r"\x1b\[[0-9;]*m")

OUTSIDE_SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
"""The log does not explain an end by one of these, which others send."""


@dataclass(frozen=True, slots=True)
class GuardReport:
    asked: bool
    """Whether it still ran when it was asked to stop."""
    exit_code: int
    """Its exit code, or 128 + signal."""
    left_behind: int
    log_bytes: int


@dataclass(frozen=True, slots=True)
class ProgramLoad:
    """CPU of a program and its children since the previous sample (of one core), and resident memory."""

    cpu_percent: float
    memory_bytes: int
    processes: int


class SupervisedProgram:
    """One program with its log in `folder`; a failed start is a `BridgeError`."""

    def __init__(
        self, command: Sequence[str], folder: Path, environment: Mapping[str, str], up_pattern: str | None
    ) -> None:
        self.command = tuple(command)
        self._folder = folder
        self._up_pattern = up_pattern
        self._report: GuardReport | None = None
        self._last_log: str | None = None
        self._stopping = False
        self._processes: dict[int, psutil.Process] = {}
        guard = Path(__file__).with_name("guard.py")
        # -I -S: the guard needs only the standard library, and must start whatever is installed.
        words = sys.executable, "-I", "-S", guard, folder, up_pattern or "", STOP_PATIENCE_S, *self.command
        self._guard = Child(
            words, ends_by_input=True, lost=self._cannot_start, stdout=subprocess.PIPE, env=dict(environment)
        )
        self.pid: int = self._guard.answer()
        if not self.pid:
            self.stop()
            raise self._cannot_start()

    def _cannot_start(self) -> BridgeError:
        return BridgeError(f"cannot start {self.command[0]}: {self.last_line()}; try it by hand")

    @property
    def report(self) -> GuardReport | None:
        return None if self._guard.poll() is None else self._read_report()

    @property
    def is_up(self) -> bool:
        return self._up_pattern is None or (self._folder / "up").exists()

    def log_tail(self) -> str:
        if self._last_log is not None:
            return self._last_log
        content = b""
        for name in ("log.1", "log"):
            with contextlib.suppress(FileNotFoundError):  # shorter log, or the two are swapped just now
                content += (self._folder / name).read_bytes()
        text = _COLOUR_CODE.sub("", content[-LAST_LINES_BYTES:].decode(errors="replace"))
        return "\n".join(text.splitlines()[-LAST_LINES:])

    def last_line(self) -> str:
        return next((line for line in reversed(self.log_tail().splitlines()) if line.strip()), "it logged nothing")

    def load(self) -> ProgramLoad:
        loads = []
        with contextlib.suppress(psutil.Error):  # the guard has ended
            for child in psutil.Process(self._guard.pid).children(recursive=True):
                with contextlib.suppress(psutil.Error):  # it has ended
                    process = self._processes.setdefault(child.pid, child)
                    loads.append((process.cpu_percent(), process.memory_info().rss))
        return ProgramLoad(sum(cpu for cpu, _ in loads), sum(memory for _, memory in loads), len(loads))

    def stop(self) -> None:
        if not self._stopping:
            self._stopping = True
            with contextlib.suppress(BridgeError):  # the guard has ended
                self._guard.say("stop")
        # The program's three signals, its children's two; then the kernel ends the program with the guard.
        self._guard.end(5 * STOP_PATIENCE_S + 5)
        self._read_report()
        self._last_log = self._last_log or self.log_tail()

    def _read_report(self) -> GuardReport:
        if self._report is None:
            assert self._guard.stdout is not None
            line = self._guard.stdout.read()
            self._guard.stdout.close()
            # Without a line the guard was killed, and the program with it.
            self._report = (
                GuardReport(**json.loads(line))
                if line.startswith(b"{")
                else GuardReport(self._stopping, 128 - self._guard.returncode, left_behind=0, log_bytes=0)
            )
        return self._report


def killing_signal(exit_code: int) -> signal.Signals | None:
    """Return the signal of an exit code: -signal (`subprocess`) or 128 + signal (a shell, the guard)."""
    try:
        return signal.Signals(-exit_code if exit_code < 0 else exit_code - 128)
    except ValueError:
        return None


def describe_end(exit_code: int, last_line: str) -> str:
    number = killing_signal(exit_code)
    if number is None:
        return last_line
    killed = f"killed by signal {number.value} ({number.name})"
    return killed if number in OUTSIDE_SIGNALS else f"{killed}: {last_line}"
