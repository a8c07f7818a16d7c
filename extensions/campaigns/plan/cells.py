"""One cell of a sweep: the parameters of one ping run."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar

from dds_trace.base import limits
from dds_trace.base.files import expand_home
from dds_trace.base.limits import Limit
from dds_trace.base.units import spell_size
from dds_trace.recorder.option import Option
from dds_trace.recorder.option_table import OPTIONS, choices_of
from dds_trace.recorder.options import DEFAULT_RATE_HZ


class OutageBy(Enum):
    LINK = "link"  # the ping's interface goes down, and comes up with its address
    ADDRESS = "address"  # likewise, and comes up with another address
    LOSS = "loss"  # the link stays up, and every packet is lost
    RELAY = "relay"  # the relay is killed, and another one is started


_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Key:
    meaning: str
    limit: Limit = limits.TEXT
    unit: str = ""
    default_words: str = ""
    kind: type = str
    default: object = None
    takes_list: bool = False


def plan_key(default: _T, limit: Limit, meaning: str, *, unit: str = "", default_words: str = "") -> _T:
    kind = str if default is None or isinstance(default, tuple | Enum) else type(default)
    shown = default.value if isinstance(default, Enum) else default
    key = Key(meaning, limit, unit, default_words, kind, shown, isinstance(default, tuple))
    value: _T = field(default=default, metadata={"key": key})
    return value


@dataclass(frozen=True, slots=True)
class PlanAxis(Key):
    takes_list: bool = True
    option: str = ""
    for_relay: bool = False
    row: Option | None = None

    @property
    def choices(self) -> list[str]:
        return choices_of(self.row) if self.row else []


def _axis_of(row: Option) -> PlanAxis:
    assert row.axis is not None
    default = row.axis.default if row.field_default is None else row.field_default
    return PlanAxis(
        row.axis.meaning or row.help.rstrip(".:"),
        row.limit or limits.TEXT,
        unit=row.axis.unit,
        default_words=row.default if default is None else "",
        option=row.name,
        for_relay=row.axis.for_relay,
        kind=row.axis.kind or (str if issubclass(row.kind, Enum) else row.kind),
        row=row,
        default=getattr(default, "value", default),
    )


def _recorders(meaning: str, *, for_relay: bool = False) -> PlanAxis:
    return PlanAxis(meaning, limits.RECORDERS, for_relay=for_relay, kind=int, default=1)


AXES: Mapping[str, PlanAxis] = {
    **{row.name[2:].replace("-", "_"): _axis_of(row) for row in OPTIONS.values() if row.axis},
    "relay_backend": PlanAxis(
        "backend of the relay", default_words="the ping's", option="--backend", row=OPTIONS["backend"]
    ),
    "relay_rmw": PlanAxis("ROS middleware of the relay", limits.RMW, default_words="the ping's", option="--rmw"),
    "environment": PlanAxis(
        "folder of the Python environment that has the `dds-record` to run; both sides on this machine",
        default_words="this environment",
        for_relay=True,
        default="",
    ),
    "queue": PlanAxis(
        "longest wait of a frame for the full line of a `[link]` with a rate, 0 for the link's `queue_ms`",
        limits.WAKE_MS,
        unit="ms",
        kind=int,
        default=0,
    ),
    "link": PlanAxis(
        "emulated link of the result in place of `[link]`: a preset that has only a rate; both sides are in namespaces",
        default_words="`[link]`",
        for_relay=True,
        default="",
    ),
    "outage": PlanAxis(
        "length of an outage in the middle of the run, 0 for none; the run is then as long as `outage_after_seconds`, the outage and "
        "`outage_limit_seconds` ([coming back](../how-to/axes.md#coming-back-after-an-outage))",
        limits.WAIT_S,
        unit="s",
        kind=float,
        default=0.0,
    ),
    "outage_by": PlanAxis(
        "what the outage is: the ping's interface goes down (`link`) and comes up with another address (`address`), every packet is lost "
        "(`loss`), or the relay is killed and another one started (`relay`); all but the last need `[network]` or `[link]`",
        limits.OneOf(tuple(kind.value for kind in OutageBy)),
        default=OutageBy.LINK.value,
    ),
    "relays": _recorders(
        "relays on each host, which all answer each message ([fan-out](../how-to/axes.md#one-message-to-many-and-many-hosts))",
        for_relay=True,
    ),
    "hosts": _recorders(
        "hosts with relays: namespaces on one bridge with `[network]`, or the first ones of `[[devices]]`",
        for_relay=True,
    ),
    "pings": _recorders("pings that send at the same time on one topic"),
    "topics": _recorders("topics at the same time, each with a ping of its own", for_relay=True),
    "multicast": PlanAxis(
        "whether Cyclone DDS may send a message once for all relays; `false`: to each one by itself, as all other middlewares do",
        limits.FLAG,
        option="--no-multicast",
        for_relay=True,
        kind=bool,
        default=True,
    ),
}
"""The axes of a plan: options of a recording, and what else two sides may differ in."""

DEFAULTS: dict[str, Any] = {name: axis.default for name, axis in AXES.items()}

SENDER_AXES = ("priority", "when_full")

RELAY_AXES = tuple(name for name, axis in AXES.items() if axis.for_relay)

_ALWAYS_NAMED = {"backend", "rmw", "relay_backend", "relay_rmw", "bridge", "data", "size", "rate"}
OTHER_AXES = tuple(name for name in AXES if name not in _ALWAYS_NAMED)

_Class = TypeVar("_Class")


def _with_all_axes(cell: type[_Class]) -> type[_Class]:
    for name, default in DEFAULTS.items():
        cell.__annotations__.setdefault(name, "object")
        setattr(cell, name, default)
    return cell


@dataclass(frozen=True, slots=True)
@_with_all_axes
class Cell:
    """The axes of one run, and the number of the pass; `flow` is its flow, one of its `pings` or `topics`, or empty."""

    backend: str = "ros2"
    rmw: str | None = None
    relay_backend: str | None = None
    relay_rmw: str | None = None
    bridge: str = "none"
    data: str = "binary"
    size: int | None = None
    rate: float = DEFAULT_RATE_HZ
    ping_share: float | None = None
    reliability: str = "reliable"
    durability: str = "volatile"
    history: str = "keep_last"
    depth: int = 10
    tuned: bool = False
    transport: str = "default"
    fragment: int | None = None
    configuration: str | None = None
    load: str = "none"
    security: str = "off"
    environment: str = ""
    queue: int = 0
    link: str = ""
    outage: float = 0.0
    outage_by: str = OutageBy.LINK.value
    relays: int = 1
    hosts: int = 1
    pings: int = 1
    topics: int = 1
    multicast: bool = True
    repeat: int = 1
    flow: str = ""
    with_flows: tuple[str, ...] = ()

    @property
    def middleware(self) -> str:
        ping = _middleware_name(self.backend, self.rmw)
        relay = _middleware_name(self.relay.backend, self.relay.rmw)
        return ping if relay == ping else f"{ping} to {relay}"

    @property
    def crosses_domains(self) -> bool:
        return self.bridge != "none"

    @property
    def payload_bit_s(self) -> float | None:
        return None if self.size is None or math.isinf(self.rate) else self.size * 8 * self.rate

    @property
    def together(self) -> Cell:
        if not self.with_flows:
            return replace(self, flow="") if self.senders > 1 else self
        flows = tuple(sorted((self.flow, *self.with_flows)))
        usual = {name: DEFAULTS[name] for name in ("size", "rate", *SENDER_AXES)}
        return replace(self, data="", flow="", with_flows=flows, **usual)

    @property
    def senders(self) -> int:
        return len(self.with_flows) + max(self.pings, self.topics)

    @property
    def receivers(self) -> int:
        return self.relays * self.hosts

    @property
    def relay(self) -> Cell:
        values = {name: getattr(self, name) for name in RELAY_AXES}
        if self.flow and self.senders == len(self.with_flows) + 1:  # one relay serves all flows
            values |= {name: DEFAULTS[name] for name in SENDER_AXES}
        if self.relay_backend is not None:
            values |= {"backend": self.relay_backend, "rmw": self.relay_rmw}
        elif self.relay_rmw is not None:
            values["rmw"] = self.relay_rmw
        if self.crosses_domains:  # what is secured is the link of the bridge
            values["security"] = DEFAULTS["security"]
        return Cell(**values)

    @property
    def relay_name(self) -> str:
        return " ".join([_middleware_name(self.relay.backend, self.relay.rmw), *self.relay.changed_axes])

    @property
    def changed_axes(self) -> list[str]:
        values = [(name, getattr(self, name)) for name in OTHER_AXES]
        return [_other_name(name, value) for name, value in values if value != DEFAULTS[name]]

    @property
    def name(self) -> str:
        """Name of the cell and its files, `ros2-fastrtps_same_binary-33KB_10Hz`; a new axis keeps older names."""
        relay = (
            ["to-" + _middleware_name(self.relay.backend, self.relay.rmw)]
            if self.relay_backend is not None or self.relay_rmw is not None
            else []
        )
        data = self.data if self.size is None else f"{self.data}-{spell_size(self.size)}"
        parts = [
            _middleware_name(self.backend, self.rmw),
            *relay,
            "same" if self.bridge == "none" else self.bridge,
            data,
            "max" if math.isinf(self.rate) else f"{self.rate:g}Hz",
            *self.changed_axes,
            *([self.flow] if self.flow else []),
            *(["with-" + "+".join(self.with_flows)] if self.with_flows else []),
            *([f"r{self.repeat}"] if self.repeat > 1 else []),
        ]
        return re.sub(r"[^\w.+-]", "-", "_".join(parts))


def _middleware_name(backend: str, rmw: str | None) -> str:
    short = rmw and rmw.removeprefix("rmw_").removesuffix("_cpp")
    return f"{backend}-{short}" if short else backend


def environment_name(folder: str) -> str:
    path = expand_home(folder).absolute()
    return path.parent.name if path.name in {".venv", "venv"} else path.name


def _other_name(name: str, value: object) -> str:
    if isinstance(value, bool):
        return name if value else f"no-{name}"
    if name == "environment":
        return environment_name(str(value))
    if name == "configuration":
        return Path(str(value)).stem
    if isinstance(value, float):
        return f"{name}-{value:g}{AXES[name].unit}"
    return f"{name}-{value}" if isinstance(value, int) or name == "outage_by" else str(value)
