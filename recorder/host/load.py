"""A load of this machine while a recording runs."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import psutil

from dds_trace.base.errors import OptionError

from .process import ending_with_parent

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from dds_trace.tracefile.format.json_fields import JsonObject

DMA_LATENCY = "/dev/cpu_dma_latency"
PROGRAM = Path(__file__).with_name("load_program.py")


@contextmanager
def loaded(kind: str, host: str | None = None) -> Iterator[Callable[[], JsonObject]]:
    """Load the machine within the block; yields a function that returns the session's field `load`, if there is a load.

    `network` sends to `host`.

    Raises:
        OptionError: this user may not keep the processors from sleeping.
    """
    if kind == "none" or (kind == "network" and host is None):
        yield dict
        return
    if kind == "dma-latency":
        try:
            os.close(os.open(DMA_LATENCY, os.O_RDWR))
        except OSError as err:
            raise OptionError(f"--load {kind}: {DMA_LATENCY}: {err.strerror}; run as root, or leave it out") from err
    # -I -S starts fastest: only the standard library.
    command = [*ending_with_parent(), sys.executable, "-I", "-S", str(PROGRAM), kind, host or ""]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL) as process:
        assert process.stdout is not None
        os.set_blocking(process.stdout.fileno(), False)
        began_s, said = time.monotonic(), b""

        def describe() -> JsonObject:
            nonlocal said
            said += process.stdout.read() or b""  # type: ignore[union-attr]
            program, _, started_s = said.decode().strip().rpartition(" ")
            now_s, cpu_s = time.monotonic(), _cpu_seconds(process.pid) if program else 0.0
            described: JsonObject = {"kind": kind, "program": program, "elapsed_s": now_s - began_s}
            waited_s = float(started_s or now_s) - began_s
            return {"load": {**described, "waited_s": waited_s, "cpu_s": cpu_s, "is_running": process.poll() is None}}

        try:
            yield describe
        finally:
            process.terminate()


def _cpu_seconds(pid: int) -> float:
    total_s = 0.0
    try:
        program = psutil.Process(pid)
        for process in (program, *program.children(recursive=True)):
            times = process.cpu_times()
            total_s += times.user + times.system
    except psutil.Error:
        return total_s
    return total_s
