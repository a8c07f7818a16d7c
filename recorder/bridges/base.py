"""The table of bridges, and what each of its entries offers: configuration text and how to run its program.

Every bridge has the same names in the same order. Nothing here starts a program.
"""

from __future__ import annotations

from dataclasses import replace
from enum import Enum
from importlib import import_module
from typing import TYPE_CHECKING, Protocol

from dds_trace.base.errors import OptionError

from .options import Half

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from .options import BridgeOptions

BRIDGE_MODULES = {
    "builtin": "dds_trace.recorder.bridges.builtin",
    "builtin-zenoh": "dds_trace.recorder.bridges.builtin_zenoh",
    "zenoh-bridge-dds": "dds_trace.recorder.bridges.zenoh_bridge_dds",
    "zenoh-bridge-ros2dds": "dds_trace.recorder.bridges.zenoh_bridge_ros2dds",
    "integration-service": "dds_trace.recorder.bridges.integration_service",
    "ddsrouter": "dds_trace.recorder.bridges.ddsrouter",
    "routing-service": "dds_trace.recorder.bridges.routing_service",
    "domain_bridge": "dds_trace.recorder.bridges.domain_bridge",
}
"""Name of each bridge -> the module that holds its `BRIDGE`, imported at first use.

`dds-record --bridge`, `dds-bridge`, the axis `bridge` of sweep plans and their help know the bridges from here alone.
"""

LOCAL_LINK = "127.0.0.1:7447"
"""Address at which two halves on this machine meet if no other is given."""


class Halves(Enum):
    """Whether a bridge runs as one process for each domain, joined by a link of their own."""

    NEVER = "never"
    OPTIONAL = "optional"  # one process for both domains, or a half on each device
    ALWAYS = "always"


class Bridge(Protocol):
    """One bridging program; each module of `BRIDGE_MODULES` has one, named `BRIDGE`."""

    @property
    def name(self) -> str:
        """Name as given to `--bridge` and written to the run."""

    @property
    def install(self) -> str:
        """How to install the program, in one line."""

    @property
    def halves(self) -> Halves:
        """Whether the bridge runs as one process for each domain, joined by a link of their own."""

    @property
    def suffix(self) -> str:
        """Suffix of the configuration file: `.json5`, `.yaml`, `.xml`."""

    @property
    def up_pattern(self) -> str | None:
        """Regular expression of the log line that says the bridge serves; None if its log has no such line."""

    @property
    def needs_ros_nodes(self) -> bool:
        """Whether it knows nodes by what ROS 2 alone publishes, `ros_discovery_info`; plain DDS programs do not cross it."""

    def configuration(self, options: BridgeOptions) -> str:
        """Return the text of the configuration file, from `options` alone."""

    def find(self) -> Path | None:
        """Return the program's path on this machine, None if it is not installed."""

    def version(self, program: Path) -> str:
        """Return the version that the program reports, or an empty text if it reports none."""

    def command(self, program: Path, configuration: Path, options: BridgeOptions) -> Sequence[str]:
        """Return the command line that serves until SIGINT."""

    def environment(self, program: Path, options: BridgeOptions) -> Mapping[str, str]:
        """Return the environment variables that the program needs beyond those of this process."""


def load_bridge(name: str) -> Bridge:
    """Return the bridge called `name`.

    Raises:
        OptionError: there is no such bridge.
    """
    if name not in BRIDGE_MODULES:
        raise OptionError(f"there is no bridge {name!r}; choose one of {', '.join(BRIDGE_MODULES)}")
    bridge: Bridge = import_module(BRIDGE_MODULES[name]).BRIDGE
    return bridge


def split_halves(bridge: Bridge, options: BridgeOptions, link: str = LOCAL_LINK) -> tuple[BridgeOptions, ...]:
    """Return the options of each process to start here.

    Two when a bridge of halves runs wholly on this machine, where they meet at `link`; one otherwise. With `listen` or
    `peers` the other half is elsewhere, and the one here is the ping's unless the options say the relay's.

    Raises:
        OptionError: the bridge has no halves and one is asked for, or the half could never meet the other.
    """
    joins_others = bool(options.listen or options.peers)
    half = Half.PING if options.half is Half.BOTH and joins_others else options.half
    if half is not Half.BOTH:
        if bridge.halves is Halves.NEVER:
            raise OptionError(
                f"{bridge.name} is one program that joins both domains and has no halves; "
                "run it on one of the devices, without --half, --listen and --peer",
            )
        if not joins_others:
            raise OptionError(
                f"this half of {bridge.name} would never meet the other one; give --listen HOST:PORT here "
                "and --peer HOST:PORT there, or the other way round",
            )
        return (replace(options, half=half),)
    if bridge.halves is Halves.ALWAYS:
        return (
            replace(options, half=Half.PING, listen=link),
            replace(options, half=Half.RELAY, peers=(link,)),
        )
    return (options,)
