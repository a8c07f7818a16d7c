"""What goes wrong in a round: one class a kind, with the same two doors, `begin` and `end`."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from chaos_processes import find_target

from dds_trace.recorder.sweep.station.emulation import INTERFACE, ip

if TYPE_CHECKING:
    import random

    from chaos_draw import Fault

FIND_S = 3.0
"""A fault waits so long for a process that it can strike; some live for a moment of each cell alone."""

MULTICAST = "224.0.0.0/4"


@dataclass
class World:
    """What a round can be struck at.

    Attributes:
        disk: the file system of the sweep's folder.
        slow: file that makes it slow while it is there.
        draw: source of what is left to chance.
        sweep: number of the process of `dds-sweep`.
        killed: words of the processes that were killed in the round.
    """

    disk: Path
    slow: Path
    draw: random.Random
    sweep: int = 0
    killed: list[str] = field(default_factory=list)


class Happening(Protocol):
    """A fault that happens."""

    def __init__(self, fault: Fault, world: World) -> None:
        """Prepare it."""

    def begin(self) -> bool:
        """Let it happen; return False if there is nothing that it can strike yet."""

    def end(self) -> None:
        """Undo it, if that can be; called once, also of one that has not begun."""


class _Strike:
    """Sends signals to one process."""

    first = signal.SIGKILL
    last: signal.Signals | None = None

    def __init__(self, fault: Fault, world: World) -> None:
        self._target = fault.target
        self._world = world
        self._pid = 0

    def begin(self) -> bool:
        """Send the first signal to one of the processes."""
        found = find_target(self._target, self._world.sweep)
        if not found:
            return False
        struck = self._world.draw.choice(sorted(found, key=lambda process: process.pid))
        self._pid = struck.pid
        with suppress(ProcessLookupError):
            os.kill(struck.pid, self.first)
            if self.first is signal.SIGKILL:
                self._world.killed.append(str(struck))
        return True

    def end(self) -> None:
        """Send the last signal to the same process."""
        if self._pid and self.last is not None:
            with suppress(ProcessLookupError):
                os.kill(self._pid, self.last)


class Kill(_Strike):
    """SIGKILL."""


class Stop(_Strike):
    """SIGSTOP, and SIGCONT after a while."""

    first, last = signal.SIGSTOP, signal.SIGCONT


class Interrupt(_Strike):
    """Ctrl-C for the sweep."""

    first = signal.SIGINT

    def __init__(self, fault: Fault, world: World) -> None:
        super().__init__(fault, world)
        self._target = "sweep"


class FullDisk:
    """A file that takes all room of the disk, for a while."""

    def __init__(self, fault: Fault, world: World) -> None:  # noqa: ARG002 - the kind's signature
        self._ballast = world.disk / "ballast"

    def begin(self) -> bool:
        """Fill the disk."""
        with self._ballast.open("wb", buffering=0) as file, suppress(OSError):
            while True:
                file.write(bytes(1 << 12))
        return True

    def end(self) -> None:
        """Make room again."""
        self._ballast.unlink(missing_ok=True)


class Outage:
    """The link between ping and relay is down for a while: of the sweep's namespaces, else loopback."""

    def __init__(self, fault: Fault, world: World) -> None:  # noqa: ARG002 - the kind's signature
        self._world = world
        self._down: list[tuple[str, ...]] = []

    def begin(self) -> bool:
        """Set the interface down."""
        namespaces = ip("netns", "list").split("\n")[:-1]
        names = [line.split()[0] for line in namespaces]
        where = ("-n", self._world.draw.choice(names)) if names else ()
        interface = INTERFACE if names else "lo"
        try:
            ip(*where, "link", "set", interface, "down")
        except Exception:  # noqa: BLE001 - the sweep has just removed it
            return False
        self._down.append((*where, interface))
        return True

    def end(self) -> None:
        """Set it up again, with the route that the kernel takes away with an interface."""
        for *where, interface in self._down:
            with suppress(Exception):  # the sweep has removed it
                ip(*where, "link", "set", interface, "up")
                if where:
                    ip(*where, "route", "add", MULTICAST, "dev", interface)


class SlowDisk:
    """Every write to the disk takes a while, for a while."""

    def __init__(self, fault: Fault, world: World) -> None:  # noqa: ARG002 - the kind's signature
        self._slow = world.slow

    def begin(self) -> bool:
        """Make the disk slow."""
        self._slow.touch()
        return True

    def end(self) -> None:
        """Make it quick again."""
        self._slow.unlink(missing_ok=True)


FAULTS: dict[str, type[Happening]] = {
    "kill": Kill,
    "stop": Stop,
    "interrupt": Interrupt,
    "full-disk": FullDisk,
    "outage": Outage,
    "slow-disk": SlowDisk,
}


class Timetable:
    """The faults of one call: each begins and ends when `advance` is called at or behind its moments."""

    def __init__(self, faults: tuple[Fault, ...], world: World) -> None:
        self._waiting = [(fault, FAULTS[fault.kind](fault, world)) for fault in faults]
        self._lasting: list[tuple[float, Happening]] = []
        self._began = float("inf")
        self.happened: list[Fault] = []

    def start(self) -> None:
        """Let the time of the faults begin, if it has not."""
        self._began = min(self._began, time.monotonic())

    def advance(self) -> None:
        """Begin and end what is due."""
        now = time.monotonic() - self._began
        for end_s, happening in [each for each in self._lasting if each[0] <= now]:
            happening.end()
            self._lasting.remove((end_s, happening))
        for fault, happening in [each for each in self._waiting if each[0].at_s <= now]:
            if happening.begin():
                self.happened.append(fault)
                self._lasting.append((now + fault.for_s, happening))
            elif now < fault.at_s + FIND_S:
                continue
            self._waiting.remove((fault, happening))

    def end(self) -> None:
        """End all that lasts."""
        for _, happening in self._lasting:
            happening.end()
        self._lasting.clear()


def compile_slow_disk(folder: Path) -> Path | None:
    """Return the library that makes writes slow, compiled into `folder`; None without a C compiler."""
    library = folder / "slow_disk.so"
    source = Path(__file__).with_name("slow_disk.c")
    try:
        subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True)
    except FileNotFoundError:
        return None
    return library
