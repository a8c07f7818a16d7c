"""Parameters of an exchange: the key of its group."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import Enum, auto
from typing import Annotated, get_args, get_type_hints

import polars as pl

from dds_trace.base.units import by_number
from dds_trace.tracefile.format.descriptions import Run, Session

from .metrics import Column
from .setting import setting_of

ParameterValue = str | int | float | None


class KeyPart(Enum):
    """Part of the key of a group."""

    MIDDLEWARE = auto()
    DOMAIN_IDS = auto()  # only same or different matters to a measurement
    DOMAIN_MODE = auto()
    BRIDGE = auto()
    MESSAGE = auto()
    SETTINGS = auto()  # QoS, and whatever else was requested
    DEVICES = auto()
    LINK = auto()


@dataclass(frozen=True, slots=True)
class ParameterSpec:
    """Part of the key, and the column, of a parameter."""

    part: KeyPart
    dtype: type[pl.DataType]
    meaning: str
    unit: str = ""


_SETTING_MEANING = "all other settings: key=value,... sorted, defaults left out; relay.key where the relay's differs"


@dataclass(frozen=True, slots=True)
class Parameters:
    """Parameters of a run and relay; equal ones are one group."""

    vendor: Annotated[str, ParameterSpec(KeyPart.MIDDLEWARE, pl.String, "middleware of the ping")]
    backend: Annotated[str, ParameterSpec(KeyPart.MIDDLEWARE, pl.String, "API that carried the messages of the ping")]
    rmw: Annotated[
        str | None,
        ParameterSpec(KeyPart.MIDDLEWARE, pl.String, "ROS 2 middleware interface of the ping; null outside ROS 2"),
    ]
    bridge: Annotated[str, ParameterSpec(KeyPart.BRIDGE, pl.String, "none, or the bridge between the two domains")]
    relay_vendor: Annotated[
        str | None, ParameterSpec(KeyPart.MIDDLEWARE, pl.String, "middleware of the relay; null without its trace")
    ]
    relay_backend: Annotated[
        str | None, ParameterSpec(KeyPart.MIDDLEWARE, pl.String, "API of the relay; null without its trace")
    ]
    ping_domain_id: Annotated[int, ParameterSpec(KeyPart.DOMAIN_IDS, pl.Int32, "DDS domain of the ping")]
    relay_domain_id: Annotated[
        int | None, ParameterSpec(KeyPart.DOMAIN_IDS, pl.Int32, "DDS domain of the relay; null if unknown")
    ]
    domain_mode: Annotated[str, ParameterSpec(KeyPart.DOMAIN_MODE, pl.String, "same or different")]
    data_type: Annotated[
        str, ParameterSpec(KeyPart.MESSAGE, pl.String, "binary, string, imu or another payload's name")
    ]
    payload_bytes: Annotated[
        int, ParameterSpec(KeyPart.MESSAGE, pl.UInt32, "application bytes of a message, the stamp not counted", "B")
    ]
    rate_hz: Annotated[float, ParameterSpec(KeyPart.MESSAGE, pl.Float64, "rate of the schedule", "Hz")]
    reliability: Annotated[str, ParameterSpec(KeyPart.SETTINGS, pl.String, "reliable or best_effort")]
    durability: Annotated[str, ParameterSpec(KeyPart.SETTINGS, pl.String, "volatile or transient_local")]
    history: Annotated[str, ParameterSpec(KeyPart.SETTINGS, pl.String, "keep_last or keep_all")]
    depth: Annotated[int, ParameterSpec(KeyPart.SETTINGS, pl.Int32, "messages kept, for keep_last")]
    serialization: Annotated[str, ParameterSpec(KeyPart.SETTINGS, pl.String, "typed or raw")]
    ping_device: Annotated[str, ParameterSpec(KeyPart.DEVICES, pl.String, "device of the ping")]
    relay_device: Annotated[
        str | None, ParameterSpec(KeyPart.DEVICES, pl.String, "device of the relay; null without its trace")
    ]
    connectivity: Annotated[
        str, ParameterSpec(KeyPart.LINK, pl.String, "loopback, wired, wireless ... as given to the ping")
    ]
    setting: Annotated[str, ParameterSpec(KeyPart.SETTINGS, pl.String, _SETTING_MEANING)]

    def values(self) -> tuple[ParameterValue, ...]:
        """In the order of `PARAMETER_COLUMNS`."""
        return tuple(getattr(self, name) for name in PARAMETER_NAMES)

    def order(self) -> tuple[tuple[bool, object], ...]:
        """Return the key that sorts groups: column by column, null last."""
        return tuple((value is None, by_number(value) if isinstance(value, str) else value) for value in self.values())


def parameters_of(
    run: Run,
    ping: Session,
    relay: Session | None,
    *,
    relays: int = 1,
    flows: int = 1,
    versions: tuple[str, str] = ("", ""),
) -> Parameters:
    """Return the key of a run and a relay (None without its trace)."""
    relay_domain_id = relay_domain_of(run, ping, relay)
    return Parameters(
        vendor=ping.vendor,
        backend=ping.backend,
        rmw=ping.rmw,
        bridge=run.bridge,
        relay_vendor=relay.vendor if relay else None,
        relay_backend=relay.backend if relay else None,
        ping_domain_id=ping.domain_id,
        relay_domain_id=relay_domain_id,
        # With a bridge to an unknown far side the domains differ, too.
        domain_mode="same" if relay_domain_id == ping.domain_id else "different",
        data_type=run.data_type,
        payload_bytes=run.payload_bytes,
        rate_hz=run.rate_hz,
        reliability=run.qos.reliability,
        durability=run.qos.durability,
        history=run.qos.history,
        depth=run.qos.depth,
        serialization=run.serialization,
        ping_device=ping.device,
        relay_device=relay.device if relay else None,
        connectivity=ping.connectivity,
        setting=setting_of(run, ping, relay, relays=relays, flows=flows, versions=versions),
    )


def relay_domain_of(run: Run, ping: Session, relay: Session | None) -> int | None:
    """Return the relay's domain by its own trace, else by the ping's."""
    if relay is not None:
        return relay.domain_id
    if run.relay_domain_id is not None:
        return run.relay_domain_id
    return ping.domain_id if run.bridge == "none" else None


_SPECS: dict[str, ParameterSpec] = {
    name: get_args(hint)[1] for name, hint in get_type_hints(Parameters, include_extras=True).items()
}

QOS_DEFAULTS: dict[str, ParameterValue] = {
    "reliability": "reliable",
    "durability": "volatile",
    "history": "keep_last",
    "depth": 10,
    "serialization": "raw",
}
"""Columns that are options of both sides, with the option's default."""

