"""The key of a group: all parameters of an exchange, and the slices of them by which groups are matched.

A new parameter is a field of `Parameters` and its value in `parameters_of`; grouping, frames, Parquet files, matching and
names follow from the field's row.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import Enum, auto
from typing import TYPE_CHECKING, Annotated, get_args, get_type_hints

import polars as pl

from .metrics import Column
from .setting import setting_of

if TYPE_CHECKING:
    from dds_trace.tracefile.format.descriptions import Run, Session

    ParameterValue = str | int | float | None


class KeyPart(Enum):
    """The part of the key that a parameter belongs to; slices are made of parts."""

    MIDDLEWARE = auto()  # the software of both sides
    DOMAIN_IDS = auto()  # numbers of the domains: only same or different matters to a measurement
    DOMAIN_MODE = auto()
    BRIDGE = auto()
    MESSAGE = auto()  # what was sent
    SETTINGS = auto()  # how it was to be sent: QoS, and what else was asked for
    DEVICES = auto()
    LINK = auto()


@dataclass(frozen=True, slots=True)
class Described:
    """The row of a parameter: its part, and the dtype, meaning and unit of its column."""

    part: KeyPart
    dtype: type[pl.DataType]
    meaning: str
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Parameters:
    """The parameters of one run and relay; those that agree in all parameters are one group."""

    vendor: Annotated[str, Described(KeyPart.MIDDLEWARE, pl.String, "middleware of the ping")]
    backend: Annotated[
        str, Described(KeyPart.MIDDLEWARE, pl.String, "API that carried the messages of the ping")
    ]
    rmw: Annotated[
        str | None,
        Described(
            KeyPart.MIDDLEWARE, pl.String, "ROS 2 middleware interface of the ping; null outside ROS 2"
        ),
    ]
    bridge: Annotated[
        str, Described(KeyPart.BRIDGE, pl.String, "none, or the bridge between the two domains")
    ]
    relay_vendor: Annotated[
        str | None,
        Described(KeyPart.MIDDLEWARE, pl.String, "middleware of the relay; null without its trace"),
    ]
    relay_backend: Annotated[
        str | None, Described(KeyPart.MIDDLEWARE, pl.String, "API of the relay; null without its trace")
    ]
    ping_domain_id: Annotated[int, Described(KeyPart.DOMAIN_IDS, pl.Int32, "DDS domain of the ping")]
    relay_domain_id: Annotated[
        int | None, Described(KeyPart.DOMAIN_IDS, pl.Int32, "DDS domain of the relay; null if nobody said")
    ]
    domain_mode: Annotated[str, Described(KeyPart.DOMAIN_MODE, pl.String, "same or different")]
    data_type: Annotated[
        str, Described(KeyPart.MESSAGE, pl.String, "binary, string, imu or another payload's name")
    ]
    payload_bytes: Annotated[
        int,
        Described(
            KeyPart.MESSAGE, pl.UInt32, "application bytes of a message, the stamp not counted", unit="B"
        ),
    ]
    rate_hz: Annotated[
        float, Described(KeyPart.MESSAGE, pl.Float64, "rate that the schedule asked for", unit="Hz")
    ]
    reliability: Annotated[str, Described(KeyPart.SETTINGS, pl.String, "reliable or best_effort")]
    durability: Annotated[str, Described(KeyPart.SETTINGS, pl.String, "volatile or transient_local")]
    history: Annotated[str, Described(KeyPart.SETTINGS, pl.String, "keep_last or keep_all")]
    depth: Annotated[int, Described(KeyPart.SETTINGS, pl.Int32, "messages kept, for keep_last")]
    serialization: Annotated[str, Described(KeyPart.SETTINGS, pl.String, "typed or raw")]
    ping_device: Annotated[str, Described(KeyPart.DEVICES, pl.String, "device of the ping")]
    relay_device: Annotated[
        str | None, Described(KeyPart.DEVICES, pl.String, "device of the relay; null without its trace")
    ]
    connectivity: Annotated[
        str, Described(KeyPart.LINK, pl.String, "loopback, wired, wireless ... as the ping was told")
    ]
    setting: Annotated[
        str,
        Described(
            KeyPart.SETTINGS,
            pl.String,
            "all else that was asked for: key=value,... sorted, defaults left out; relay.key where the relay was asked "
            "otherwise",
        ),
    ]

    def values(self) -> tuple[ParameterValue, ...]:
        """Return the values in the order of `PARAMETER_COLUMNS`."""
        return tuple(getattr(self, name) for name in PARAMETER_NAMES)

    def order(self) -> tuple[tuple[bool, ParameterValue], ...]:
        """Return the key by which groups are sorted: column by column, null last."""
        return tuple((value is None, value) for value in self.values())


def parameters_of(
    run: Run, ping: Session, relay: Session | None, *, relays: int = 1, flows: int = 1
) -> Parameters:
    """Return the key of the group to which a run and one of its relays belong.

    Args:
        run: the ping's description of the run.
        ping: session of the ping.
        relay: session of the relay, None without its trace.
        relays: number of relays that took part in the run.
        flows: number of runs that went on at the same time, this one included.
    """
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
        # A bridge whose far side nobody names still stands between two domains.
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
        setting=setting_of(run, ping, relay, relays=relays, flows=flows),
    )


def relay_domain_of(run: Run, ping: Session, relay: Session | None) -> int | None:
    """Return the relay's domain: as it says itself, else as the ping was told, else the ping's without a bridge."""
    if relay is not None:
        return relay.domain_id
    if run.relay_domain_id is not None:
        return run.relay_domain_id
    return ping.domain_id if run.bridge == "none" else None


_DESCRIBED: dict[str, Described] = {
    name: get_args(hint)[1] for name, hint in get_type_hints(Parameters, include_extras=True).items()
}

PARAMETER_COLUMNS = tuple(Column(name, row.dtype, row.unit, row.meaning) for name, row in _DESCRIBED.items())
PARAMETER_NAMES = tuple(field.name for field in fields(Parameters))


def names_of(*parts: KeyPart) -> tuple[str, ...]:
    """Return the names of the parameters of some parts, in the order of their columns."""
    return tuple(name for name, row in _DESCRIBED.items() if row.part in parts)


CELL_COLUMNS = names_of(KeyPart.MESSAGE)
"""Parameters of the message: a cell of a report."""

SERIES_COLUMNS = tuple(name for name in PARAMETER_NAMES if name not in CELL_COLUMNS)
"""All other parameters: a series of a report."""

CONTENDER_COLUMNS = names_of(KeyPart.MIDDLEWARE, KeyPart.BRIDGE, KeyPart.SETTINGS)
"""Parameters that a user can choose for a given kind of message."""

# Devices and links are strata: times of unlike devices are never pooled, and each verdict is within one pair of devices
# and one link (E. H. Simpson, 1951, for what pooling does).

SETTING_COLUMNS = names_of(
    KeyPart.MIDDLEWARE, KeyPart.BRIDGE, KeyPart.SETTINGS, KeyPart.DOMAIN_MODE, KeyPart.LINK, KeyPart.DEVICES
)
"""Parameters of a recommendation: the choice, and the domains, link and devices for which it holds."""

PLACE_COLUMNS = names_of(KeyPart.DEVICES, KeyPart.LINK)
"""Parameters that say where something was measured; settings of unlike places are no alternatives."""

CASE_COLUMNS = (
    *names_of(KeyPart.LINK),
    *names_of(KeyPart.DOMAIN_MODE),
    *CELL_COLUMNS,
    *names_of(KeyPart.DEVICES),
)
"""Parameters of a kind of message, for which contenders are compared, in the order by which answers are sorted."""

MATCH_COLUMNS = tuple(name for name in PARAMETER_NAMES if name not in names_of(KeyPart.DOMAIN_IDS))
"""Parameters in which two groups agree that are compared: all but the domains' numbers."""

BRIDGE_MATCH_COLUMNS = names_of(
    KeyPart.MIDDLEWARE, KeyPart.MESSAGE, KeyPart.SETTINGS, KeyPart.LINK, KeyPart.DEVICES
)
"""Parameters in which a group in one domain and a group through a bridge agree that are compared."""

BRIDGED_COLUMNS = names_of(
    KeyPart.MIDDLEWARE, KeyPart.BRIDGE, KeyPart.MESSAGE, KeyPart.SETTINGS, KeyPart.LINK, KeyPart.DEVICES
)
"""Parameters of a row of `Details.bridge_costs`: those that were matched, and the bridge."""

SAME_SIDES_COLUMNS = names_of(KeyPart.MIDDLEWARE, KeyPart.SETTINGS, KeyPart.DEVICES, KeyPart.LINK)
"""Parameters in which groups agree that differ in the domains and the bridge only, cell by cell."""

SIZE_LINE_COLUMNS = tuple(name for name in PARAMETER_NAMES if name != "payload_bytes")
"""Parameters in which groups agree that differ in the size of their messages only."""
