"""The options of `dds-record`: the name, the kind of value and the help of each, panel by panel."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dds_trace.recorder import choices
from dds_trace.recorder.backends import BACKEND_MODULES
from dds_trace.recorder.bridges.base import BRIDGE_MODULES

if TYPE_CHECKING:
    from typer.models import OptionInfo


@dataclass(frozen=True, slots=True)
class _Panel:
    """A part of the help with a title of its own; called, it makes one of its options."""

    title: str

    def __call__(self, name: str, *, metavar: str, help: str) -> OptionInfo:  # noqa: A002 - typer's word
        option: OptionInfo = typer.Option(
            name, metavar=metavar, help=help, rich_help_panel=self.title, show_default=False
        )
        return option


_role, _message, _schedule = _Panel("Role and output"), _Panel("Message (ping)"), _Panel("Schedule (ping)")
_middleware, _process = _Panel("Middleware"), _Panel("Process")
_description = _Panel("Description in the trace")
_relay, _tools = _Panel("Relay"), _Panel("Instead of recording")

Role = Annotated[
    choices.Role | None,
    _role("--role", metavar="ROLE", help="[bold]ping[/bold] sends, [bold]relay[/bold] sends back."),
]
Out = Annotated[
    Path | None,
    _role("--out", metavar="PATH", help="A [bold].mcap[/bold] file, or the name of a rosbag2 folder."),
]
Force = Annotated[bool, _role("--force", metavar="", help="Overwrite what is there.")]
Fsync = Annotated[
    bool,
    _role(
        "--fsync",
        metavar="",
        help="Flush the trace to the disk twice a second: a power loss takes less than the last second.",
    ),
]
FileMode = Annotated[
    choices.FileMode,
    _role(
        "--file-mode",
        metavar="MODE",
        help="Of trace and ring: 0640 [dim](default: you write, your group reads)[/dim] or 0600.",
    ),
]
Duration = Annotated[
    float | None, _role("--duration", metavar="SECONDS", help="End then. A relay goes on until stopped.")
]
Rotate = Annotated[
    str | None,
    _relay(
        "--rotate",
        metavar="LIMIT",
        help="Go on in a new file at this size or age: 1GB, 1h (30min, 7d), or 1GB,1h: --out NAME.mcap becomes "
        "NAME.00001.mcap and so on.",
    ),
]
Keep = Annotated[
    int | None,
    _relay("--keep", metavar="N", help="With --rotate: delete this recording's oldest files beyond N."),
]
KeepFree = Annotated[
    str | None,
    _role(
        "--keep-free",
        metavar="SIZE",
        help="Write no more before the disk has less free: 500MB, 10%, or 0. [dim]Default: 5% of it, at most 1GB[/dim]",
    ),
]
FailIfLost = Annotated[
    str | None,
    _role(
        "--fail-if-lost",
        metavar="PERCENT",
        help="Of a ping: end with exit code 13 if more of its messages are lost, 1% say.",
    ),
]
AsJson = Annotated[bool, _role("--json", metavar="", help="Print the result as JSON.")]
Data = Annotated[
    str | None,
    _message(
        "--data",
        metavar="KIND",
        help="binary [dim](default)[/dim], string, imu, file:PATH (or a folder's files), bag:PATH#TOPIC, or "
        "topic:/NAME (live).",
    ),
]
Size = Annotated[
    str | None,
    _message(
        "--size",
        metavar="SIZE",
        help="Bytes: 33KB, 4MB (1000), 1KiB (1024), or a number. "
        "[dim]Default: 33KB; string 91; imu always 296[/dim]",
    ),
]
Seed = Annotated[
    int | None, _message("--seed", metavar="N", help="Of the random content. [dim]Default: drawn[/dim]")
]
Rate = Annotated[
    float | None,
    _schedule(
        "--rate", metavar="HZ", help="Messages a second. [dim]Default: 10; of a bag its own rate[/dim]"
    ),
]
Messages = Annotated[
    int | None,
    _schedule(
        "--messages",
        metavar="N",
        help="Messages to measure. [dim]Default: 1000, or what fits --duration[/dim]",
    ),
]
Warmup = Annotated[
    int | None,
    _schedule(
        "--warmup",
        metavar="N",
        help="Messages before, which do not count. [dim]Default: 10[/dim]",
    ),
]
Wait = Annotated[
    float | None,
    _schedule("--wait", metavar="SECONDS", help="For a first echo. [dim]Default: 20[/dim]"),
]
Relays = Annotated[
    int | None, _schedule("--relays", metavar="N", help="Relays to wait for. [dim]Default: 1[/dim]")
]
Domain = Annotated[
    int | None,
    _middleware(
        "--domain",
        metavar="ID",
        help="DDS domain. [dim]Default: ROS_DOMAIN_ID, else 10; a ping with --bridge: 5[/dim]",
    ),
]
Bridge = Annotated[
    str | None,
    _middleware(
        "--bridge",
        metavar="NAME",
        help=f"Start this bridge to the relay's domain: {', '.join(BRIDGE_MODULES)}.",
    ),
]
BridgeRunning = Annotated[
    bool, _middleware("--bridge-running", metavar="", help="That bridge is up already: start nothing.")
]
BridgeListen = Annotated[
    str | None,
    _middleware(
        "--bridge-listen",
        metavar="ADDRESS",
        help="Start the ping's half alone; it waits at HOST:PORT for the relay's (dds-bridge --half relay).",
    ),
]
BridgePeer = Annotated[
    list[str] | None,
    _middleware(
        "--bridge-peer",
        metavar="ADDRESS",
        help="Likewise, but it goes to the other half at HOST:PORT; repeatable.",
    ),
]
RelayDomain = Annotated[
    int | None,
    _middleware(
        "--relay-domain",
        metavar="ID",
        help="Domain behind the bridge. [dim]Default: ROS_DOMAIN_ID, else 10[/dim]",
    ),
]
Discovery = Annotated[
    choices.Discovery | None,
    _middleware(
        "--discovery",
        metavar="RANGE",
        help="localhost or subnet. [dim]Default: what ROS 2's environment says, else subnet[/dim]",
    ),
]
Peer = Annotated[
    list[str] | None,
    _middleware(
        "--peer",
        metavar="HOST",
        help="Device of a relay, or HOST:PORT, where the backend does not look for it; repeatable.",
    ),
]
Reliability = Annotated[
    choices.Reliability,
    _middleware(
        "--reliability",
        metavar="QOS",
        help="reliable [dim](default)[/dim] or best_effort; same on both sides.",
    ),
]
Durability = Annotated[
    choices.Durability,
    _middleware(
        "--durability",
        metavar="QOS",
        help="volatile [dim](default)[/dim] or transient_local; same on both sides.",
    ),
]
History = Annotated[
    choices.History,
    _middleware("--history", metavar="QOS", help="keep_last [dim](default)[/dim] or keep_all."),
]
Depth = Annotated[
    int, _middleware("--depth", metavar="N", help="Messages that keep_last keeps. [dim]Default: 10[/dim]")
]
Deadline = Annotated[
    str | None,
    _middleware("--deadline", metavar="TIME", help="Between two messages at most: 20ms, 1.5s; both sides."),
]
Lifespan = Annotated[
    str | None,
    _middleware("--lifespan", metavar="TIME", help="Older messages are not delivered: 20ms, 1.5s."),
]
Serialization = Annotated[
    choices.Serialization,
    _middleware(
        "--serialization",
        metavar="KIND",
        help="raw [dim](default)[/dim]: the client library gets bytes; typed: message objects.",
    ),
]
Backend = Annotated[
    str,
    _middleware(
        "--backend",
        metavar="NAME",
        help=f"API that carries the messages: {', '.join(BACKEND_MODULES)}. [dim]Default: ros2[/dim]",
    ),
]
Rmw = Annotated[
    str | None,
    _middleware(
        "--rmw",
        metavar="NAME",
        help="ROS middleware to run on. [dim]Default: RMW_IMPLEMENTATION's, or ROS 2's[/dim]",
    ),
]
Transport = Annotated[
    choices.Transport,
    _middleware(
        "--transport",
        metavar="KIND",
        help="Of Fast DDS: default, udp, shm or large-data; of zenoh: default, shm, tcp; of socket: default (TCP), udp.",
    ),
]
Tuned = Annotated[
    bool, _middleware("--tuned", metavar="", help="Apply the vendor's settings for large messages.")
]
CongestionControl = Annotated[
    str | None,
    _middleware(
        "--congestion-control",
        metavar="NAME",
        help="Of TCP, for the backend socket: cubic, bbr, reno ... [dim]Default: the system's[/dim]",
    ),
]
Strict = Annotated[
    bool,
    _middleware(
        "--strict",
        metavar="",
        help="End, rather than warn, where the middleware does not use what was asked for (--transport, --tuned ...).",
    ),
]
Wire = Annotated[
    bool,
    _middleware(
        "--wire",
        metavar="",
        help="Count packets, repeats and bytes on the wire: of lo under localhost discovery, else of all interfaces "
        "that are up, in a namespace its own. Needs CAP_NET_RAW.",
    ),
]
NoOwnCost = Annotated[
    bool,
    _process(
        "--no-own-cost",
        metavar="",
        help="Start a second sooner: measure neither what recording costs nor the floor of the client library.",
    ),
]
Executor = Annotated[
    choices.ExecutorKind,
    _middleware(
        "--executor",
        metavar="KIND",
        help="Of rclpy: events, single, or auto [dim](default: the best)[/dim].",
    ),
]
CpuAffinity = Annotated[
    str | None, _process("--cpu-affinity", metavar="CPUS", help="Run on these alone: 3, or 0,2-3.")
]
Realtime = Annotated[
    int | None,
    _process("--realtime", metavar="PRIORITY", help="1 to 99: SCHED_FIFO, with all memory locked."),
]
Device = Annotated[
    str | None,
    _description("--device", metavar="NAME", help="Of this device. [dim]Default: its host name[/dim]"),
]
Connectivity = Annotated[
    str | None,
    _description(
        "--connectivity",
        metavar="NAME",
        help="loopback, wired, wireless, or your word. [dim]Default: looked up[/dim]",
    ),
]
Label = Annotated[
    list[str] | None,
    _description("--label", metavar="KEY=VALUE", help="Kept with a ping's run; repeatable."),
]
Setting = Annotated[
    list[str] | None,
    _description(
        "--setting",
        metavar="KEY=VALUE",
        help="What you set around a ping (a load, a link); runs of unlike settings are never summarized together.",
    ),
]
RelayId = Annotated[
    int | None,
    _description("--relay-id", metavar="N", help="A relay's number in the trace. [dim]Default: drawn[/dim]"),
]
Types = Annotated[
    list[str] | None,
    _relay(
        "--type",
        metavar="TYPE",
        help="Send this type back too: sensor_msgs/msg/PointCloud2, say; repeatable.",
    ),
]
RecoverPath = Annotated[
    Path | None,
    _tools("--recover", metavar="TRACE", help="Make a closed trace of what a killed recorder left, and end."),
]
SelfTest = Annotated[
    bool,
    _tools("--self-test", metavar="", help="Measure what recording itself costs on this machine, and end."),
]
Check = Annotated[
    bool,
    _tools(
        "--check",
        metavar="",
        help="Start as asked and end before the first message; keeps no trace. Ends with 0 if recording can begin.",
    ),
]
