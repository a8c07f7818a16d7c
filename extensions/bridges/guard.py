"""The guard of one bridge program: bounds its log and ends it with all its children.

It imports no module of ours, as `supervise.py` starts it as a file. It ends the program when its standard input closes,
also by a kill of the recorder.

    guard.py FOLDER UP_PATTERN PATIENCE_S PROGRAM ARGUMENTS...

prints the program's pid, creates `FOLDER/up` when the output matches UP_PATTERN, and prints a `GuardReport` at the end.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import re
import selectors
import shutil
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

LOG_LIMIT_BYTES = 128 * 1024

READ_BYTES = 64 * 1024
LAST_READS = 64
"""Most reads after the program's end: a child may go on writing for ever."""

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
"""Signals to the program, with the patience between them."""

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36  # <linux/prctl.h>
CANNOT_START = 127


class BoundedLog:
    """The last part of a log, in `FOLDER/log` and `FOLDER/log.1`."""

    def __init__(self, folder: Path, up_pattern: str) -> None:
        self._path = folder / "log"
        self._up = folder / "up"
        self._up_pattern = re.compile(up_pattern.encode(), re.MULTILINE) if up_pattern else None
        self._recent = b""
        self._file = self._path.open("wb", buffering=0)
        self.total_bytes = 0

    def write(self, data: bytes) -> None:
        self.total_bytes += len(data)
        with contextlib.suppress(OSError):  # a full disk costs the log, not the bridge
            if self._up_pattern is not None:
                self._recent = (self._recent + data)[-READ_BYTES - 1024 :]  # the line may come in two pieces
                if self._up_pattern.search(self._recent):
                    self._up.touch()
                    self._up_pattern = None
            if self._file.tell() + len(data) > LOG_LIMIT_BYTES:
                self._file.close()
                self._path.replace(self._path.with_name("log.1"))
                self._file = self._path.open("wb", buffering=0)
            self._file.write(data)


def descendants() -> list[int]:
    children: dict[int, list[int]] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it has ended
            # The name in parentheses may contain anything.
            state, parent = stat.read_text(errors="replace").rpartition(") ")[2].split()[:2]
            if state != "Z":
                children.setdefault(int(parent), []).append(int(stat.parent.name))
    pids: list[int] = []
    level = [os.getpid()]
    while level:
        level = [pid for parent in level for pid in children.get(parent, [])]
        pids += level
    return pids


def end_all(program: subprocess.Popen[bytes], drain: Drain, patience_s: float) -> int:
    for number in STOP_SIGNALS:
        if program.poll() is not None:
            break
        with contextlib.suppress(ProcessLookupError):
            os.killpg(program.pid, number)
        drain.until(time.monotonic() + patience_s, program)
    left_behind = len(descendants())
    for number in STOP_SIGNALS[1:]:
        for pid in (pids := descendants()):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, number)
        deadline = time.monotonic() + patience_s
        while pids and descendants() and time.monotonic() < deadline:
            time.sleep(0.02)
    return left_behind


class Drain:
    def __init__(self, program: subprocess.Popen[bytes], log: BoundedLog) -> None:
        assert program.stdout is not None
        self._log = log
        self._output = program.stdout.fileno()
        self.stopping = False
        self.orphaned = True  # until the recorder requests the end
        self._wakeup, wakeup_in = os.pipe()
        os.set_blocking(wakeup_in, False)
        signal.set_wakeup_fd(wakeup_in)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGCHLD):
            signal.signal(number, lambda *_: None)
        self._selector = selectors.DefaultSelector()
        for source in (self._output, self._wakeup, sys.stdin.fileno()):
            self._selector.register(source, selectors.EVENT_READ)

    def until(self, deadline: float | None, program: subprocess.Popen[bytes]) -> None:
        while program.poll() is None and not (deadline is None and self.stopping):
            left_s = None if deadline is None else deadline - time.monotonic()
            if left_s is not None and left_s <= 0:
                return
            self._take(left_s)
        if program.poll() is not None:
            for _ in range(LAST_READS):
                if not self._take(0.0):
                    return

    def _take(self, timeout_s: float | None) -> bool:
        ready = {key.fd for key, _ in self._selector.select(timeout_s)}
        if sys.stdin.fileno() in ready:
            word = os.read(sys.stdin.fileno(), 64)
            self.orphaned = self.orphaned and not word
            self.stopping = True
            if not word:
                self._selector.unregister(sys.stdin.fileno())
        if self._wakeup in ready:
            self.stopping |= any(number != signal.SIGCHLD for number in os.read(self._wakeup, 64))
        if self._output not in ready:
            return False
        data = os.read(self._output, READ_BYTES)
        self._log.write(data)
        if not data:
            self._selector.unregister(self._output)
        return bool(data)


def die_with(guard_pid: int) -> None:
    """Have the kernel kill this process, the future program, with the guard."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != guard_pid:
        os.kill(os.getpid(), signal.SIGKILL)


def say(line: str) -> None:
    with contextlib.suppress(BrokenPipeError):
        print(line, flush=True)


def main() -> int:
    with contextlib.suppress(OSError):  # a recorder's -o realtime is not the bridge's
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    folder, up_pattern, patience_s, command = Path(sys.argv[1]), sys.argv[2], float(sys.argv[3]), sys.argv[4:]
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1)  # orphans of the program become our children
    log = BoundedLog(folder, up_pattern)
    try:
        program = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            preexec_fn=partial(die_with, os.getpid()),  # noqa: PLW1509 - there is one thread here
        )
    except OSError as err:
        log.write(f"{command[0]}: {err.strerror}\n".encode())
        say("0")
        return CANNOT_START
    say(str(program.pid))
    drain = Drain(program, log)
    drain.until(None, program)
    still_ran = program.poll() is None
    left_behind = end_all(program, drain, patience_s)
    code = program.wait()
    code = code if code >= 0 else 128 - code
    say(json.dumps({"asked": still_ran, "exit_code": code, "left_behind": left_behind, "log_bytes": log.total_bytes}))
    if drain.orphaned and drain.stopping:  # nobody else removes it
        shutil.rmtree(folder, ignore_errors=True)
        with contextlib.suppress(OSError):  # the other half's folder is still in it
            folder.parent.rmdir()
    return code


if __name__ == "__main__":
    sys.exit(main())
