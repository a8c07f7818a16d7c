"""The processes of a round, as `/proc` of its own process namespace shows them."""

from __future__ import annotations

import itertools
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

GUARD = "guard.py"


@dataclass(frozen=True, slots=True)
class Process:
    """One running process.

    Attributes:
        pid: its number in the round's namespace.
        parent: that of its parent.
        command: its words.
    """

    pid: int
    parent: int
    command: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.pid} {' '.join(self.command)[:160]}"


def running_processes() -> dict[int, Process]:
    """Return every process of the namespace but its first, which is ours, by number; none that has ended."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it ended meanwhile
            # The name in parentheses may hold anything, so the fields are counted from its end.
            state, parent = (folder / "stat").read_text(errors="replace").rpartition(") ")[2].split()[:2]
            words = (folder / "cmdline").read_text(errors="replace").rstrip("\0").split("\0")
            if state not in "ZX" and folder.name != "1":
                found[int(folder.name)] = Process(int(folder.name), int(parent), tuple(words))
    return found


def find_target(target: str, sweep: int) -> list[Process]:
    """Return the processes that a fault may strike.

    Args:
        target: one of `chaos_draw.TARGETS`.
        sweep: number of the process of `dds-sweep`.
    """
    processes = running_processes()
    if target == "sweep":
        return [process for process in processes.values() if process.pid == sweep]
    if target in ("ping", "relay"):
        return [process for process in processes.values() if _is_role(process, target)]
    if target == "bridge":
        return [process for process in processes.values() if _is_guarded(process, processes)]
    return [process for process in processes.values() if process.pid != sweep]


def _is_role(process: Process, role: str) -> bool:
    words = process.command
    return any(Path(word).name == "dds-record" for word in words[:3]) and (
        "--role",
        role,
    ) in itertools.pairwise(words)


def _is_guarded(process: Process, processes: dict[int, Process]) -> bool:
    """Return whether a process is a bridge's program, below its guard."""
    parent = processes.get(process.parent)
    return parent is not None and any(word.endswith(GUARD) for word in parent.command)
