"""One cell of a sweep: the parameters of one ping run, its name, and what relay it needs."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

from dds_trace.tracefile.units.sizes import spell_size

from ...backends.qos import RANKS
from ...choices import ExecutorKind, Serialization, Transport

if TYPE_CHECKING:
    from collections.abc import Iterable
    from enum import Enum


def _axis(
    default: Any,
    option: str,
    *,
    relay: bool = False,
    kind: type = str,
    choices: Iterable[str] | type[Enum] = (),
) -> Any:
    """A field that is an axis of a plan.

    Args:
        default: the value where a plan says nothing; not passed on, so that `dds-record`'s own default counts.
        option: of `dds-record`.
        relay: the relay has to be started with it too.
        kind: what a plan's value is.
        choices: the values that there are, empty where anything may be given.
    """
    named = [choice.value for choice in choices] if isinstance(choices, type) else list(choices)
    return field(default=default, metadata={"option": option, "relay": relay, "kind": kind, "choices": named})


@dataclass(frozen=True, slots=True)
class Cell:
    """The parameters of one run; each field but `repeat` is an axis of a plan.

    Attributes:
        backend: the API that carries the messages.
        rmw: the ROS middleware, None for the one that the environment chooses.
        relay_backend: of the relay, None for the ping's.
        relay_rmw: of the relay, None for the ping's.
        bridge: between two domains; `none` puts ping and relay in one domain.
        data: `binary`, `string`, `imu`, or a source such as `file:PATH`.
        size: payload bytes, None where the data decides.
        rate: messages a second.
        repeat: 1, 2 ... when the plan asks for several.
    """

    backend: str = _axis("ros2", "--backend", relay=True)
    rmw: str | None = _axis(None, "--rmw", relay=True)
    relay_backend: str | None = _axis(None, "--backend")
    relay_rmw: str | None = _axis(None, "--rmw")
    bridge: str = _axis("none", "--bridge")
    data: str = _axis("binary", "--data")
    size: int | None = _axis(None, "--size", kind=int)
    rate: float = _axis(10.0, "--rate", kind=float)
    reliability: str = _axis("reliable", "--reliability", relay=True, choices=RANKS["reliability"])
    durability: str = _axis("volatile", "--durability", relay=True, choices=RANKS["durability"])
    history: str = _axis("keep_last", "--history", relay=True, choices=("keep_last", "keep_all"))
    depth: int = _axis(10, "--depth", relay=True, kind=int)
    serialization: str = _axis("raw", "--serialization", relay=True, choices=Serialization)
    transport: str = _axis("default", "--transport", relay=True, choices=Transport)
    executor: str = _axis("auto", "--executor", relay=True, choices=ExecutorKind)
    tuned: bool = _axis(False, "--tuned", relay=True, kind=bool)
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
        """Bits of payload that one direction has to carry in a second, None where the data decides."""
        return None if self.size is None else self.size * 8 * self.rate

    @property
    def relay(self) -> RelayNeed:
        """What the relay of this cell has to be started with."""
        values = {axis.name: getattr(self, axis.name) for axis in RELAY_AXES}
        if self.relay_backend is not None:
            values |= {"backend": self.relay_backend, "rmw": self.relay_rmw}
        elif self.relay_rmw is not None:
            values["rmw"] = self.relay_rmw
        return RelayNeed(**values)

    @property
    def name(self) -> str:
        """The cell's name, from which its files have theirs: `ros2-fastrtps_same_binary-33KB_10Hz`.

        Middleware, domains, data and rate are always there, every other parameter where it is not the
        default: a plan may grow a new axis and the cells that are there already keep their names.
        """
        relay = (
            ["to-" + _middleware_name(self.relay.backend, self.relay.rmw)]
            if self.relay_backend is not None or self.relay_rmw is not None
            else []
        )
        data = self.data if self.size is None else f"{self.data}-{spell_size(self.size)}"
        others = [
            _other_name(axis.name, getattr(self, axis.name))
            for axis in OTHER_AXES
            if getattr(self, axis.name) != axis.default
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
    """What one relay process is started with; it serves every cell that needs the same.

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

    @property
    def name(self) -> str:
        """The relay in words, for progress and reasons."""
        others = [
            _other_name(axis.name, getattr(self, axis.name))
            for axis in RELAY_AXES
            if axis.name not in ("backend", "rmw") and getattr(self, axis.name) != axis.default
        ]
        return " ".join([_middleware_name(self.backend, self.rmw), *others])


AXES = {axis.name: axis for axis in fields(Cell) if axis.metadata}
"""The axes of a plan, by name."""

RELAY_AXES = tuple(axis for axis in AXES.values() if axis.metadata["relay"])

_ALWAYS_NAMED = {"backend", "rmw", "relay_backend", "relay_rmw", "bridge", "data", "size", "rate"}
OTHER_AXES = tuple(axis for axis in AXES.values() if axis.name not in _ALWAYS_NAMED)


def _middleware_name(backend: str, rmw: str | None) -> str:
    short = rmw and rmw.removeprefix("rmw_").removesuffix("_cpp")
    return f"{backend}-{short}" if short else backend


def _other_name(name: str, value: object) -> str:
    if value is True:
        return name
    return f"{name}-{value}" if isinstance(value, int) else str(value)
