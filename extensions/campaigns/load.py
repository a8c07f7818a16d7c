"""A load of this machine while a recording runs."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from subprocess import DEVNULL, PIPE

import psutil

from dds_trace.base.errors import OptionError
from dds_trace.recorder.host.child import Child
from dds_trace.recorder.host.process import pin_cpus
from dds_trace.tracefile.format.json_fields import JsonObject

DMA_LATENCY = "/dev/cpu_dma_latency"
PROGRAM = Path(__file__).with_name("load_program.py")


STEALER_PRIORITY = 60
PATIENCE_S = 10.0


class MachineLoad:
    """A load; called, it returns the session's field `load`."""

    def __init__(self, kind: str, process: Child) -> None:
        self._kind = kind
        self._process = process
        self._began_s, self._printed = time.monotonic(), b""

    def begin(self) -> None:
        """Start a load that waits for the first echo: a node under it takes long to start."""
        if self._process.stdin is not None and not self._process.stdin.closed:
            self._began_s = time.monotonic()
            self._process.stdin.close()

    def __call__(self) -> JsonObject:
        process = self._process
        assert process.stdout is not None
        self._printed += process.stdout.read() or b""
        program, _, started_s = self._printed.decode().strip().rpartition(" ")
        now_s, cpu_s = time.monotonic(), _cpu_seconds(process.pid) if program else 0.0
        described: JsonObject = {"kind": self._kind, "program": program, "elapsed_s": now_s - self._began_s}
        waited_s = float(started_s or now_s) - self._began_s
        return {"load": {**described, "waited_s": waited_s, "cpu_s": cpu_s, "is_running": process.poll() is None}}


@contextmanager
def loaded(kind: str, host: str | None = None, *, is_relay: bool = False) -> Iterator[MachineLoad | None]:
    """Load the machine within the block (`load_program.py`), if this side does; an `OptionError` where this user or machine cannot."""
    if kind == "network" and host is None:
        yield None
        return
    if kind == "emulated-pi3":
        *others, host = map(str, sorted(os.sched_getaffinity(0)))
        _check_stealing(others)
        pin_cpus(host if is_relay else ",".join(others))
        if not is_relay:
            yield None
            return
    if kind == "dma-latency":
        try:
            os.close(os.open(DMA_LATENCY, os.O_RDWR))
        except OSError as err:
            raise OptionError(f"-o load={kind}: {DMA_LATENCY}: {err.strerror}; run as root, or leave it out") from err
    # -I -S starts fastest: only the standard library.
    command = [sys.executable, "-I", "-S", PROGRAM, kind, host or ""]
    with Child(command, stdin=PIPE if kind == "emulated-pi3" else DEVNULL, stdout=PIPE) as process:
        assert process.stdout is not None
        os.set_blocking(process.stdout.fileno(), False)
        try:
            yield MachineLoad(kind, process)
        finally:
            process.end(PATIENCE_S)


def _check_stealing(others: Sequence[str]) -> None:
    if not others:
        raise OptionError("-o load=emulated-pi3 needs two processors, one of them only for the relay")
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(STEALER_PRIORITY))
    except OSError as err:
        raise OptionError(f"-o load=emulated-pi3: SCHED_FIFO is not permitted ({err.strerror}); run as root") from err
    os.sched_setscheduler(0, policy, parameters)


def _cpu_seconds(pid: int) -> float:
    total_s = 0.0
    with suppress(psutil.Error):
        program = psutil.Process(pid)
        for process in (program, *program.children(recursive=True)):
            times = process.cpu_times()
            total_s += times.user + times.system
    return total_s