PARAMETER_COLUMNS = tuple(Column(name, row.dtype, row.unit, row.meaning) for name, row in _SPECS.items())
PARAMETER_NAMES = tuple(field.name for field in fields(Parameters))


def names_of(*parts: KeyPart) -> tuple[str, ...]:
    """In the order of columns."""
    return tuple(name for name, row in _SPECS.items() if row.part in parts)


CELL_COLUMNS = names_of(KeyPart.MESSAGE)

SERIES_COLUMNS = tuple(name for name in PARAMETER_NAMES if name not in CELL_COLUMNS)

CONTENDER_COLUMNS = names_of(KeyPart.MIDDLEWARE, KeyPart.BRIDGE, KeyPart.SETTINGS)
"""A setup: what a user can choose for a message."""

# Times of different devices or links are never pooled: each verdict is within one pair of devices and one link (E. H. Simpson,
# 1951, for what pooling does).

SETTING_COLUMNS = names_of(
    KeyPart.MIDDLEWARE, KeyPart.BRIDGE, KeyPart.SETTINGS, KeyPart.DOMAIN_MODE, KeyPart.LINK, KeyPart.DEVICES
)
"""A recommendation: the setup, and for which domains, link and devices it holds."""

DEVICE_COLUMNS = ("ping_device", "relay_device")

SITE_COLUMNS = names_of(KeyPart.DEVICES, KeyPart.LINK)
"""Where something was measured; setups elsewhere are no alternatives."""

CASE_COLUMNS = (*names_of(KeyPart.LINK), *names_of(KeyPart.DOMAIN_MODE), *CELL_COLUMNS, *names_of(KeyPart.DEVICES))
"""What compared setups have in common, in the order of answers."""

MATCH_COLUMNS = tuple(name for name in PARAMETER_NAMES if name not in names_of(KeyPart.DOMAIN_IDS))
"""What compared groups have in common: all but the domains' numbers."""

BRIDGE_MATCH_COLUMNS = names_of(KeyPart.MIDDLEWARE, KeyPart.MESSAGE, KeyPart.SETTINGS, KeyPart.LINK, KeyPart.DEVICES)
"""What groups in one domain and through a bridge have in common."""

BRIDGED_COLUMNS = names_of(
    KeyPart.MIDDLEWARE, KeyPart.BRIDGE, KeyPart.MESSAGE, KeyPart.SETTINGS, KeyPart.LINK, KeyPart.DEVICES
)

SAME_SIDES_COLUMNS = names_of(KeyPart.MIDDLEWARE, KeyPart.SETTINGS, KeyPart.DEVICES, KeyPart.LINK)
"""What groups of different domains and bridges have in common."""

SIZE_LINE_COLUMNS = tuple(name for name in PARAMETER_NAMES if name != "payload_bytes")
