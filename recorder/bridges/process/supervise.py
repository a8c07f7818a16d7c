"""A bridge's program as a supervised child process: started, watched, sampled, ended, never orphaned.

`guard.py` stands between this process and the program. Closing the pipe to it stops the program, and the kernel closes
it when this process dies, however it dies.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import psutil

from ...errors import BridgeError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

STOP_PATIENCE_S = 4.0
"""Time for a program to end after SIGINT, then after SIGTERM, before it is killed."""

LAST_LINES = 40
"""Most lines of the log's tail in messages and traces."""

LAST_LINES_BYTES = 8 * 1024
"""Most bytes of those lines together."""

OUTSIDE_SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
"""Signals that come from others: the log of a program that one of them ended says nothing about its end."""

_WHEELS_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"


@dataclass(frozen=True, slots=True)
class GuardReport:
    """The end of a program.

    Attributes:
        asked: whether it still ran when it was told to stop.
        exit_code: its exit code, or 128 + signal.
        left_behind: number of its children that outlived it and had to be ended.
        log_bytes: bytes that it wrote to its log, kept or not.
    """

    asked: bool
    exit_code: int
    left_behind: int
    log_bytes: int


@dataclass(frozen=True, slots=True)
class ProgramLoad:
    """The present load of a program and its children.

    Attributes:
        cpu_percent: CPU time since the sample before, in percent of one core; 0 in the first sample.
        memory_bytes: resident memory.
        processes: number of processes.
    """

    cpu_percent: float
    memory_bytes: int
    processes: int


class SupervisedProgram:
    """One program from its start to its end.

    Args:
        command: program and arguments.
        folder: holds its log, `log` and `log.1`; removed by the guard if this process dies.
        environment: all environment variables of the program.
        up_pattern: regular expression of the log line that says it serves, None if its log has no such line.

    Raises:
        BridgeError: the program cannot be started.
    """

    def __init__(
        self, command: Sequence[str], folder: Path, environment: Mapping[str, str], up_pattern: str | None
    ) -> None:
        self.command = tuple(command)
        self._folder = folder
        self._up_pattern = up_pattern
        self._report: GuardReport | None = None
        self._last_log: str | None = None
        self._stopping = False
        self._followed: dict[int, psutil.Process] = {}
        guard = Path(__file__).with_name("guard.py")
        # -I -S: the guard needs the standard library alone, and nothing of ours may keep it from starting.
        self._guard = subprocess.Popen(
            [
                sys.executable,
                "-I",
                "-S",
                str(guard),
                str(folder),
                up_pattern or "",
                str(STOP_PATIENCE_S),
                *self.command,
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=dict(environment),
            start_new_session=True,  # Ctrl-C is for the recorder, which stops the bridge when it is done with it
        )
        assert self._guard.stdin is not None
        assert self._guard.stdout is not None
        self.pid = int(self._guard.stdout.readline() or 0)
        if not self.pid:
            self.stop()
            raise BridgeError(f"cannot start {self.command[0]}: {self.last_line()}; try it by hand")

    @property
    def report(self) -> GuardReport | None:
        """The end of the program, None while it runs."""
        if self._guard.poll() is None:
            return None
        return self._keep_report()

    @property
    def is_up(self) -> bool:
        """Whether the log matched `up_pattern`; always true without a pattern."""
        return self._up_pattern is None or (self._folder / "up").exists()

    def log_tail(self) -> str:
        """Return the last lines of the program's log, at most 8 KiB; they are kept when it is stopped."""
        if self._last_log is not None:
            return self._last_log
        content = b""
        for name in ("log.1", "log"):
            with contextlib.suppress(FileNotFoundError):  # it never wrote that much, or they are just swapped
                content += (self._folder / name).read_bytes()
        text = content[-LAST_LINES_BYTES:].decode(errors="replace")
        return "\n".join(text.splitlines()[-LAST_LINES:])

    def last_line(self) -> str:
        """Return the last line of the log that is not empty."""
        return next(
            (line for line in reversed(self.log_tail().splitlines()) if line.strip()), "it said nothing"
        )

    def load(self) -> ProgramLoad:
        """Return the present load of the program and its children."""
        loads = []
        for pid in self._pids():
            with contextlib.suppress(psutil.Error):  # it ended meanwhile
                process = self._followed.setdefault(pid, psutil.Process(pid))
                loads.append((process.cpu_percent(), process.memory_info().rss))
        return ProgramLoad(sum(cpu for cpu, _ in loads), sum(memory for _, memory in loads), len(loads))

    def stop(self) -> None:
        """End the program, its children and the guard; a second call does nothing."""
        assert self._guard.stdin is not None
        self._stopping = True
        with contextlib.suppress(BrokenPipeError):  # it has ended by itself
            if not self._guard.stdin.closed:
                self._guard.stdin.write(b"stop\n")
                self._guard.stdin.close()
        try:
            self._guard.wait(5 * STOP_PATIENCE_S + 5)  # the program's three signals, its children's two
        except subprocess.TimeoutExpired:
            self._guard.kill()  # the program is told by the kernel to go with it
            self._guard.wait()
        self._keep_report()
        self._last_log = self._last_log or self.log_tail()

    def _pids(self) -> list[int]:
        try:
            return [child.pid for child in psutil.Process(self._guard.pid).children(recursive=True)]
        except psutil.Error:
            return []

    def _keep_report(self) -> GuardReport:
        """Return the report that the ended guard has printed; it is read once."""
        if self._report is None:
            assert self._guard.stdout is not None
            line = self._guard.stdout.read()
            self._guard.stdout.close()
            # Without a line the guard itself was killed, and the kernel has killed the program with it.
            self._report = (
                GuardReport(**json.loads(line))
                if line.startswith(b"{")
                else GuardReport(self._stopping, 128 - self._guard.returncode, left_behind=0, log_bytes=0)
            )
        return self._report


def killing_signal(exit_code: int) -> signal.Signals | None:
    """Return the signal that ended a program, None if it ended by itself.

    Args:
        exit_code: its exit code, or -signal as `subprocess` tells, or 128 + signal as a shell and the guard tell.
    """
    try:
        return signal.Signals(-exit_code if exit_code < 0 else exit_code - 128)
    except ValueError:
        return None


def describe_end(exit_code: int, last_words: str) -> str:
    """Return how a program ended: `killed by signal 9 (SIGKILL)`, or what it said last.

    Args:
        exit_code: as for `killing_signal`.
        last_words: the last line of its log, which is kept where it may explain the end.
    """
    number = killing_signal(exit_code)
    if number is None:
        return last_words
    killed = f"killed by signal {number.value} ({number.name})"
    return killed if number in OUTSIDE_SIGNALS else f"{killed}: {last_words}"


def program_environment(extra: Mapping[str, str], *, foreign: bool) -> dict[str, str]:
    """Return the environment variables of a bridge's program.

    Args:
        extra: variables that the program needs beyond those of this process.
        foreign: whether the program brings libraries of its own; then the search path that the ROS 2 wheels made
            for themselves (see `docs/reference/bridges.md`) must not reach it.
    """
    variables = {**os.environ, **extra}
    if foreign and variables.pop(_WHEELS_GUARD, ""):
        paths = variables.pop("LD_LIBRARY_PATH", "").split(os.pathsep)
        ours = [path for path in paths if path and not Path(path).is_relative_to(sys.prefix)]
        if ours:
            variables["LD_LIBRARY_PATH"] = os.pathsep.join(ours)
    return variables
