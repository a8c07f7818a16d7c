"""Our commands as processes of their own that start warm: forked from one that has imported what they load.

A cold start spends 0.3 to 1 s of processor time on imports before its first line runs, and the tests start hundreds.
A warm one has its own process id, environment, arguments, streams and exit code, and ends as Python ends. What was
imported before it began is all that differs, so tests of installed scripts and of imports start cold
(`processes.RunningCommand` with `environment` or `prefix` does, too).

Where programs are started by their path, as shell scripts and sweeps do, `stand_ins` stand for the commands. What
a process has of its parents but for streams, folder and environment, such as a network namespace, the command has not.

Run as a program, this is the process that forks: it is given one end of a socket and the place of another, ends with
the first, and its children go on.
"""

import atexit
import contextlib
import gc
import importlib
import json
import os
import select
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import NoReturn

MODULES = {
    "dds-record": "dds_trace.cli.dds_record",
    "dds-trace": "dds_trace.cli.trace",
    "dds-analyze": "dds_trace.cli.dds_analyze",
}
"""Commands that can be started."""
KINDS = {name: "recording" if name == "dds-record" else "reading" for name in MODULES}
"""Command -> kind of the process that it is forked from."""
RECORDING = (
    *("dds_trace.cli.record.run", "dds_trace.cli.record.command", "dds_trace.recorder.backends.node"),
    *("dds_trace.recorder.backends.ros2.node", "sensor_msgs.msg", "std_msgs.msg", "rosidl_generator_py"),
    *("dds_trace.recorder.backends.socket", "dds_trace.recorder.recording"),
    *("dds_trace.extensions.bridges.base", "dds_trace.tracefile.mcapfile.scan"),
    *("rich.progress", "rich.console", "psutil"),
)
"""What is imported before `dds-record`: nothing of it opens a node, starts a thread or reads the environment of a test.

Nor rclpy itself, whose library ends with a segmentation fault in a process that was forked behind its import.
"""
READING = (
    *("dds_trace.extensions.campaigns.commands.sweep", "dds_trace.extensions.campaigns.commands.against"),
    *(
        "dds_trace.extensions.campaigns.sweep",
        "dds_trace.extensions.campaigns.rehearsal",
        "dds_trace.extensions.bags.command",
    ),
    *("dds_trace.analyzer.analysis", "dds_trace.analyzer.saving.folder", "dds_trace.extensions.gates.report"),
    *("dds_trace.extensions.gates.gates", "dds_trace.reports.html.page", "dds_trace.cli.dds_analyze"),
    *("dds_trace.analyzer.pipeline", "dds_trace.analyzer.engines", "dds_trace.analyzer.findings"),
    *("dds_trace.extensions.campaigns.plan.plan_file", "dds_trace.extensions.campaigns.run.progress"),
    *("rich.progress", "rich._emoji_codes", "pyarrow.compute", "numpy.ma"),
)
"""What is imported before the other commands, under the same rules; polars starts its threads with its first query."""
BRIEF_COST_S, BRIEF_FLOOR_MESSAGES = 0.02, 5
"""Each session measures the cost of recording and the floor of its middleware for a second; here they are as good shorter."""
_REQUEST_BYTES = 1 << 16

_STAND_IN = """#!{python} -IS
import json, os, signal, socket, sys
ENDS = (signal.SIGINT, signal.SIGTERM)
signal.pthread_sigmask(signal.SIG_BLOCK, ENDS)
server = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
server.connect({place!r})
words = dict(program={program!r}, arguments=sys.argv[1:], environment=dict(os.environ), folder=os.getcwd())
socket.send_fds(server, [json.dumps(words).encode()], [1, 2])
pid = int.from_bytes(server.recv(4), sys.byteorder)
for number in ENDS:
    signal.signal(number, lambda number, _: os.kill(pid, number))
signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDS)
code = os.waitstatus_to_exitcode(int.from_bytes(server.recv(4), sys.byteorder))
if code < 0:
    signal.signal(-code, signal.SIG_DFL)
    os.kill(os.getpid(), -code)
os._exit(code)
"""


class WarmProcess:
    """A started command, as `subprocess.Popen` shows one; `stdout` and `stderr` are read by the caller."""

    def __init__(self, program: str, arguments: list[str]) -> None:
        self.returncode: int | None = None
        request = {
            "program": program,
            "arguments": arguments,
            "environment": dict(os.environ),
            "folder": str(Path.cwd()),
        }
        data = json.dumps(request).encode()
        assert len(data) < _REQUEST_BYTES
        self._server = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._server.connect(str(_started("recording" if arguments[:1] == ["record"] else KINDS[program])))
        ends = [os.pipe() for _ in range(2)]
        socket.send_fds(self._server, [data], [write for _, write in ends])
        for _, write in ends:
            os.close(write)
        self.stdout, self.stderr = (os.fdopen(read, encoding="utf-8") for read, _ in ends)
        (self.pid,) = struct.unpack("i", self._server.recv(4))

    def poll(self) -> int | None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.wait(0)
        return self.returncode

    def wait(self, timeout_s: float) -> int:
        if self.returncode is None:
            if not select.select([self._server], [], [], timeout_s)[0]:
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout_s)
            (status,) = struct.unpack("i", self._server.recv(4))
            self._server.close()
            self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


