"""The options of a recording: each field with `option(...)` or `detail(...)` is one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import partial
from typing import TYPE_CHECKING

from dds_trace.base import limits
from dds_trace.base.errors import OptionError, OutputExistsError
from dds_trace.base.units import parse_size
from dds_trace.tracefile.format.descriptions import Qos
from dds_trace.tracefile.format.json_fields import Json

from .choices import Call, Discovery, Durability, History, Load, Reliability, Role, Serialization
from .option import (
    OUTSIDE_OF_KEY,
    Axis,
    KeepFree,
    Option,
    Rotation,
    changed_settings,
    detail,
    option,
    parse_pairs,
    parse_rate_or_max,
    parse_rates,
    parse_seconds,
    parse_topics,
)

if TYPE_CHECKING:
    from dds_trace.tracefile.writing.destination import TraceDestination

    from .backends.node import NodeOptions


DEFAULT_MESSAGES = 1000
"""Messages of a run: gates were simulated with it (docs/results/coverage.md)."""
DEFAULT_RATE_HZ = 10.0
MAX_RATE_PING_SHARE = 0.01
DEFAULT_WARMUP = 10
DEFAULT_WAIT_S = 20.0
BEACON_RATE_HZ = 2.0
TAP_DEPTH = 32
"""Messages that wait for a busy tap; no publisher keeps them."""
WAKE_HELP = "Send a probe this long before each message, to wake processors and fill caches. Default: none"
BEACON_RATES_HZ = (1.0, 5.0)


@dataclass(frozen=True, slots=True)
class PingOptions:
    data: str = detail(
        "binary",
        "--data KIND",
        "What is sent: binary, string, imu, imu:FILE (recorded values), file:PATH (or the files of a folder), "
        "bag:PATH#TOPIC, or topic:/NAME (live).",
        axis=Axis(
            for_relay=False,
            meaning="`binary`, `string`, `imu`, or what is sent instead: `imu:FILE`, `file:PATH`, `bag:PATH#TOPIC`, "
            "`topic:/NAME` ([payloads](../how-to/payloads.md))",
        ),
    )
    size_bytes: int | None = detail(
        None,
        "--size SIZE",
        "Size of a message: a number of bytes, 33KB or 4MB (1000), 1KiB (1024). Default: 33KB; string 91; imu always 296",
        limit=limits.SIZE_BYTES,
        parse=lambda text: parse_size(text, "--size"),
        axis=Axis(
            for_relay=False,
            kind=int,
            meaning='payload as a number of bytes, or a text such as `"33KB"`, `"4MB"` (1000), `"1KiB"` (1024)',
            unit="bytes",
        ),
    )
    seed: int | None = detail(None, "--seed N", "Seed of the random content. Default: random", limit=limits.SEED)
    rate_hz: float | None = detail(
        None,
        "--rate HZ",
        f"Messages per second, or max: as fast as the middleware takes them. Default: {DEFAULT_RATE_HZ:g}; of a bag its own rate; of a beacon {BEACON_RATE_HZ:g}",
        limit=limits.RATE_HZ_OR_MAX,
        parse=parse_rate_or_max,
        roles=(Role.PING, Role.BEACON),
        axis=Axis(
            for_relay=False, meaning='messages a second, or `"max"`', default=DEFAULT_RATE_HZ, kind=float, unit="Hz"
        ),
    )
    ping_share: float | None = option(
        None,
        "--ping-share SHARE",
        f"Share of the messages that is sent back, at --rate max. Default: {MAX_RATE_PING_SHARE:g}",
        limit=limits.PING_SHARE,
        axis=Axis(for_relay=False),
    )
    messages: int | None = detail(
        None,
        "--messages N",
        f"Messages to measure. Default: {DEFAULT_MESSAGES}, or what fits --duration",
        limit=limits.MESSAGES,
    )
    warmup: int = detail(DEFAULT_WARMUP, "--warmup N", "Warm-up messages, which do not count.", limit=limits.WARMUP)
    wait_s: float = detail(
        DEFAULT_WAIT_S,
        "--wait TIME",
        "How long to wait for the first echo: 20, 20s or 1min.",
        kind=str,
        parse=partial(parse_seconds, what="-o wait"),
        limit=limits.WAIT_S,
    )
    patience_s: float = detail(
        3.0,
        "--patience TIME",
        "How long a relay that is no longer seen may be silent before the run ends.",
        kind=str,
        parse=partial(parse_seconds, what="-o patience"),
        limit=limits.WAIT_S,
    )
    start_at_s: float | None = detail(
        None,
        "--start-at SECONDS",
        "Do not send before this time (seconds since 1970), so that several pings start together. Default: at the first echo",
        limit=limits.UNIX_S,
    )
    wake_ms: int = option(0, "--wake MS", WAKE_HELP, limit=limits.WAKE_MS, axis=Axis(for_relay=False, unit="ms"))
    clients: int = option(
        1,
        "--clients N",
        "Clients that call at the same time; --rate counts the calls of all.",
        limit=limits.CLIENTS,
        axis=Axis(for_relay=False),
    )
    call_timeout_s: float = detail(
        10.0,
        "--call-timeout TIME",
        "Count calls that take longer; they go on.",
        kind=str,
        parse=partial(parse_seconds, what="-o call_timeout"),
        limit=limits.LENGTH_S,
    )
    relays: int = detail(1, "--relays N", "How many relays to wait for.", limit=limits.RELAYS)
    nodes: int = option(
        0,
        "--nodes N",
        "Open nodes until the domain has this many, and measure their discovery and their traffic at rest.",
        limit=limits.NODES,
        axis=Axis(for_relay=False),
    )
    bridge: str = detail(
        "none",
        "--bridge BRIDGE",
        "Start this bridge to the domain of the relay:",
        limit=limits.NAME,
        axis=Axis(for_relay=False, meaning="bridge between two domains; `none` puts ping and relay into one"),
    )
    bridge_running: bool = detail(False, "--bridge-running", "The bridge is running already: start nothing.")
    bridge_listen: str | None = option(
        None,
        "--bridge-listen ADDRESS",
        "Start only the ping's half; it waits at HOST:PORT for the relay's half (dds-trace bridge --half relay).",
        limit=limits.ADDRESS,
    )
    bridge_peers: tuple[str, ...] = detail(
        (),
        "--bridge-peer ADDRESS",
        "Start only the ping's half; it connects to the relay's half at HOST:PORT; repeatable.",
        limit=limits.ADDRESS,
    )
    relay_domain_id: int | None = detail(
        None,
        "--relay-domain ID",
        "DDS domain of the relay. Default: ROS_DOMAIN_ID, else 10",
        limit=limits.DOMAIN_ID,
        variables=("ROS_DOMAIN_ID",),
    )
    labels: Mapping[str, str] = detail(
        {},
        "--label KEY=VALUE",
        "A note on the run; repeatable.",
        parse=lambda texts: parse_pairs("-o label", texts, "site=lab"),
    )
    settings: Mapping[str, str] = option(
        {},
        "--setting KEY=VALUE",
        "What you set around the run, such as a load or a link; results with different settings are not mixed; repeatable.",
        parse=lambda texts: parse_pairs("-o setting", texts, "cpu_load=50%"),
    )

    def check(self) -> None:
        check_fields(self)
        from .payloads import check_data  # noqa: PLC0415 - help needs no payload

        check_data(self.data)
        for name, pairs in (("-o label", self.labels), ("-o setting", self.settings)):
            for key, value in pairs.items():
                limits.check(limits.LABEL_KEY, key, name)
                limits.check(limits.TEXT, value, f"{name} {key}")
        if self.ping_share is not None and self.rate_hz != float("inf"):
            raise OptionError("-o ping_share needs --rate max; on a schedule every message is sent back")
        joins_halves = self.bridge_listen is not None or bool(self.bridge_peers)
        if self.bridge == "none" and (self.bridge_running or joins_halves):
            raise OptionError("-o bridge_running, bridge_listen and bridge_peer need --bridge NAME")
        if self.bridge_running and joins_halves:
            raise OptionError("-o bridge_running starts nothing; remove bridge_listen and bridge_peer")


@dataclass(frozen=True, slots=True)
class TapOptions:
    topics: tuple[str, ...] = detail(
        (),
        "--topics NAMES",
        "Topics to listen to, with commas: /camera/image,/tf; * and ? stand for any characters: '/camera/*'; repeatable.",
        parse=parse_topics,
    )
    live: bool = detail(False, "--live", "Show rate, age, loss and state of each topic while it runs.")
    live_port: int | None = detail(
        None, "--live-port PORT", "Show the same on http://127.0.0.1:PORT, for this device's users.", limit=limits.PORT
    )
    expected_hz: Mapping[str, float] = detail(
        {},
        "--expect TOPIC=HZ",
        "Rate of a topic, which is SLOW in the live view below 90 % of it: /camera/image=30; repeatable. Default: learnt",
        parse=parse_rates,
    )
    diagnostics: bool = detail(False, "--diagnostics", "Publish the state of each topic on /diagnostics once a second.")
    payload: bool = detail(False, "--payload", "Keep the messages, too, as a bag does.")

    def check(self) -> None:
        check_fields(self)
        if not self.topics:
            raise OptionError("name the topics that the tap listens to: --topics /camera/image,/tf, or '/camera/*'")
        for name in (*self.topics, *self.expected_hz):
            limits.check(limits.TOPIC_PATTERN, name, "--topics")


@dataclass(frozen=True, slots=True)
class RecordOptions:
    """The options of one recording; without `ping`, `tap` and `beacon_rate_hz` of a relay."""

    destination: TraceDestination = field(metadata=OUTSIDE_OF_KEY)
    node: NodeOptions
    ping: PingOptions | None = field(default=None, metadata=OUTSIDE_OF_KEY)
    tap: TapOptions | None = field(default=None, metadata=OUTSIDE_OF_KEY)
    tap_qos: Qos = field(default_factory=Qos, metadata=OUTSIDE_OF_KEY)
    beacon_rate_hz: float | None = field(default=None, metadata=OUTSIDE_OF_KEY)
    duration_s: float | None = detail(
        None,
        "--duration TIME",
        "Stop after this time (10, 10s, 5min); a relay, tap or beacon without it runs until stopped.",
        kind=str,
        parse=partial(parse_seconds, what="--duration"),
        limit=limits.LENGTH_S,
    )
    keep_free: KeepFree = detail(
        KeepFree(),
        "--keep-free SIZE",
        "Stop writing when free disk space falls below SIZE: 500MB, 10%, or 0. Default: 5% of the disk, at most 1GB",
        kind=str,
        parse=KeepFree.parse,
    )
    backend: str = detail(
        "ros2",
        "--backend NAME",
        "API that carries the messages:",
        limit=limits.NAME,
        axis=Axis(
            meaning="API that carries the messages; `installed` means every middleware of this machine, each RMW of ROS 2 "
            "included"
        ),
    )
    serialization: Serialization = option(
        Serialization.RAW,
        "--serialization KIND",
        "What the client library gets: raw (serialized bytes) or typed (message objects).",
        roles=(Role.PING, Role.RELAY),
        axis=Axis(),
    )
    rotation: Rotation | None = detail(
        None,
        "--rotate LIMIT",
        "Start a new file at this size or age: 1GB, 1h (30min, 7d), or 1GB,1h; --out NAME.mcap becomes NAME.00001.mcap and so on.",
        parse=Rotation.parse,
        roles=(Role.RELAY, Role.TAP, Role.BEACON),
    )
    flows: tuple[str, ...] = detail(
        (),
        "--flow NAME",
        "Name of a flow, which has topics of its own, so that several pings of one kind of data share a relay; for a relay repeatable.",
        limit=limits.FLOW_NAME,
        roles=(Role.PING, Role.RELAY),
    )
    types: tuple[str, ...] = detail(
        (),
        "--type TYPE",
        "Send back this message type too, such as sensor_msgs/msg/PointCloud2; repeatable.",
        limit=limits.NAME,
        roles=(Role.RELAY,),
    )
    relay_id: int | None = detail(
        None,
        "--relay-id N",
        "Number of the relay in the trace. Default: random",
        limit=limits.RELAY_ID,
        roles=(Role.RELAY,),
    )
    cpu_affinity: str | None = option(
        None, "--cpu-affinity CPUS", "Run only on these CPUs: 3, or 0,2-3.", limit=limits.CPUS
    )
    realtime_priority: int | None = option(
        None,
        "--realtime PRIORITY",
        "Run under SCHED_FIFO with this priority, 1 to 99, and all memory locked.",
        limit=limits.REALTIME_PRIORITY,
        axis=Axis(),
    )
    load: Load = option(
        Load.NONE,
        "--load KIND",
        "Load this machine while recording, once for all its recordings; network is 100 Mbit/s of UDP that the ping sends:",
        axis=Axis(
            meaning="load of the machine of each side while it records: every processor, copies in memory, 100 Mbit/s of UDP "
            "from the ping to the relay's device, what only keeps processors from sleeping, or what takes four fifths of the relay's processor ([load](../how-to/sweep.md#under-load))"
        ),
    )
    load_to: str | None = detail(
        None,
        "--load-to HOST",
        "Where the UDP of -o load=network goes. Default: the first --peer, else this machine",
        limit=limits.HOST,
        roles=(Role.PING,),
    )
    strict: bool = detail(
        False,
        "--strict",
        "Exit with 11 if the middleware does not use a requested setting (-o transport, --tuned ...); without it, warn.",
    )
    wire: bool = option(
        False,
        "--wire",
        "Count packets, retransmissions and bytes on the interfaces: lo with localhost discovery, else all that are up. "
        "Needs CAP_NET_RAW.",
    )
    own_cost: bool = detail(
        True, "--no-own-cost", "Start a second sooner: do not measure the cost of recording and of the client library."
    )
    device: str | None = detail(
        None, "--device NAME", "Name of this device in the trace. Default: host name", limit=limits.NAME
    )
    connectivity: str | None = detail(
        None,
        "--connectivity NAME",
        "Link of this device: loopback, wired, wireless, or your own word. Default: detected",
        limit=limits.NAME,
    )

    def check(self) -> None:
        destination = self.destination
        check_fields(self)
        check_fields(self.node)
        limits.check(limits.DEPTH, self.node.qos.depth, "--depth")
        limits.check(limits.PATH, str(destination.path), "--out")
        if self.rotation is not None:
            self.rotation.check(destination)
        elif destination.path.exists() and not destination.force:
            raise OutputExistsError(f"{destination.path} is there already; choose another name or use --force")
        if self.ping is not None:
            self.ping.check()
            if len(self.flows) > 1:
                raise OptionError(f"-o flow={' -o flow='.join(self.flows)}: a ping is one flow; start a ping for each")
        if self.tap is not None:
            self.tap.check()
        check_call(self.node, self.ping or PingOptions(), self.flows)
        slowest_hz, fastest_hz = BEACON_RATES_HZ
        if self.beacon_rate_hz is not None and not slowest_hz <= self.beacon_rate_hz <= fastest_hz:
            raise OptionError(
                f"--rate {self.beacon_rate_hz:g}: a beacon sends {slowest_hz:g} to {fastest_hz:g} messages a second"
            )


ACTION_GOAL_BYTES = 4


def check_call(node: NodeOptions, ping: PingOptions, flows: tuple[str, ...]) -> None:
    call = f"-o call={node.call.value}"
    if node.call is Call.NONE:
        if ping.clients > 1 or node.response_bytes is not None:
            raise OptionError("-o clients and -o response_size need -o call=service or action")
    elif ping.bridge != "none":
        raise OptionError(f"{call} with --bridge {ping.bridge}: bridges are started for topics; use one domain")
    elif flows:
        raise OptionError(f"{call} with -o flow={flows[0]}: a flow is a topic; remove one of them")
    elif ping.rate_hz == float("inf") or ping.ping_share is not None:
        raise OptionError(f"{call} with --rate max or -o ping_share: each call has a response; remove them")
    elif node.call is Call.ACTION and ping.size_bytes not in (None, ACTION_GOAL_BYTES):
        goal = f"the goal of an action is one number of {ACTION_GOAL_BYTES} bytes"
        raise OptionError(f"--size {ping.size_bytes}: {goal}; give -o response_size")


def check_fields(record: object) -> None:
    assert is_dataclass(record)
    for column in fields(record):
        row: Option | None = column.metadata.get("option")
        value = getattr(record, column.name)
        if row is not None and row.limit is not None:
            for part in value if isinstance(value, tuple) else (value,):
                limits.check(row.limit, part, row.name)


def side_settings(options: RecordOptions, connectivity: str) -> dict[str, Json]:
    settings = dict(changed_settings(options))
    usual = Discovery.LOCALHOST if connectivity == "loopback" else Discovery.SUBNET
    settings.pop("discovery", None)
    if options.node.discovery is not usual:
        settings["discovery"] = options.node.discovery.value
    return settings


def run_settings(options: PingOptions) -> dict[str, Json]:
    settings = dict(changed_settings(options))
    if options.bridge_listen is not None:
        settings["bridge_listen"] = True  # not the address, which is private
    return settings


def chosen_qos(reliability: Reliability | None, durability: Durability | None, depth: int | None) -> Qos:
    """Return the quality of service of a tap's subscriptions: every publisher matches it, and keeps nothing for it."""
    return Qos(
        reliability or Reliability.BEST_EFFORT, durability or Durability.VOLATILE, History.KEEP_LAST, depth or TAP_DEPTH
    )
