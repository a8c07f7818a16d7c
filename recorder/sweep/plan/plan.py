"""A sweep's plan as frozen records; `plan_file.py` reads them from TOML."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

from ...backends import BACKEND_MODULES, Meeting, load_backend
from ...bridges import BRIDGE_MODULES, load_bridge
from ...bridges.base import Halves

if TYPE_CHECKING:
    from collections.abc import Mapping

    from .cells import Cell
    from .link import Link


PERCENTILES = (50.0, 90.0, 95.0, 99.0, 99.9)
"""Percentiles in the result of a cell, and those that a search may set its deadline for."""


class Order(Enum):
    """In which order cells run."""

    LISTED = "listed"
    SHUFFLED = "shuffled"


@dataclass(frozen=True, slots=True)
class RunSettings:
    """What all cells of a plan have in common: the plan's `[run]`.

    Attributes:
        messages: of a run, warm-up not counted; 0 if `seconds` says it.
        seconds: length of a run, warm-up not counted; the number of messages follows from the cell's rate.
        min_messages: of a run whose length is given in seconds, however low its rate.
        warmup: messages at the start of each run that are kept out of every statistic.
        settle_seconds: pause between two cells, for buffers to empty and CPUs to cool.
        cutoff_seconds: how long a run may take beyond its planned time; then it is ended and says how far it got.
        order: `shuffled` so that a drift of the machine does not look like an effect.
        seed: of the shuffling.
        repeats: passes over all cells, each in an order of its own.
        attempts: how often a cell that fails is tried.
        discovery: `localhost`, or `subnet` to leave this machine; None for localhost on one machine and
            subnet otherwise.
        domain: of the relay, and of the ping where both are in the same.
        ping_domain: of the ping where a bridge joins the two.
    """

    messages: int = 0
    seconds: float = 0.0
    min_messages: int = 1
    warmup: int = 10
    settle_seconds: float = 0.5
    cutoff_seconds: float = 30.0
    order: Order = Order.LISTED
    seed: int = 0
    repeats: int = 1
    attempts: int = 2
    discovery: str | None = None
    domain: int = 10
    ping_domain: int = 5

    def messages_at(self, rate_hz: float) -> int:
        """Messages of a run at this rate, warm-up not counted."""
        return self.messages or max(self.min_messages, round(self.seconds * rate_hz))

    def planned_seconds(self, rate_hz: float) -> float:
        """Time that the schedule of a run takes, warm-up included."""
        return (self.messages_at(rate_hz) + self.warmup) / rate_hz


@dataclass(frozen=True, slots=True)
class DeviceSettings:
    """One of the two devices: `[devices.ping]` or `[devices.relay]`.

    Attributes:
        name: as written to the trace; None for the system's own name.
        ssh: `user@host` to run it there; the ping is always here.
        ssh_options: further arguments of `ssh`, such as `-p 2222`.
        setup: shell command that runs there first, such as `. /opt/ros/jazzy/setup.sh`.
        path: folder of `dds-record` there, where it is not found by itself: `~/dds-trace/.venv/bin`.
        address: of the device as the other one reaches it, where that has to be told; None for that of `ssh`.
        bridge_port: where the half of a bridge beside the relay waits for the ping's; by default Zenoh's own port.
        options: further options of `dds-record` there, such as `--realtime`, `50`, `--cpu-affinity`, `3`.
    """

    name: str | None = None
    ssh: str | None = None
    ssh_options: tuple[str, ...] = ()
    setup: str | None = None
    path: str | None = None
    address: str | None = None
    bridge_port: int = 7447
    options: tuple[str, ...] = ()

    @property
    def reached_at(self) -> str | None:
        """Where the other device finds this one, None if the plan does not say."""
        return self.address or (self.ssh.rpartition("@")[2] if self.ssh else None)


@dataclass(frozen=True, slots=True)
class Exclusion:
    """Cells that the plan leaves out: those whose every named axis has one of the values.

    Attributes:
        values: axis -> values.
        reason: why, shown by `--dry-run`.
    """

    values: Mapping[str, tuple[Any, ...]]
    reason: str = ""

    def covers(self, cell: Cell) -> bool:
        """Whether it leaves this cell out."""
        return all(getattr(cell, axis) in values for axis, values in self.values.items())


@dataclass(frozen=True, slots=True)
class Search:
    """What `--max-rate` looks for: the plan's `[search]`.

    Attributes:
        min_rate: lowest rate tried.
        max_rate: highest rate tried.
        loss_percent: most that may be lost.
        deadline_ms: for the percentile of the response time (planned send to reply).
        percentile: of the response time that has to keep the deadline.
        resolution: the answer lies within this factor (1.1: within 10 %).
        knee_repeats: runs at the last rate that held and at the first that did not; the majority counts.
        seconds: length of each trial run.
    """

    min_rate: float = 1.0
    max_rate: float = 2000.0
    loss_percent: float = 0.1
    deadline_ms: float = 50.0
    percentile: float = 99.0
    resolution: float = 1.1
    knee_repeats: int = 3
    seconds: float = 5.0


@dataclass(frozen=True, slots=True)
class Plan:
    """Everything that a sweep does.

    Attributes:
        name: of the folder below `--out`; the plan file's name unless it says another.
        cells: in the listed order, first repeat only, exclusions applied.
        excluded: cells left out, with the reason.
        namespaces: ping and relay each in a network namespace of its own.
        link: between the namespaces, None for a bare veth.
        connectivity: as written to the trace; None lets each device look it up.
        by_hand: a person starts the relay, on another device.
    """

    name: str
    cells: tuple[Cell, ...]
    description: str = ""
    excluded: tuple[tuple[Cell, str], ...] = ()
    run: RunSettings = RunSettings()
    ping: DeviceSettings = DeviceSettings()
    relay: DeviceSettings = DeviceSettings()
    namespaces: bool = False
    link: Link | None = None
    connectivity: str | None = "loopback"
    by_hand: bool = False
    search: Search = Search()

    @property
    def discovery(self) -> str:
        """How far the nodes look for each other."""
        if self.run.discovery is not None:
            return self.run.discovery
        return "subnet" if self.namespaces or self.has_two_devices else "localhost"

    @property
    def has_two_devices(self) -> bool:
        """Whether the relay is on another device."""
        return self.by_hand or self.relay.ssh is not None

    def needs_address(self, cell: Cell) -> bool:
        """Whether the cell's ping has to be told where the relay's device is."""
        return connects_to_relay(cell.backend) or self.runs_halves(cell)

    def runs_halves(self, cell: Cell) -> bool:
        """Whether the cell's bridge runs one half beside the ping and one beside the relay.

        On one machine, and where a bridge is one program, the ping's `dds-record` runs all of it.
        """
        return self.has_two_devices and cell.crosses_domains and has_halves(cell.bridge)

    @property
    def digest(self) -> str:
        """Changes when cells of the same name would be recorded differently; new cells do not change it."""
        told = {
            "run": {
                name: value
                for name, value in asdict(self.run).items()
                if name not in ("repeats", "attempts", "seed", "order", "settle_seconds")
            },
            "devices": [(device.ssh, device.options) for device in (self.ping, self.relay)],
            "namespaces": self.namespaces,
            "link": asdict(self.link) if self.link else None,
            "connectivity": self.connectivity,
        }
        return hashlib.sha256(json.dumps(told, sort_keys=True, default=str).encode()).hexdigest()[:16]


def connects_to_relay(backend: str) -> bool:
    """Tell whether a backend's ping connects to the relay's address; False for a backend that we do not know."""
    return backend in BACKEND_MODULES and load_backend(backend).meeting is Meeting.PEERS


def has_halves(bridge: str) -> bool:
    """Whether a bridge is one process for each domain in any case; False for one that we do not know."""
    return bridge in BRIDGE_MODULES and load_bridge(bridge).halves is Halves.ALWAYS
