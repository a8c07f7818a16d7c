"""One cell of a sweep: the parameters of one ping run, its name, and the relay that it needs."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, TypeVar

from dds_trace.base import limits
from dds_trace.base.files import expand_home
from dds_trace.base.units import spell_size

from ...backends import BACKEND_MODULES
from ...backends.qos import RANKS
from ...bridges.base import BRIDGE_MODULES
from ...choices import ExecutorKind, Serialization, Transport

if TYPE_CHECKING:
    from collections.abc import Collection

    from dds_trace.base.limits import Limit


_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Key:
    """One key of a plan.

    Attributes:
        meaning: what the value says, as a sentence without its subject, for the documentation and editors.
        limit: validator of the value.
        unit: unit of a number, empty where the name tells it or there is none.
        default: what holds where the plan says nothing, in words; empty where the field's own default tells it.
    """

    meaning: str
    limit: Limit = limits.TEXT
    unit: str = ""
    default: str = ""


def plan_key(default: _T, limit: Limit, meaning: str, *, unit: str = "", default_words: str = "") -> _T:
    """Return a dataclass field that is a key of a plan; the arguments are those of `Key`, `default` is the field's."""
    value: _T = field(default=default, metadata={"key": Key(meaning, limit, unit, default_words)})
    return value


@dataclass(frozen=True, slots=True)
class Axis(Key):
    """One axis of a plan: a key that takes one value or a list of them.

    Attributes:
        option: option of `dds-record`, empty for what is not told to it.
        of_relay: whether the relay has to be started with it too.
        kind: type of a plan's value.
        choices: the allowed values, empty where any value of the type is allowed. The table of backends or bridges
            itself, so that an entry that is added later is allowed.
    """

    option: str = ""
    of_relay: bool = False
    kind: type[str | int | float | bool] = str
    choices: Collection[str] = ()


def _axis(default: _T, axis: Axis) -> _T:
    """Return a field of `Cell` that is an axis; `default` is left to `dds-record`, whose own default is the same."""
    value: _T = field(default=default, metadata={"axis": axis})
    return value


@dataclass(frozen=True, slots=True)
class Cell:
    """The parameters of one run; each field but `repeat` is an axis of a plan.

    Attributes: as the axes say. `rmw`, `relay_backend`, `relay_rmw` and `size` are None, and `congestion_control` and
        `environment` empty, where their default holds; `repeat` is 1, 2 ... when the plan asks for several passes.
    """

    backend: str = _axis(
        "ros2",
        Axis(
            "API that carries the messages; `installed` stands for every middleware of this machine, each RMW of ROS 2 "
            "included",
            option="--backend",
            of_relay=True,
            choices=BACKEND_MODULES,
        ),
    )
    rmw: str | None = _axis(
        None,
        Axis(
            "ROS middleware",
            limits.RMW,
            default="the one that the environment chooses",
            option="--rmw",
            of_relay=True,
        ),
    )
    relay_backend: str | None = _axis(
        None, Axis("backend of the relay", default="the ping's", option="--backend", choices=BACKEND_MODULES)
    )
    relay_rmw: str | None = _axis(
        None, Axis("ROS middleware of the relay", limits.RMW, default="the ping's", option="--rmw")
    )
    bridge: str = _axis(
        "none",
        Axis(
            "bridge between two domains; `none` puts ping and relay into one",
            option="--bridge",
            choices=BRIDGE_MODULES,
        ),
    )
    data: str = _axis(
        "binary",
        Axis(
            "`binary`, `string`, `imu`, or what is sent instead: `file:PATH`, `bag:PATH#TOPIC`, `topic:/NAME` "
            "([payloads](../how-to/payloads.md))",
            option="--data",
        ),
    )
    size: int | None = _axis(
        None,
        Axis(
            'payload as a number of bytes, or a text such as `"33KB"`, `"4MB"` (1000), `"1KiB"` (1024)',
            limits.SIZE_BYTES,
            unit="bytes",
            default="33KB; of `string` 91 bytes; what has a size of its own keeps it",
            option="--size",
            kind=int,
        ),
    )
    rate: float = _axis(
        10.0, Axis("messages a second", limits.RATE_HZ, unit="Hz", option="--rate", kind=float)
    )
    reliability: str = _axis(
        "reliable",
        Axis("QoS, of both sides", option="--reliability", of_relay=True, choices=RANKS["reliability"]),
    )
    durability: str = _axis(
        "volatile",
        Axis("QoS, of both sides", option="--durability", of_relay=True, choices=RANKS["durability"]),
    )
    history: str = _axis(
        "keep_last",
        Axis("QoS, of both sides", option="--history", of_relay=True, choices=("keep_last", "keep_all")),
    )
    depth: int = _axis(
        10, Axis("messages that `keep_last` keeps", limits.DEPTH, option="--depth", of_relay=True, kind=int)
    )
    serialization: str = _axis(
        "raw",
        Axis(
            "what the client library gets: serialized bytes (`raw`) or message objects (`typed`)",
            option="--serialization",
            of_relay=True,
            choices=[kind.value for kind in Serialization],
        ),
    )
    transport: str = _axis(
        "default",
        Axis(
            "transports that Fast DDS, zenoh or `socket` may use ([middlewares](middlewares.md))",
            option="--transport",
            of_relay=True,
            choices=[kind.value for kind in Transport],
        ),
    )
    executor: str = _axis(
        "auto",
        Axis(
            "executor of rclpy; `auto` is the fastest one",
            option="--executor",
            of_relay=True,
            choices=[kind.value for kind in ExecutorKind],
        ),
    )
    tuned: bool = _axis(
        False,
        Axis(
            "whether the vendor's settings for large messages are applied",
            limits.FLAG,
            option="--tuned",
            of_relay=True,
            kind=bool,
        ),
    )
    congestion_control: str = _axis(
        "",
        Axis(
            "congestion control of TCP for the backend `socket`: `cubic`, `bbr`, `reno` ...",
            default="the system's",
            option="--congestion-control",
            of_relay=True,
        ),
    )
    environment: str = _axis(
        "",
        Axis(
            "folder of the Python environment whose `dds-record` runs; both sides on this machine",
            default="this environment",
            of_relay=True,
        ),
    )
    repeat: int = 1

    @property
    def middleware(self) -> str:
        """The middlewares of ping and relay: `ros2-fastrtps`, `ros2-fastrtps to cyclonedds`."""
        ping = _middleware_name(self.backend, self.rmw)
        relay = _middleware_name(self.relay.backend, self.relay.rmw)
        return ping if relay == ping else f"{ping} to {relay}"

    @property
    def crosses_domains(self) -> bool:
        """Whether ping and relay are in different domains."""
        return self.bridge != "none"

    @property
    def payload_bit_s(self) -> float | None:
        """Bits of payload a second in one direction, None where the data decides the size."""
        return None if self.size is None else self.size * 8 * self.rate

    @property
    def relay(self) -> RelayNeed:
        """Parameters of the relay of this cell."""
        values = {name: getattr(self, name) for name in RELAY_AXES}
        if self.relay_backend is not None:
            values |= {"backend": self.relay_backend, "rmw": self.relay_rmw}
        elif self.relay_rmw is not None:
            values["rmw"] = self.relay_rmw
        return RelayNeed(**values)

    @property
    def name(self) -> str:
        """Name of the cell and stem of its files: `ros2-fastrtps_same_binary-33KB_10Hz`.

        Middleware, domains, data and rate are always there, every other parameter where it is not the
        default: when a plan gets a new axis, recorded cells keep their names.
        """
        relay = (
            ["to-" + _middleware_name(self.relay.backend, self.relay.rmw)]
            if self.relay_backend is not None or self.relay_rmw is not None
            else []
        )
        data = self.data if self.size is None else f"{self.data}-{spell_size(self.size)}"
        others = [
            _other_name(name, getattr(self, name))
            for name in OTHER_AXES
            if getattr(self, name) != DEFAULTS[name]
        ]
        parts = [
            _middleware_name(self.backend, self.rmw),
            *relay,
            "same" if self.bridge == "none" else self.bridge,
            data,
            f"{self.rate:g}Hz",
            *others,
            *([f"r{self.repeat}"] if self.repeat > 1 else []),
        ]
        return re.sub(r"[^\w.+-]", "-", "_".join(parts))


