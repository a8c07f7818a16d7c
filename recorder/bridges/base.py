"""What every bridge between the ping's and the relay's domain offers: configuration text and how to run its program.

Same names in the same order in every file of `recorder/bridges/`. Nothing here starts anything.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TYPE_CHECKING, Protocol

from dds_trace.tracefile import OptionError, Qos

from ..backends.domains import LAST_DOMAIN
from ..choices import Discovery, Transport
from ..payloads import data_types

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

LOCAL_LINK = "127.0.0.1:7447"
"""Where the two halves of a bridge meet when both run on this machine and no other address is given."""


class Halves(Enum):
    """Whether a bridge runs as one process for each domain, joined by a link of their own."""

    NEVER = "never"
    OPTIONAL = "optional"  # one process for both domains, or a half on each device
    ALWAYS = "always"


class Half(Enum):
    """Which part of a bridge runs here; a bridge of one program knows `BOTH` alone."""

    BOTH = "both"
    PING = "ping"
    RELAY = "relay"


@dataclass(frozen=True, slots=True)
class BridgedTopic:
    """A topic that crosses from the ping's domain to the relay's; its `_relay` twin crosses back.

    Attributes:
        name: ROS name without slash.
        type_name: for example `sensor_msgs/msg/Image`.
    """

    name: str
    type_name: str

    @property
    def reply_name(self) -> str:
        """Name of the topic of the way back."""
        return f"{self.name}_relay"

    @property
    def dds_type_name(self) -> str:
        """The type's name on the DDS wire: `sensor_msgs::msg::dds_::Image_`."""
        package, kind, name = self.type_name.split("/")
        return f"{package}::{kind}::dds_::{name}_"


def bridged_topic(text: str) -> BridgedTopic:
    """The topic that `NAME:TYPE` means, as in `data_sensor_msgs_PointCloud2:sensor_msgs/msg/PointCloud2`.

    Raises:
        OptionError: it is none.
    """
    found = re.fullmatch(r"/?([A-Za-z]\w*(?:/\w+)*):([a-z]\w*/msg/[A-Z]\w*)", text, re.ASCII)
    if found is None:
        raise OptionError(
            f"--topic {text!r}: write NAME:TYPE, for example data_sensor_msgs_PointCloud2:sensor_msgs/msg/PointCloud2"
        )
    return BridgedTopic(found[1], found[2])


BRIDGED_TOPICS = tuple(BridgedTopic(each.topic, each.type_name) for each in data_types().values())
"""What crosses a bridge if nothing else is asked for, each with its `_relay` twin."""