def stand_ins() -> Path:
    """The folder of this process's stand-ins, for the front of a PATH."""
    _started("reading")
    return _folder() / "bin"


@cache
def _folder() -> Path:
    """A folder with a short name: the place of a socket has a hundred characters at most."""
    folder = Path(tempfile.mkdtemp(prefix="warm-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@cache
def _started(kind: str) -> Path:
    """A template, which is started at its first use and ends with us."""
    place = _folder() / kind
    if kind == "reading":
        _started("recording")
        _write_stand_ins(_folder() / "bin")
    ours, theirs = socket.socketpair()
    listening = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listening.bind(str(place))
    listening.listen(64)
    process = subprocess.Popen(
        [sys.executable, __file__, kind, str(theirs.fileno()), str(listening.fileno())],
        pass_fds=[theirs.fileno(), listening.fileno()],
        cwd="/",
        stdout=subprocess.PIPE,  # Python's streams are made for what they find, and the commands' are pipes
        stderr=subprocess.PIPE,
    )
    theirs.close()
    listening.close()
    atexit.register(lambda: (ours.close(), process.wait()))
    return place


def _write_stand_ins(folder: Path) -> None:
    folder.mkdir()
    for program, kind in KINDS.items():
        path = folder / program
        place = str(folder.with_name(kind))
        path.write_text(_STAND_IN.format(python=sys.executable, place=place, program=program))
        path.chmod(0o755)


def _serve(starter: socket.socket, listening: socket.socket) -> dict[str, object]:
    """Fork a child for each request and tell how it ended; in a child, return what it is to run."""
    woken, wake = os.pipe()
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(wake)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    running: dict[int, socket.socket] = {}
    while True:
        ready = select.select([starter, listening, woken, *running.values()], [], [])[0]
        if starter in ready:
            os._exit(0)
        if woken in ready:
            os.read(woken, 512)
            _tell_ends(running)
        for pid, asker in running.items():
            if asker in ready:  # it says nothing more: it is gone
                os.kill(pid, signal.SIGKILL)
        if listening in ready and (request := _fork(listening, running)):
            signal.set_wakeup_fd(-1)
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            for each in (starter, listening, *running.values()):
                each.close()
            for each in (woken, wake):
                os.close(each)
            return request


def _fork(listening: socket.socket, running: dict[int, socket.socket]) -> dict[str, object] | None:
    """Fork a child for the next request: None in the parent, in the child the request, whose streams it has."""
    asker, _ = listening.accept()
    data, descriptors, _, _ = socket.recv_fds(asker, _REQUEST_BYTES, 2)
    if not data:  # killed before it could ask
        return None
    pid = os.fork()
    if pid:
        running[pid] = asker
        with contextlib.suppress(BrokenPipeError):
            asker.send(struct.pack("i", pid))
    else:
        asker.close()
        for number, each in enumerate(descriptors, 1):
            os.dup2(each, number)
    for each in descriptors:
        os.close(each)
    return None if pid else json.loads(data)


def _tell_ends(running: dict[int, socket.socket]) -> None:
    with contextlib.suppress(ChildProcessError):
        while (ended := os.waitpid(-1, os.WNOHANG))[0]:
            pid, status = ended
            with running.pop(pid) as asker, contextlib.suppress(BrokenPipeError, ConnectionResetError):
                asker.send(struct.pack("i", status))


def _run(request: dict[str, object]) -> NoReturn:
    os.environ.clear()
    os.environ.update(request["environment"])
    os.chdir(request["folder"])
    program = request["program"]
    sys.argv = [str(Path(sys.executable).with_name(program)), *request["arguments"]]
    sys.exit(importlib.import_module(MODULES[program]).main())


def _import_ahead(kind: str, bin_folder: Path) -> None:
    for name in RECORDING if kind == "recording" else READING:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    if kind == "recording":
        floor = importlib.import_module("dds_trace.recorder.roles.floor")
        floor.BRIEF_S, floor.BRIEF_FLOOR_MESSAGES = BRIEF_COST_S, BRIEF_FLOOR_MESSAGES
    else:  # a warm sweep starts warm recorders
        station = importlib.import_module("dds_trace.extensions.campaigns.station.station")
        station.local_program = lambda name: [str(bin_folder / name)]
    gc.freeze()  # so that no child's collector visits, and by that copies, what all have in common


def main() -> NoReturn:
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    del sys.path[0]  # the folder of this file, which no command sees
    kind, *sockets = sys.argv[1:]
    starter, listening = (socket.socket(fileno=int(each)) for each in sockets)
    _import_ahead(kind, Path(listening.getsockname()).with_name("bin"))
    _run(_serve(starter, listening))


if __name__ == "__main__":
    main()