@dataclass(frozen=True, slots=True)
class RelayNeed:
    """Parameters of one relay process, which serves every cell that needs the same ones.

    Attributes: as in `Cell`.
    """

    backend: str
    rmw: str | None
    reliability: str
    durability: str
    history: str
    depth: int
    serialization: str
    transport: str
    executor: str
    tuned: bool
    congestion_control: str
    environment: str

    @property
    def name(self) -> str:
        """The relay in words, for progress and reasons."""
        others = [
            _other_name(name, getattr(self, name))
            for name in RELAY_AXES
            if name not in ("backend", "rmw") and getattr(self, name) != DEFAULTS[name]
        ]
        return " ".join([_middleware_name(self.backend, self.rmw), *others])


AXES: dict[str, Axis] = {f.name: f.metadata["axis"] for f in fields(Cell) if f.metadata}
"""The axes of a plan, by name."""

DEFAULTS = {name: getattr(Cell(), name) for name in AXES}
"""Value of each axis where a plan says nothing."""

RELAY_AXES = tuple(name for name, axis in AXES.items() if axis.of_relay)
"""Names of the axes that a relay has to be started with."""

_ALWAYS_NAMED = {"backend", "rmw", "relay_backend", "relay_rmw", "bridge", "data", "size", "rate"}
OTHER_AXES = tuple(name for name in AXES if name not in _ALWAYS_NAMED)
"""Names of the axes that a cell's name has only where they differ from the default."""


def _middleware_name(backend: str, rmw: str | None) -> str:
    short = rmw and rmw.removeprefix("rmw_").removesuffix("_cpp")
    return f"{backend}-{short}" if short else backend


def environment_name(folder: str) -> str:
    """Return the name of a Python environment: that of its folder, or of the one around a `.venv`."""
    path = expand_home(folder).absolute()
    return path.parent.name if path.name in {".venv", "venv"} else path.name


def _other_name(name: str, value: object) -> str:
    if value is True:
        return name
    if name == "environment":
        return environment_name(str(value))
    return f"{name}-{value}" if isinstance(value, int) else str(value)
