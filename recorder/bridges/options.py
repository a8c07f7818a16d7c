"""Options of a bridge: the two domains, the topics that cross between them, and the half that runs here."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from enum import Enum

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.tracefile.format.descriptions import Qos

from ..choices import Discovery, Transport
from ..payloads import data_types


class Half(Enum):
    """Part of a bridge that runs here; a bridge of one program has `BOTH` alone."""

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
        """Name of the twin topic, which crosses back."""
        return f"{self.name}_relay"

    @property
    def dds_type_name(self) -> str:
        """Name of the type on the DDS wire: `sensor_msgs::msg::dds_::Image_`."""
        package, kind, name = self.type_name.split("/")
        return f"{package}::{kind}::dds_::{name}_"


def bridged_topic(text: str) -> BridgedTopic:
    """Return the topic of a text `NAME:TYPE`, as in `data_sensor_msgs_PointCloud2:sensor_msgs/msg/PointCloud2`.

    Raises:
        OptionError: the text has another form.
    """
    match = re.fullmatch(r"/?([A-Za-z]\w*(?:/\w+)*):([a-z]\w*/msg/[A-Z]\w*)", text, re.ASCII)
    if match is None:
        raise OptionError(
            f"--topic {text!r}: write NAME:TYPE, for example data_sensor_msgs_PointCloud2:sensor_msgs/msg/PointCloud2"
        )
    return BridgedTopic(match[1], match[2])


BRIDGED_TOPICS = tuple(BridgedTopic(each.topic, each.type_name) for each in data_types().values())
"""Topics that cross a bridge if no others are asked for, each with its `_relay` twin."""


@dataclass(frozen=True, slots=True)
class BridgeSide:
    """One domain that a bridge joins; no topic is in both tuples, so no message circles.

    Attributes:
        domain_id: the DDS domain.
        takes: names of the topics that leave this domain through the bridge.
        puts: names of the topics that come in.
    """

    domain_id: int
    takes: tuple[str, ...]
    puts: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class BridgeOptions:
    """All values that the configuration of a bridge depends on.

    Attributes:
        ping_domain_id: domain of the ping, which `topics` leave.
        relay_domain_id: domain of the relay, which the `_relay` topics leave.
        topics: topics that cross; no other does.
        qos: quality of service of every bridged topic on both sides, so that the bridge asks for no more than the
            nodes offer.
        discovery: range in which the bridge looks for nodes.
        transport: transport of our own bridges' nodes, as of the roles' nodes (`NodeOptions`).
        tuned: whether our own nodes and the Cyclone DDS in zenoh's bridges get the documented settings for large
            messages.
        half: part of the bridge that runs here, for bridges that have one on each device.
        listen: `HOST:PORT` at which this half waits for the other.
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
            fault = limits.DOMAIN_ID.fault(domain_id)
            if fault is not None:
                raise OptionError(f"there is no domain {limits.shown(domain_id)}; {fault}")
        limits.check(limits.DEPTH, self.qos.depth, "--depth")
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
        """Return the domains that this process joins, with the topics that leave each and those that come in."""
        there = tuple(topic.name for topic in self.topics)
        back = tuple(topic.reply_name for topic in self.topics)
        both = {
            Half.PING: BridgeSide(self.ping_domain_id, takes=there, puts=back),
            Half.RELAY: BridgeSide(self.relay_domain_id, takes=back, puts=there),
        }
        return tuple(both.values()) if self.half is Half.BOTH else (both[self.half],)

    def topic_of(self, name: str) -> BridgedTopic:
        """Return the bridged topic of this name, or of this name's twin."""
        return next(topic for topic in self.topics if name in (topic.name, topic.reply_name))

    def type_of(self, name: str) -> str:
        """Return the type of a bridged topic or of its `_relay` twin."""
        return self.topic_of(name).type_name


def split_address(address: str) -> tuple[str, int]:
    """Return host and port of `HOST:PORT` (`[::1]:7447` for IPv6).

    Raises:
        OptionError: the text has another form, or the port is not 1 to 65535.
    """
    host, _, port = address.rpartition(":")
    if limits.ADDRESS.fault(address) is not None or limits.PORT.fault(int(port)) is not None:
        raise OptionError(f"{limits.shown(address)} is no address; write {limits.ADDRESS.what}")
    return host.strip("[]"), int(port)
