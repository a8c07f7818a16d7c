"""How this process runs: CPUs, priority, garbage collection, signals.

A refused privilege is an error: numbers of other conditions than requested would look right.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import resource
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import SimpleQueue

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.tracefile.format.json_fields import Json

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

SPIN_S = 3.0
"""Longest time that a thread under SCHED_FIFO computes without a pause, and keeps all others from its processor."""
_SIGEV_THREAD = 2  # <bits/sigevent-consts.h>

SWITCH_INTERVAL_S = 0.0005
"""Longest time that a computing thread delays one that received a message (by default 5 ms)."""

_MCL_CURRENT, _MCL_FUTURE = 1, 2  # <sys/mman.h>, equal on x86_64 and aarch64

HOW_TO_BE_PERMITTED = (
    "run as root (of a container: --cap-add SYS_NICE --ulimit rtprio=99 --ulimit memlock=-1), or add 'USER - rtprio 99' and "
    "'USER - memlock unlimited' to /etc/security/limits.conf and log in again, or leave -o realtime out"
)


def apply_privileges(cpu_affinity: str | None = None, realtime_priority: int | None = None) -> dict[str, Json]:
    """Give this process its CPUs and real-time priority (SCHED_FIFO, all memory locked), and return the session's fields.

    Later threads inherit both; those that write the trace or sample the host give the priority back (`run_in_background`). An `OptionError` names
    what this machine lacks or does not permit.
    """
    applied: dict[str, Json] = {}
    if cpu_affinity is not None:
        applied["cpu_affinity"] = pin_cpus(cpu_affinity)
    if realtime_priority is not None:
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) != 0:  # a page fault would delay a stamp
            reason = os.strerror(ctypes.get_errno())
            raise OptionError(f"-o realtime: locking memory is not permitted ({reason}): {HOW_TO_BE_PERMITTED}")
        set_realtime(realtime_priority)
        applied |= {"realtime_priority": realtime_priority, "memory_locked": True}
    return applied


def parse_cpus(text: str) -> list[int]:
    limits.check(limits.CPUS, text, "-o cpu_affinity")
    cpus: set[int] = set()
    for part in text.split(","):
        first, _, last = part.partition("-")
        cpus.update(range(int(first), int(last or first) + 1))
    if not cpus:
        raise OptionError(f"-o cpu_affinity={text!r}: a range goes from the lower CPU number to the higher")
    return sorted(cpus)


def pin_cpus(text: str) -> list[int]:
    cpus = parse_cpus(text)
    allowed = os.sched_getaffinity(0)
    missing = [cpu for cpu in cpus if cpu not in allowed]
    if missing:
        raise OptionError(
            f"-o cpu_affinity={text}: CPU {missing[0]} is not among those this process may use "
            f"({', '.join(map(str, sorted(allowed)))})"
        )
    # Loaded libraries may have started threads, and the call moves one.
    for thread in _threads():
        with contextlib.suppress(ProcessLookupError):
            os.sched_setaffinity(thread, cpus)
    return cpus


def set_realtime(priority: int) -> None:
    """Run this thread and its later children under SCHED_FIFO; one that spins for `SPIN_S` gets SIGXCPU, then SIGKILL."""
    limits.check(limits.REALTIME_PRIORITY, priority, "-o realtime")
    most_us = round(SPIN_S * 1e6)
    before = resource.getrlimit(resource.RLIMIT_RTTIME)
    if before[1] == resource.RLIM_INFINITY or before[1] > 2 * most_us:
        resource.setrlimit(resource.RLIMIT_RTTIME, (most_us, 2 * most_us))
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as err:
        raise OptionError(
            f"-o realtime={priority}: SCHED_FIFO is not permitted ({err.strerror}): {HOW_TO_BE_PERMITTED}"
        ) from err


def start_thread_use() -> Callable[[], dict[str, Json]]:
    """Return a function of this thread's use since: on a processor, waiting for one (0 without schedstat), in all."""
    start = _thread_times_ns()
    return lambda: {name: end - start[name] for name, end in _thread_times_ns().items()}