@dataclass(frozen=True, slots=True)
class BridgeOptions:
    """All that a bridge's configuration depends on.

    Attributes:
        ping_domain_id: where the ping is; `topics` are taken from here.
        relay_domain_id: where the relay is; the `_relay` topics are taken from here.
        topics: what crosses; nothing else does.
        qos: of every bridged topic on both sides, so that the bridge asks for no more than the nodes offer.
        discovery: how far the bridge looks for nodes.
        transport: of our own bridges' nodes, as of the roles' own (`NodeOptions`).
        tuned: apply the documented settings for large messages, to our own nodes and to the Cyclone DDS of zenoh's.
        half: which part runs here, for bridges that have one on each device.
        listen: `HOST:PORT` where this half waits for the other.
        peers: `HOST:PORT` of each other half that this one connects to.

    Raises:
        OptionError: the two domains are one, or one of them does not exist, a topic would cross both ways or twice,
            or an address is no HOST:PORT.
    """

    ping_domain_id: int = 5
    relay_domain_id: int = 10
    topics: tuple[BridgedTopic, ...] = BRIDGED_TOPICS
    qos: Qos = field(default_factory=Qos)
    discovery: Discovery = Discovery.SUBNET
    transport: Transport = Transport.DEFAULT
    tuned: bool = False
    half: Half = Half.BOTH
    listen: str | None = None
    peers: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for domain_id in (self.ping_domain_id, self.relay_domain_id):
            if not 0 <= domain_id <= LAST_DOMAIN:
                raise OptionError(f"there is no domain {domain_id}; choose one from 0 to {LAST_DOMAIN}")
        if self.ping_domain_id == self.relay_domain_id:
            raise OptionError(
                f"a bridge joins two domains, both ends are {self.ping_domain_id}; "
                "give two different ones or leave the bridge out",
            )
        names = [name for topic in self.topics for name in (topic.name, topic.reply_name)]
        for name in names:
            if names.count(name) > 1:
                raise OptionError(
                    f"the topic {name} would cross the bridge both ways, or twice; name it once"
                )
        for address in (self.listen, *self.peers):
            if address is not None:
                split_address(address)

    def sides(self) -> tuple[BridgeSide, ...]:
        """The domains that this process joins, with what it takes out of each and what it puts in."""
        there = tuple(topic.name for topic in self.topics)
        back = tuple(topic.reply_name for topic in self.topics)
        both = {
            Half.PING: BridgeSide(self.ping_domain_id, takes=there, puts=back),
            Half.RELAY: BridgeSide(self.relay_domain_id, takes=back, puts=there),
        }
        return tuple(both.values()) if self.half is Half.BOTH else (both[self.half],)

    def type_of(self, name: str) -> str:
        """Type of a bridged topic or of its `_relay` twin."""
        return next(topic.type_name for topic in self.topics if name in (topic.name, topic.reply_name))


@dataclass(frozen=True, slots=True)
class BridgeSide:
    """One domain that a bridge joins; what it puts in is never what it takes out, so nothing circles.

    Attributes:
        takes: names of the topics that leave this domain through the bridge.
        puts: names of the topics that come in.
    """

    domain_id: int
    takes: tuple[str, ...]
    puts: tuple[str, ...]


class Bridge(Protocol):
    """One bridging program; each file of `recorder/bridges/` has one, named `BRIDGE`."""

    @property
    def name(self) -> str:
        """As given to `--bridge` and written to the run."""

    @property
    def install(self) -> str:
        """How to get the program, one line."""

    @property
    def halves(self) -> Halves:
        """Whether it runs as one process for each domain, joined by a link of their own."""

    @property
    def suffix(self) -> str:
        """Of its configuration file: `.json5`, `.yaml`, `.xml`."""

    @property
    def up_pattern(self) -> str | None:
        """Regular expression of the log line that says it serves; None if it says nothing of the kind."""

    def configuration(self, options: BridgeOptions) -> str:
        """The configuration file's text, from `options` alone."""

    def find(self) -> Path | None:
        """The program on this machine, None if there is none."""

    def version(self, program: Path) -> str:
        """The program's version as it reports it, empty if it does not."""

    def command(self, program: Path, configuration: Path, options: BridgeOptions) -> Sequence[str]:
        """The command line that serves until SIGINT."""

    def environment(self, program: Path, options: BridgeOptions) -> Mapping[str, str]:
        """Variables that the program needs beyond those of this process."""


def split_halves(bridge: Bridge, options: BridgeOptions, link: str = LOCAL_LINK) -> tuple[BridgeOptions, ...]:
    """The options of each process to start here.

    Two when a bridge of halves runs wholly on this machine, where they meet at `link`; one otherwise. With `listen` or
    `peers` the other half is elsewhere, and the one here is the ping's unless the options say the relay's.

    Raises:
        OptionError: a half is asked of a bridge that has none, or one that could never meet the other.
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


def split_address(address: str) -> tuple[str, int]:
    """Host and port of `HOST:PORT` (`[::1]:7447` for IPv6).

    Raises:
        OptionError: it is none.
    """
    host, colon, port = address.rpartition(":")
    if not (colon and host and port.isdigit() and 0 < int(port) < 65536):
        raise OptionError(f"{address!r} is no address; write HOST:PORT, for example 192.168.0.5:7447")
    return host.strip("[]"), int(port)
