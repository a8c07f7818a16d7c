"""The table of bridges, the record of one (`Bridge`), and its options."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from importlib import import_module
from pathlib import Path

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.recorder.choices import Discovery, Transport
from dds_trace.recorder.payloads import data_types
from dds_trace.tracefile.format.descriptions import Qos

from . import BRIDGE_MODULES

LOCAL_LINK = "127.0.0.1:7447"
"""Default address at which two halves on this machine meet."""


class Half(Enum):
    BOTH = "both"
    PING = "ping"
    RELAY = "relay"


class Halves(Enum):
    """Whether a bridge has one process for each domain, joined by a link."""

    NEVER = "never"
    OPTIONAL = "optional"  # one process for both domains, or a half on each device
    ALWAYS = "always"


@dataclass(frozen=True, slots=True)
class BridgedTopic:
    """A topic (ROS name, message type) that crosses to the relay's domain; its twin crosses back."""

    name: str
    type_name: str

    @property
    def reply_name(self) -> str:
        return f"{self.name}_relay"


def bridged_topic(text: str) -> BridgedTopic:
    match = re.fullmatch(r"/?([A-Za-z]\w*(?:/\w+)*):([a-z]\w*/msg/[A-Z]\w*)", text, re.ASCII)
    if match is None:
        raise OptionError(
            f"--topic {text!r}: write NAME:TYPE, for example data_sensor_msgs_PointCloud2:sensor_msgs/msg/PointCloud2"
        )
    return BridgedTopic(match[1], match[2])


BRIDGED_TOPICS = tuple(BridgedTopic(data.topic, data.type_name) for data in data_types().values())
"""Topics that cross every bridge, each with its `_relay` twin."""


@dataclass(frozen=True, slots=True)
class BridgeSide:
    """One domain: a bridge takes topics from it and puts others into it, so no message circles."""

    domain_id: int
    takes: tuple[str, ...]
    puts: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class BridgeOptions:
    """Options of a bridge.

    Attributes:
        transport: of our own bridges' nodes (see `NodeOptions`), and of `ddsrouter`.
        tuned: for our own nodes, `ddsrouter` and the Cyclone DDS in zenoh's bridges.
        listen: `HOST:PORT` at which this half waits for the other.
        peers: `HOST:PORT` of each other half that this one connects to.
        keys: folder of keys with which the link between two halves is TLS.

    Raises:
        OptionError: a domain, a topic or an address cannot be used.
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
    keys: str | None = None

    def __post_init__(self) -> None:
        for domain_id in (self.ping_domain_id, self.relay_domain_id):
            fault = limits.DOMAIN_ID.fault(domain_id)
            if fault is not None:
                raise OptionError(f"there is no domain {limits.shown(domain_id)}; {fault}")
        limits.check(limits.DEPTH, self.qos.depth, "--depth")
        if self.ping_domain_id == self.relay_domain_id:
            raise OptionError(
                f"a bridge joins two domains, but both are {self.ping_domain_id}; name two or leave the bridge out"
            )
        names = self.topic_names
        for name in names:
            if names.count(name) > 1:
                raise OptionError(f"the topic {name} would cross the bridge both ways, or twice; name it once")
        for address in (self.listen, *self.peers):
            if address is not None:
                split_address(address)

    @property
    def topic_names(self) -> list[str]:
        return [name for topic in self.topics for name in (topic.name, topic.reply_name)]

    def sides(self) -> tuple[BridgeSide, ...]:
        there = tuple(topic.name for topic in self.topics)
        back = tuple(topic.reply_name for topic in self.topics)
        sides = {
            Half.PING: BridgeSide(self.ping_domain_id, takes=there, puts=back),
            Half.RELAY: BridgeSide(self.relay_domain_id, takes=back, puts=there),
        }
        return tuple(sides.values()) if self.half is Half.BOTH else (sides[self.half],)

    def type_of(self, name: str) -> str:
        return next(topic.type_name for topic in self.topics if name in (topic.name, topic.reply_name))


def split_address(address: str) -> tuple[str, int]:
    host, _, port = address.rpartition(":")
    if limits.ADDRESS.fault(address) is not None or limits.PORT.fault(int(port)) is not None:
        raise OptionError(f"{limits.shown(address)} is not an address; write {limits.ADDRESS.what}")
    return host.strip("[]"), int(port)


@dataclass(frozen=True, slots=True, kw_only=True)
class Bridge:
    """One bridging program: `BRIDGE` of each module in `BRIDGE_MODULES`.

    Attributes:
        install: how to install the program, in one line.
        tried: version that was run by us and how, or that none was.
        suffix: of the configuration file.
        version: returns what the program reports, empty if nothing.
        arguments: returns the arguments between the program and the path of its configuration.
        environment: returns the variables to add.
        up_pattern: regular expression of the log line when the bridge is up.
        compiled_in: vendor of the middleware in its program, where no loaded library shows it.
        secures_link: whether the link between its halves can be TLS.
        needs_ros_nodes: whether it finds nodes by `ros_discovery_info`, which only ROS 2 publishes.
    """

    name: str
    install: str
    tried: str
    suffix: str
    configuration: Callable[[BridgeOptions], str]
    find: Callable[[], Path | None]
    version: Callable[[Path], str]
    arguments: Callable[[Path], Sequence[str]] = lambda _: ()
    environment: Callable[[BridgeOptions], Mapping[str, str]] = lambda _: {}
    halves: Halves = Halves.NEVER
    up_pattern: str | None = None
    compiled_in: str = ""
    secures_link: bool = False
    needs_ros_nodes: bool = False


def load_bridge(name: str) -> Bridge:
    if name not in BRIDGE_MODULES:
        raise OptionError(f"there is no bridge {name!r}; choose one of {', '.join(BRIDGE_MODULES)}")
    bridge: Bridge = import_module(BRIDGE_MODULES[name]).BRIDGE
    return bridge


def split_halves(bridge: Bridge, options: BridgeOptions, link: str = LOCAL_LINK) -> tuple[BridgeOptions, ...]:
    """Return the options of each process here: two if both run on this machine and meet at `link`; an `OptionError` without halves, or where they could never meet."""
    has_link = bool(options.listen or options.peers)
    half = Half.PING if options.half is Half.BOTH and has_link else options.half
    if half is not Half.BOTH:
        if bridge.halves is Halves.NEVER:
            raise OptionError(
                f"{bridge.name} is one program that joins both domains and has no halves; "
                "run it on one of the devices, without --half, --listen and --peer"
            )
        if not has_link:
            raise OptionError(
                f"this half of {bridge.name} would never meet the other one; give --listen HOST:PORT here "
                "and --peer HOST:PORT there, or the other way round"
            )
        return (replace(options, half=half),)
    if bridge.halves is Halves.ALWAYS:
        return (replace(options, half=Half.PING, listen=link), replace(options, half=Half.RELAY, peers=(link,)))
    return (options,)
