"""What keeps this device's clock, in words: chrony, else timedatectl, else the kernel."""

from __future__ import annotations

import shutil
import subprocess

from ..host.clock import read_adjtimex

TIMEOUT_S = 2.0
_NAME, _OFFSET_S, _LEAP = 1, 4, 13
"""Columns of `chronyc -c tracking`."""
_NOT_SYNCHRONIZED = 0x40


def time_service() -> str:
    """Return the state of this device's time service."""
    return _chrony() or _timedatectl() or _kernel()


def _output(*command: str) -> str:
    program = shutil.which(command[0])
    if program is None:
        return ""
    try:
        done = subprocess.run(
            [program, *command[1:]], capture_output=True, text=True, timeout=TIMEOUT_S, check=False, errors="replace"
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout if done.returncode == 0 else ""


def _chrony() -> str:
    return chrony_words(_output("chronyc", "-c", "tracking"))


def chrony_words(tracking: str) -> str:
    """Return words for the output of `chronyc -c tracking`; empty if it is something else."""
    columns = tracking.strip().split(",")
    if len(columns) <= _LEAP:
        return ""
    if columns[_LEAP] == "Not synchronised":
        return "chrony: not synchronized"
    try:
        return (
            f"chrony: follows {columns[_NAME]}, off by {1e3 * abs(float(columns[_OFFSET_S])):.3f} ms by its own account"
        )
    except ValueError:
        return ""


def _timedatectl() -> str:
    value = _output("timedatectl", "show", "--property=NTPSynchronized", "--value").strip()
    return {"yes": "timedatectl: synchronized", "no": "timedatectl: not synchronized"}.get(value, "")


def _kernel() -> str:
    correction = read_adjtimex()
    if correction is None:
        return "kernel: state of the clock unknown"
    is_synchronized = not int(str(correction["status"])) & _NOT_SYNCHRONIZED
    return f"kernel: {'synchronized' if is_synchronized else 'not synchronized'}"
