"""Our commands as processes of their own that start warm: forked from one that has imported what they load.

A cold start spends 0.3 to 0.6 s of processor time on imports before its first line runs, and the tests start hundreds.
A warm one has its own process id, environment, arguments, streams and exit code, and ends as Python ends. What was
imported before it began is all that differs, so tests of installed scripts and of imports start cold
(`processes.RunningCommand` with `environment` or `prefix` does, too).

Run as a program, this is the process that forks: it is given one end of a socket, ends with it, and its children go on.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import importlib
import json
import os
import select
import signal
import socket
import struct
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import NoReturn

MODULES = {"dds-record": "dds_trace.cli.record"}
"""Commands that can be started."""
AHEAD = (
    *("dds_trace.cli.record.run", "dds_trace.cli.record.command", "dds_trace.recorder.backends.threaded"),
    *("dds_trace.recorder.backends.ros2.node", "sensor_msgs.msg", "std_msgs.msg", "rosidl_generator_py"),
    *("dds_trace.recorder.bridges.options", "rich.progress", "rich.console", "psutil"),
)
"""What is imported before: nothing of it opens a node, starts a thread or reads the environment of a test.

Nor rclpy itself, whose library ends with a segmentation fault in a process that was forked behind its import.
"""
BRIEF_COST_S, BRIEF_FLOOR_MESSAGES = 0.02, 5
"""Each session measures the cost of recording and the floor of its middleware for a second; here they are as good shorter."""
_REQUEST_BYTES = 1 << 16


class WarmProcess:
    """A started command, as `subprocess.Popen` shows one; `stdout` and `stderr` are read by the caller."""

    def __init__(self, program: str, arguments: list[str]) -> None:
        self.returncode: int | None = None
        ends = [os.pipe() for _ in range(3)]
        request = {
            "argv": [str(Path(sys.executable).with_name(program)), *arguments],
            "module": MODULES[program],
            "environment": dict(os.environ),
            "folder": str(Path.cwd()),
        }
        data = json.dumps(request).encode()
        assert len(data) < _REQUEST_BYTES
        socket.send_fds(_template(), [data], [write for _, write in ends])
        for _, write in ends:
            os.close(write)
        self.stdout, self.stderr = (os.fdopen(read, encoding="utf-8") for read, _ in ends[:2])
        self._status = ends[2][0]
        (self.pid,) = struct.unpack("i", os.read(self._status, 4))

    def poll(self) -> int | None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.wait(0)
        return self.returncode

    def wait(self, timeout_s: float) -> int:
        if self.returncode is None:
            if not select.select([self._status], [], [], timeout_s)[0]:
                raise subprocess.TimeoutExpired("dds-record", timeout_s)
            (status,) = struct.unpack("i", os.read(self._status, 4))
            os.close(self._status)
            self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


@cache
def _template() -> socket.socket:
    """The socket to this process's template, which is started at its first use and ends with us."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    process = subprocess.Popen(
        [sys.executable, __file__, str(theirs.fileno())],
        pass_fds=[theirs.fileno()],
        cwd="/",
        stdout=subprocess.PIPE,  # Python's streams are made for what they find, and the commands' are pipes
        stderr=subprocess.PIPE,
    )
    theirs.close()
    atexit.register(lambda: (ours.close(), process.wait()))
    return ours


def _serve(requests: socket.socket) -> dict[str, object]:
    """Fork a child for each request and tell how it ended; in a child, return what it is to run."""
    woken, wake = os.pipe()
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(wake)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    running: dict[int, int] = {}
    while True:
        ready = select.select([requests, woken], [], [])[0]
        if woken in ready:
            os.read(woken, 512)
            _tell_ends(running)
        if requests not in ready:
            continue
        data, descriptors, _, _ = socket.recv_fds(requests, _REQUEST_BYTES, 3)
        if not data:
            os._exit(0)
        pid = os.fork()
        if pid:
            running[pid] = descriptors[2]
            os.write(descriptors[2], struct.pack("i", pid))
            for each in descriptors[:2]:
                os.close(each)
            continue
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        requests.close()
        for each in (woken, wake, *running.values()):
            os.close(each)
        for number, each in enumerate(descriptors[:2], 1):
            os.dup2(each, number)
        for each in descriptors:
            os.close(each)
        return json.loads(data)


def _tell_ends(running: dict[int, int]) -> None:
    with contextlib.suppress(ChildProcessError):
        while (ended := os.waitpid(-1, os.WNOHANG))[0]:
            pid, status = ended
            descriptor = running.pop(pid)
            with contextlib.suppress(BrokenPipeError):
                os.write(descriptor, struct.pack("i", status))
            os.close(descriptor)


def _run(request: dict[str, object]) -> NoReturn:
    os.environ.clear()
    os.environ.update(request["environment"])
    os.chdir(request["folder"])
    sys.argv = request["argv"]
    sys.exit(importlib.import_module(request["module"]).main())


def main() -> NoReturn:
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    del sys.path[0]  # the folder of this file, which no command sees
    for name in AHEAD:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    floor = importlib.import_module("dds_trace.recorder.roles.floor")
    floor.BRIEF_S, floor.BRIEF_FLOOR_MESSAGES = BRIEF_COST_S, BRIEF_FLOOR_MESSAGES
    gc.freeze()  # so that no child's collector visits, and by that copies, what all have in common
    _run(_serve(socket.socket(fileno=int(sys.argv[1]))))


if __name__ == "__main__":
    main()