def _thread_times_ns() -> dict[str, int]:
    try:
        waited_ns = int(Path("/proc/thread-self/schedstat").read_text().split()[1])
    except (OSError, IndexError):
        waited_ns = 0
    return {"cpu_ns": time.thread_time_ns(), "waited_ns": waited_ns, "elapsed_ns": time.monotonic_ns()}


def may_be_realtime() -> bool:
    """Return whether a process of its own gets it: root in a container may not."""
    trial = f"from {__name__} import apply_privileges; apply_privileges(realtime_priority=1)"
    return subprocess.run([sys.executable, "-c", trial], capture_output=True, check=False).returncode == 0


def _threads() -> list[int]:
    return [int(thread.name) for thread in Path("/proc/self/task").iterdir()]


def realtime_threads() -> dict[str, Json]:
    count = 0
    for thread in _threads():
        with contextlib.suppress(ProcessLookupError):
            count += os.sched_getscheduler(thread) == os.SCHED_FIFO
    return {"realtime_threads": count} if count else {}


@contextlib.contextmanager
def tuned_gc() -> Iterator[None]:
    """Switch garbage collection off within the block (call `gc.collect` in a quiet moment), and threads more often."""
    was_enabled, interval_s = gc.isenabled(), sys.getswitchinterval()
    gc.collect()
    gc.freeze()  # a later collection skips older objects, and so is quick
    gc.disable()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    try:
        yield
    finally:
        sys.setswitchinterval(interval_s)
        gc.unfreeze()
        if was_enabled:
            gc.enable()


class StopEvent(threading.Event):
    """An event that signals set; a third one ends the process after `last_act`, and SIGXCPU is of a thread that spun."""

    is_repeated = is_spinning = False
    last_act: Callable[[], object] = staticmethod(lambda: None)


def stop_at_signals() -> StopEvent:
    """Return an event that SIGINT, SIGTERM and SIGHUP (not under `nohup`) set from now on; a third one ends the process.

    A handler may run while the main thread has the event's lock in `wait()`, where `set()` would deadlock.
    `SimpleQueue.put` is reentrant, so a thread that reads a queue sets the event.
    """
    stop = StopEvent()
    received: SimpleQueue[int] = SimpleQueue()

    def next_signal() -> int:
        while (number := received.get()) == signal.SIGXCPU:
            stop.is_spinning = True
            for thread in _threads():
                with contextlib.suppress(OSError):
                    os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
            stop.set()
        return number

    def set_at_first() -> None:
        next_signal()
        stop.set()
        next_signal()
        stop.is_repeated = True
        number = next_signal()
        stop.last_act()
        os._exit(128 + number)

    threading.Thread(target=set_at_first, name="stop-signals", daemon=True).start()
    for number in (*unignored_stop_signals(), signal.SIGXCPU):
        signal.signal(number, lambda number, _: received.put(number))
    return stop


def unignored_stop_signals() -> list[signal.Signals]:
    """Return `STOP_SIGNALS`, without SIGHUP under `nohup`; a shell's background job ignores SIGINT, too."""
    is_nohup = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return [number for number in STOP_SIGNALS if number != signal.SIGHUP or not is_nohup]


def exit_after(seconds: float, exit_code: int) -> Callable[[], object]:
    """End the process with `exit_code` after this time, whoever has the GIL; return what calls that off."""
    libc = library = ctypes.CDLL(None)
    if not hasattr(library, "timer_create"):  # glibc before 2.34
        library = ctypes.CDLL("librt.so.1")
    end = ctypes.cast(libc._exit, ctypes.c_void_p)  # noqa: SLF001 - _exit(2)
    # `struct sigevent` of sigevent(7)
    event = struct.pack("PiiP40x", exit_code, 0, _SIGEV_THREAD, end.value)
    timer, after = ctypes.c_void_p(), (ctypes.c_long * 4)(0, 0, int(seconds), round(seconds % 1 * 1e9))
    if library.timer_create(time.CLOCK_MONOTONIC, event, ctypes.byref(timer)) != 0:
        return lambda: None
    library.timer_settime(timer, 0, after, None)
    return lambda: library.timer_delete(timer)
