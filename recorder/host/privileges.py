"""Privileges for quieter numbers: fixed CPUs, a real-time priority, locked memory.

A refusal is an error that says how to be permitted: numbers recorded under other conditions than those asked for
would be wrong without a sign of it.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base import limits
from dds_trace.base.errors import OptionError

if TYPE_CHECKING:
    from dds_trace.tracefile.format.json_fields import Json

_MCL_CURRENT, _MCL_FUTURE = 1, 2  # <sys/mman.h>, equal on x86_64 and aarch64

_HOW_TO_BE_PERMITTED = (
    "run as root, or add 'USER - rtprio 99' and 'USER - memlock unlimited' to "
    "/etc/security/limits.conf and log in again, or leave --realtime out"
)


def apply_privileges(
    cpu_affinity: str | None = None, realtime_priority: int | None = None
) -> dict[str, Json]:
    """Give this process its CPUs and its real-time priority; threads started later inherit both.

    Those that write the trace and sample the host give the priority back (`tracefile.run_in_background`).

    Call it before the middleware starts its threads.

    Args:
        cpu_affinity: CPUs as `--cpu-affinity` names them: `3`, `0,2`, `2-3`.
        realtime_priority: 1 (lowest) to 99 for SCHED_FIFO; all memory is locked as well.

    Returns:
        The privileges in effect, for the session's extra fields: `cpu_affinity` (list of CPU numbers),
        `realtime_priority`, `memory_locked`; only what was asked for.

    Raises:
        OptionError: a value that cannot be meant on this machine, or the system does not permit it.
    """
    applied: dict[str, Json] = {}
    if cpu_affinity is not None:
        applied["cpu_affinity"] = pin_cpus(cpu_affinity)
    if realtime_priority is not None:
        lock_memory()
        set_realtime(realtime_priority)
        applied |= {"realtime_priority": realtime_priority, "memory_locked": True}
    return applied


def parse_cpus(text: str) -> list[int]:
    """Return the CPU numbers in `0,2-3`, sorted.

    Raises:
        OptionError: not a list of numbers and ranges.
    """
    limits.check(limits.CPUS, text, "--cpu-affinity")
    cpus: set[int] = set()
    for part in text.split(","):
        first, _, last = part.partition("-")
        cpus.update(range(int(first), int(last or first) + 1))
    if not cpus:
        raise OptionError(f"--cpu-affinity {text!r}: a range goes from the lower CPU number to the higher")
    return sorted(cpus)


def pin_cpus(text: str) -> list[int]:
    """Let every thread of this process run on these CPUs only, and return their numbers.

    Raises:
        OptionError: no such list, or a CPU that this process may not use.
    """
    wanted = parse_cpus(text)
    allowed = os.sched_getaffinity(0)
    missing = [cpu for cpu in wanted if cpu not in allowed]
    if missing:
        raise OptionError(
            f"--cpu-affinity {text}: CPU {missing[0]} is not among those this process may use "
            f"({', '.join(map(str, sorted(allowed)))})",
        )
    # Libraries that are loaded already have started threads of their own; the call alone moves one thread.
    for thread in Path("/proc/self/task").iterdir():
        with contextlib.suppress(ProcessLookupError):
            os.sched_setaffinity(int(thread.name), wanted)
    return wanted


def set_realtime(priority: int) -> None:
    """Run the calling thread, and those it starts, under SCHED_FIFO.

    Raises:
        OptionError: no such priority, or the system does not permit it.
    """
    limits.check(limits.REALTIME_PRIORITY, priority, "--realtime")
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as err:
        raise OptionError(
            f"--realtime {priority}: SCHED_FIFO is not permitted ({err.strerror}): {_HOW_TO_BE_PERMITTED}",
        ) from err


def lock_memory() -> None:
    """Keep every page of this process in memory, now and later, so that no page fault delays a stamp.

    Raises:
        OptionError: the system does not permit it.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) != 0:
        reason = os.strerror(ctypes.get_errno())
        raise OptionError(f"--realtime: locking memory is not permitted ({reason}): {_HOW_TO_BE_PERMITTED}")
