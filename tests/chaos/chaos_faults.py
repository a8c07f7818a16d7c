"""What goes wrong in a round, one class a kind, and the processes that it may strike."""

import itertools
import os
import random
import signal
import subprocess
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from chaos_draw import Fault

from dds_trace.extensions.campaigns.station.emulation import INTERFACE, ip

FIND_S = 3.0
"""Longest wait of a fault for its process: some live only for a moment of each cell."""

MULTICAST = "224.0.0.0/4"
GUARD = "guard.py"


@dataclass
class World:
    """What a round can be struck at.

    Attributes:
        disk: the file system of the sweep's folder.
        slow: file whose existence makes it slow.
        draw: source of what is left to chance.
        sweep: process id of `dds-trace sweep`.
        killed: command lines of the processes that were killed in the round.
    """

    disk: Path
    slow: Path
    draw: random.Random
    sweep: int = 0
    killed: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Process:
    pid: int
    parent: int
    command: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.pid} {' '.join(self.command)[:160]}"


def running_processes() -> dict[int, Process]:
    processes = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it ended meanwhile
            # The name in parentheses may contain anything, so the fields are counted from its end.
            state, parent = (folder / "stat").read_text(errors="replace").rpartition(") ")[2].split()[:2]
            words = (folder / "cmdline").read_text(errors="replace").rstrip("\0").split("\0")
            if state not in "ZX" and folder.name != "1":
                processes[int(folder.name)] = Process(int(folder.name), int(parent), tuple(words))
    return processes


def find_target(target: str, sweep: int) -> list[Process]:
    """Return the processes that a fault with this target (`chaos_draw.TARGETS`) may strike."""
    processes = running_processes()

    def is_target(process: Process) -> bool:
        words = process.command
        if target == "sweep":
            return process.pid == sweep
        if target in ("ping", "relay"):
            is_recorder = any(Path(word).name == "dds-record" for word in words[:3])
            return is_recorder and ("--role", target) in itertools.pairwise(words)
        if target == "bridge":
            parent = processes.get(process.parent)
            return parent is not None and any(word.endswith(GUARD) for word in parent.command)
        return process.pid != sweep

    return [process for process in processes.values() if is_target(process)]


class Happening:
    def __init__(self, fault: Fault, world: World) -> None:
        self.target = fault.target
        self.world = world

    def begin(self) -> bool:
        """Let it happen; return False if there is nothing that it can strike yet."""
        raise NotImplementedError

    def end(self) -> None:
        """Undo it, if that can be; called once, also if it has not begun."""


class Kill(Happening):
    first = signal.SIGKILL
    struck: Process | None = None

    def begin(self) -> bool:
        targets = find_target(self.target, self.world.sweep)
        if not targets:
            return False
        self.struck = self.world.draw.choice(sorted(targets, key=lambda process: process.pid))
        self._send(self.first)
        if self.first is signal.SIGKILL:
            self.world.killed.append(str(self.struck))
        return True

    def _send(self, number: signal.Signals) -> None:
        if self.struck is not None:
            with suppress(ProcessLookupError):
                os.kill(self.struck.pid, number)


class Stop(Kill):
    first = signal.SIGSTOP

    def end(self) -> None:
        self._send(signal.SIGCONT)


class Interrupt(Kill):
    first = signal.SIGINT

    def __init__(self, fault: Fault, world: World) -> None:
        super().__init__(fault, world)
        self.target = "sweep"


class FullDisk(Happening):
    def begin(self) -> bool:
        with (self.world.disk / "ballast").open("wb", buffering=0) as file, suppress(OSError):
            while True:
                file.write(bytes(1 << 12))
        return True

    def end(self) -> None:
        (self.world.disk / "ballast").unlink(missing_ok=True)


class Outage(Happening):
    """The link between ping and relay is down for a while: of the sweep's namespaces, else loopback."""

    down: tuple[str, ...] = ()

    def begin(self) -> bool:
        names = [line.split()[0] for line in ip("netns", "list").splitlines()]
        where = ("-n", self.world.draw.choice(names)) if names else ()
        interface = INTERFACE if names else "lo"
        try:
            ip(*where, "link", "set", interface, "down")
        except Exception:  # noqa: BLE001 - the sweep has just removed it
            return False
        self.down = (*where, interface)
        return True

    def end(self) -> None:
        if self.down:
            *where, interface = self.down
            with suppress(Exception):  # the sweep has removed it
                ip(*where, "link", "set", interface, "up")
                if where:  # the kernel removed the route with the interface
                    ip(*where, "route", "add", MULTICAST, "dev", interface)


class SlowDisk(Happening):
    def begin(self) -> bool:
        self.world.slow.touch()
        return True

    def end(self) -> None:
        self.world.slow.unlink(missing_ok=True)


FAULTS: dict[str, type[Happening]] = {
    "kill": Kill,
    "stop": Stop,
    "interrupt": Interrupt,
    "full-disk": FullDisk,
    "outage": Outage,
    "slow-disk": SlowDisk,
}


class Timetable:
    """The faults of one call; `advance` begins and ends those that are due."""

    def __init__(self, faults: tuple[Fault, ...], world: World) -> None:
        self._waiting = [(fault, FAULTS[fault.kind](fault, world)) for fault in faults]
        self._lasting: list[tuple[float, Happening]] = []
        self._began = float("inf")
        self.happened: list[Fault] = []

    def start(self) -> None:
        self._began = min(self._began, time.monotonic())

    def advance(self) -> None:
        now = time.monotonic() - self._began
        for end_s, happening in [lasting for lasting in self._lasting if lasting[0] <= now]:
            happening.end()
            self._lasting.remove((end_s, happening))
        for fault, happening in [waiting for waiting in self._waiting if waiting[0].at_s <= now]:
            if happening.begin():
                self.happened.append(fault)
                self._lasting.append((now + fault.for_s, happening))
            elif now < fault.at_s + FIND_S:
                continue
            self._waiting.remove((fault, happening))

    def end(self) -> None:
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
