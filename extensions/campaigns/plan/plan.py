"""The plan of a sweep; `plan_file.py` reads it from TOML."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import Enum

from dds_trace.base import limits
from dds_trace.extensions.bridges.base import Halves, load_bridge
from dds_trace.extensions.gates.sections import Threshold
from dds_trace.recorder.backends import load_backend
from dds_trace.recorder.backends.base import Meeting
from dds_trace.recorder.backends.qos import warn_of_depth
from dds_trace.recorder.choices import Discovery, Security
from dds_trace.recorder.options import DEFAULT_MESSAGES

from .cells import Cell, plan_key
from .link import PRESETS, Link

PERCENTILES = (50.0, 90.0, 95.0, 99.0, 99.9)


class Order(Enum):
    LISTED = "listed"
    SHUFFLED = "shuffled"
    ALTERNATING = "alternating"  # a shuffled pass, then the same backwards, then another one ...


@dataclass(frozen=True, slots=True)
class RunSettings:
    """The table `[run]`; without `messages` and `seconds` a run has `DEFAULT_MESSAGES`."""

    messages: int = plan_key(
        0,
        limits.MESSAGES_OR_NONE,
        "messages of a run, without warm-up; instead of `seconds`",
        default_words=f"{DEFAULT_MESSAGES} where there is no `seconds`",
    )
    seconds: float = plan_key(
        0.0,
        limits.LENGTH_OR_NONE_S,
        "length of a run, without warm-up; instead of `messages`, which then follow from the rate",
        unit="s",
        default_words="none",
    )
    min_messages: int = plan_key(1, limits.MESSAGES, "fewest messages of a run with `seconds`, however low its rate")
    warmup: int = plan_key(10, limits.WARMUP, "messages at the start of each run that are in no statistic")
    settle_seconds: float = plan_key(
        0.5, limits.WAIT_S, "pause between two runs, in which buffers empty and CPUs cool", unit="s"
    )
    cutoff_seconds: float = plan_key(
        30.0, limits.WAIT_S, "how much longer than planned a run may take before it is stopped", unit="s"
    )
    order: Order = plan_key(  # noqa: RUF009 - a field, as the others
        Order.LISTED,
        limits.OneOf(tuple(order.value for order in Order)),
        "order of the runs of a repeat; with `alternating` a drift of the machine does not look like an effect",
    )
    seed: int = plan_key(0, limits.SEED, "seed of the shuffling")
    repeats: int = plan_key(
        1, limits.REPEATS, "runs of each result; a verdict needs three, and five find +20 % in most comparisons"
    )
    attempts: int = plan_key(2, limits.ATTEMPTS, "most attempts at a run that fails")
    discovery: str | None = plan_key(
        None,
        limits.OneOf(tuple(reach.value for reach in Discovery)),
        "how far nodes look for each other",
        default_words="`localhost` on one machine, `subnet` between devices or namespaces",
    )
    domain: int = plan_key(
        10,
        limits.DOMAIN_ID,
        "DDS domain of the relay, and of a ping without a bridge",
        default_words="`ROS_DOMAIN_ID`, else 10",
    )
    ping_domain: int = plan_key(5, limits.DOMAIN_ID, "DDS domain of a ping with a bridge")
    wire: bool = plan_key(
        False,
        limits.FLAG,
        "whether both sides count packets on their interfaces ([wire.md](wire.md)); needs CAP_NET_RAW",
    )
    outage_after_seconds: float = plan_key(3.0, limits.WAIT_S, "time from the first message to an `outage`", unit="s")
    outage_limit_seconds: float = plan_key(
        20.0, limits.LENGTH_S, "time after an `outage` in which a message has to arrive; later is never", unit="s"
    )
    own_cost_passes: int = plan_key(
        0, limits.PASSES_OR_ALL, "first repeats in which sessions measure their own cost, for one second each; 0: all"
    )

    def messages_at(self, rate_hz: float, outage_s: float = 0.0) -> int:
        if outage_s:
            return max(1, round((self.outage_after_seconds + outage_s + self.outage_limit_seconds) * rate_hz))
        return self.messages or max(self.min_messages, round(self.seconds * rate_hz))

    def planned_seconds(self, rate_hz: float, outage_s: float = 0.0) -> float:
        if math.isinf(rate_hz):
            return self.seconds
        return (self.messages_at(rate_hz, outage_s) + self.warmup) / rate_hz

    def measures_own_cost(self, number: int) -> bool:
        return not self.own_cost_passes or number <= self.own_cost_passes


@dataclass(frozen=True, slots=True)
class DeviceSettings:
    name: str | None = plan_key(None, limits.NAME, "name of the device in the trace", default_words="its host name")
    ssh: str | None = plan_key(
        None,
        limits.NAME,
        "`user@host` of the relay's device, reached by `ssh` with keys",
        default_words="none: this machine",
    )
    ssh_options: tuple[str, ...] = plan_key((), limits.TEXT, 'further arguments of `ssh`, such as `["-p", "2222"]`')
    setup: str | None = plan_key(
        None,
        limits.TEXT,
        "shell command that runs on the device first, such as `. /opt/ros/jazzy/setup.sh`",
        default_words="none",
    )
    path: str | None = plan_key(
        None,
        limits.TEXT,
        "folder of `dds-record` on the device, such as `~/dds-trace/.venv/bin`",
        default_words="found by the shell's PATH",
    )
    address: str | None = plan_key(
        None, limits.HOST, "address of this device for the other one", default_words="the host of `ssh`"
    )
    bridge_port: int = plan_key(
        7447,
        limits.PORT,
        "port at which the relay's half of a bridge waits for the ping's half; the default is Zenoh's",
    )
    options: tuple[str, ...] = plan_key(
        (), limits.TEXT, 'further options of `dds-record` on the device, such as `["-o", "realtime=50"]`'
    )

    @property
    def reached_at(self) -> str | None:
        return self.address or (self.ssh.rpartition("@")[2] if self.ssh else None)


@dataclass(frozen=True, slots=True)
class Exclusion:
    """A rule that excludes a cell if each named axis has one of its values there."""

    values: Mapping[str, tuple[object, ...]]
    reason: str = ""

    def covers(self, cell: Cell) -> bool:
        return all(getattr(cell, axis) in values for axis, values in self.values.items())


@dataclass(frozen=True, slots=True)
class Search:
    min_rate: float = plan_key(1.0, limits.RATE_HZ, "lowest rate tried", unit="Hz")
    max_rate: float = plan_key(2000.0, limits.RATE_HZ, "highest rate tried", unit="Hz")
    loss_percent: float = plan_key(0.1, limits.PERCENT, "largest share of lost messages of a rate that works", unit="%")
    deadline_ms: float = plan_key(
        50.0,
        limits.DEADLINE_MS,
        "longest response (planned send to reply) at `percentile` of a rate that works",
        unit="ms",
    )
    percentile: float = plan_key(
        99.0, limits.OneOf(PERCENTILES), "percentile of the responses that must meet the deadline"
    )
    resolution: float = plan_key(1.1, limits.FACTOR, "factor within which the answer is exact (1.1: within 10 %)")
    knee_repeats: int = plan_key(
        3, limits.KNEE_REPEATS, "runs at the last rate that worked and at the first that did not; the majority counts"
    )
    seconds: float = plan_key(
        5.0,
        limits.LENGTH_S,
        "length of each trial run, which has at least the messages that the percentile needs",
        unit="s",
    )


@dataclass(frozen=True, slots=True)
class Network:
    namespaces: bool = plan_key(
        False,
        limits.FLAG,
        "whether each side runs in its own network namespace, joined by a veth pair; implied by `[link]`",
    )


@dataclass(frozen=True, slots=True)
class Plan:
    """All cells of a sweep, with the settings and devices to record them.

    Attributes:
        connectivity: the sessions'; None lets each device detect it.
        partners: cell without pass -> cell of the other plan that it alternates with.
        hosts: of `[[devices]]`, the relays' devices; `relay` is the first of them.
        thresholds: what each result has to meet.
        text: the content of the plan file, with its name.
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
    partners: Mapping[str, str] = field(default_factory=dict)
    thresholds: tuple[Threshold, ...] = ()
    flows: tuple[str, ...] = ()
    hosts: tuple[DeviceSettings, ...] = ()
    text: str = field(default="", repr=False, compare=False)

    @property
    def discovery(self) -> str:
        if self.run.discovery is not None:
            return self.run.discovery
        return "subnet" if self.namespaces or self.has_two_devices else "localhost"

    def link_of(self, cell: Cell) -> Link | None:
        return PRESETS[cell.link] if cell.link else self.link

    def connectivity_of(self, cell: Cell) -> str | None:
        return PRESETS[cell.link].connectivity if cell.link else self.connectivity

    @property
    def has_two_devices(self) -> bool:
        return self.by_hand or self.relay.ssh is not None

    def runs_halves(self, cell: Cell) -> bool:
        is_apart = self.has_two_devices or (self.namespaces and cell.security == Security.OFF.value)
        return is_apart and cell.crosses_domains and load_bridge(cell.bridge).halves is Halves.ALWAYS

    @property
    def digest(self) -> str:
        settings = {
            "run": {
                name: value
                for name, value in asdict(self.run).items()
                if name not in ("repeats", "attempts", "seed", "order", "settle_seconds", "own_cost_passes")
                # So that sweeps of older versions go on:
                and (name, value)
                not in (("wire", False), ("outage_after_seconds", 3.0), ("outage_limit_seconds", 20.0))
            },
            "devices": [(device.ssh, device.options) for device in (self.ping, self.relay, *self.hosts[1:])],
            "namespaces": self.namespaces,
            "link": self.link.to_dict() if self.link else None,
            "connectivity": self.connectivity,
            **({"halves": True} if self.namespaces and any(map(self.runs_halves, self.cells)) else {}),
        }
        return hashlib.sha256(json.dumps(settings, sort_keys=True, default=str).encode()).hexdigest()[:16]


def depth_warnings(plan: Plan) -> list[str]:
    warned: dict[str, list[str]] = {}
    for cell in plan.cells:
        speaks_dds = load_backend(cell.backend).speaks_dds
        if speaks_dds and (warning := warn_of_depth(cell.history, cell.depth, cell.rate)) is not None:
            warned.setdefault(warning, []).append(cell.name)
    return [
        f"{warning} (in {names[0]})" if len(names) == 1 else f"{warning} (in {len(names)} results: {names[0]} ...)"
        for warning, names in warned.items()
    ]


def connects_to_relay(backend: str) -> bool:
    return load_backend(backend).meeting is Meeting.PEERS
