"""`dds-record`: record one role of a measurement, as a ping or as a relay, into a trace."""

from __future__ import annotations

import json
import os
import signal
import threading
from enum import Enum
from pathlib import Path  # noqa: TC003 - typer reads the annotations
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.errors import run_command
from cli.record_tools import recover_trace, report_own_cost
from recorder import (
    DEFAULT_MESSAGES,
    DEFAULT_WARMUP,
    Discovery,
    ExecutorKind,
    NodeOptions,
    PingOptions,
    RecordOptions,
    Serialization,
    Transport,
    parse_duration,
    parse_size,
    record,
)
from tracefile import OptionError, Qos, TraceDestination

if TYPE_CHECKING:
    from recorder import Recorded

DEFAULT_DOMAIN = 10
BRIDGED_PING_DOMAIN = 5

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode="rich")


class Role(str, Enum):
    """Which end of the measurement this process is."""

    PING = "ping"
    RELAY = "relay"


class Reliability(str, Enum):
    """QoS reliability."""

    RELIABLE = "reliable"
    BEST_EFFORT = "best_effort"


class Durability(str, Enum):
    """QoS durability."""

    VOLATILE = "volatile"
    TRANSIENT_LOCAL = "transient_local"


class History(str, Enum):
    """QoS history."""

    KEEP_LAST = "keep_last"
    KEEP_ALL = "keep_all"


def _panel(title: str) -> Any:
    def option(*names: str, help: str, **more: Any) -> Any:  # noqa: A002 - typer's word
        return typer.Option(*names, help=help, rich_help_panel=title, show_default=False, **more)

    return option


_role, _message, _schedule = _panel("Role and output"), _panel("Message (ping)"), _panel("Schedule (ping)")
_middleware, _process = _panel("Middleware"), _panel("Process")
_description = _panel("Description in the trace")
_relay, _tools = _panel("Relay"), _panel("Instead of recording")


@app.command(context_settings={"help_option_names": ["-h", "--help"]})
def main_command(
    role: Annotated[
        Role | None,
        _role("--role", metavar="ROLE", help="[bold]ping[/bold] sends, [bold]relay[/bold] sends back."),
    ] = None,
    out: Annotated[
        Path | None,
        _role("--out", metavar="PATH", help="A [bold].mcap[/bold] file, or the name of a rosbag2 folder."),
    ] = None,
    force: Annotated[bool, _role("--force", metavar="", help="Overwrite what is there.")] = False,
    fsync: Annotated[
        bool,
        _role("--fsync", metavar="", help="Have each second of the trace on the disk, not in its cache."),
    ] = False,
    duration: Annotated[
        float | None, _role("--duration", metavar="SECONDS", help="End then. A relay goes on until stopped.")
    ] = None,
    as_json: Annotated[bool, _role("--json", metavar="", help="Print the result as JSON.")] = False,
    data: Annotated[
        str | None,
        _message(
            "--data",
            metavar="KIND",
            help="binary [dim](default)[/dim], string, imu, file:PATH (or a folder's files), bag:PATH#TOPIC, or "
            "topic:/NAME (live).",
        ),
    ] = None,
    size: Annotated[
        str | None,
        _message(
            "--size",
            metavar="SIZE",
            help="Bytes: 33KB, 4MB (1000), 1KiB (1024), or a number. "
            "[dim]Default: 33KB; string 91; imu always 296[/dim]",
        ),
    ] = None,
    seed: Annotated[
        int | None, _message("--seed", metavar="N", help="Of the random content. [dim]Default: drawn[/dim]")
    ] = None,
    rate: Annotated[
        float | None,
        _schedule(
            "--rate", metavar="HZ", help="Messages a second. [dim]Default: 10; of a bag its own rate[/dim]"
        ),
    ] = None,
    messages: Annotated[
        int | None,
        _schedule(
            "--messages",
            metavar="N",
            help=f"Messages to measure. [dim]Default: {DEFAULT_MESSAGES}, or what fits --duration[/dim]",
        ),
    ] = None,
    warmup: Annotated[
        int | None,
        _schedule(
            "--warmup",
            metavar="N",
            help=f"Messages before, which do not count. [dim]Default: {DEFAULT_WARMUP}[/dim]",
        ),
    ] = None,
    wait: Annotated[
        float | None,
        _schedule("--wait", metavar="SECONDS", help="For a first echo. [dim]Default: 20[/dim]"),
    ] = None,
    relays: Annotated[
        int | None, _schedule("--relays", metavar="N", help="Relays to wait for. [dim]Default: 1[/dim]")
    ] = None,
    domain: Annotated[
        int | None,
        _middleware(
            "--domain",
            metavar="ID",
            help="DDS domain. [dim]Default: ROS_DOMAIN_ID, else 10; a ping with --bridge: 5[/dim]",
        ),
    ] = None,
    bridge: Annotated[
        str | None,
        _middleware("--bridge", metavar="NAME", help="Start this bridge to the relay's domain, say builtin."),
    ] = None,
    bridge_running: Annotated[
        bool, _middleware("--bridge-running", metavar="", help="That bridge is up already: start nothing.")
    ] = False,
    bridge_listen: Annotated[
        str | None,
        _middleware(
            "--bridge-listen",
            metavar="ADDRESS",
            help="Start the ping's half alone; it waits at HOST:PORT for the relay's (dds-bridge --half relay).",
        ),
    ] = None,
    bridge_peer: Annotated[
        list[str] | None,
        _middleware(
            "--bridge-peer",
            metavar="ADDRESS",
            help="Likewise, but it goes to the other half at HOST:PORT; repeatable.",
        ),
    ] = None,
    relay_domain: Annotated[
        int | None,
        _middleware(
            "--relay-domain",
            metavar="ID",
            help="Domain behind the bridge. [dim]Default: ROS_DOMAIN_ID, else 10[/dim]",
        ),
    ] = None,
    discovery: Annotated[
        Discovery | None,
        _middleware(
            "--discovery",
            metavar="RANGE",
            help="localhost or subnet. [dim]Default: what ROS 2's environment says, else subnet[/dim]",
        ),
    ] = None,
    peer: Annotated[
        list[str] | None,
        _middleware(
            "--peer",
            metavar="HOST",
            help="Device of a relay, or HOST:PORT, where a backend does not look for it (socket, zenoh); repeatable.",
        ),
    ] = None,
    reliability: Annotated[
        Reliability,
        _middleware(
            "--reliability",
            metavar="QOS",
            help="reliable [dim](default)[/dim] or best_effort; same on both sides.",
        ),
    ] = Reliability.RELIABLE,
    durability: Annotated[
        Durability,
        _middleware(
            "--durability",
            metavar="QOS",
            help="volatile [dim](default)[/dim] or transient_local; same on both sides.",
        ),
    ] = Durability.VOLATILE,
    history: Annotated[
        History, _middleware("--history", metavar="QOS", help="keep_last [dim](default)[/dim] or keep_all.")
    ] = History.KEEP_LAST,
    depth: Annotated[
        int, _middleware("--depth", metavar="N", help="Messages that keep_last keeps. [dim]Default: 10[/dim]")
    ] = 10,
    deadline: Annotated[
        str | None,
        _middleware(
            "--deadline", metavar="TIME", help="Between two messages at most: 20ms, 1.5s; both sides."
        ),
    ] = None,
    lifespan: Annotated[
        str | None,
        _middleware("--lifespan", metavar="TIME", help="Older messages are not delivered: 20ms, 1.5s."),
    ] = None,
    serialization: Annotated[
        Serialization,
        _middleware(
            "--serialization",
            metavar="KIND",
            help="raw [dim](default)[/dim]: the client library gets bytes; typed: message objects.",
        ),
    ] = Serialization.RAW,
    backend: Annotated[
        str,
        _middleware(
            "--backend", metavar="NAME", help="API that carries the messages. [dim]Default: ros2[/dim]"
        ),
    ] = "ros2",
    rmw: Annotated[
        str | None,
        _middleware(
            "--rmw",
            metavar="NAME",
            help="ROS middleware to run on. [dim]Default: RMW_IMPLEMENTATION's, or ROS 2's[/dim]",
        ),
    ] = None,
    transport: Annotated[
        Transport,
        _middleware(
            "--transport",
            metavar="KIND",
            help="Of Fast DDS: default, udp, shm or large-data; of socket: default (TCP), udp.",
        ),
    ] = Transport.DEFAULT,
    tuned: Annotated[
        bool, _middleware("--tuned", metavar="", help="Apply the vendor's settings for large messages.")
    ] = False,
    executor: Annotated[
        ExecutorKind,
        _middleware(
            "--executor",
            metavar="KIND",
            help="Of rclpy: events, single, or auto [dim](default: the best)[/dim].",
        ),
    ] = ExecutorKind.AUTO,
    cpu_affinity: Annotated[
        str | None, _process("--cpu-affinity", metavar="CPUS", help="Run on these alone: 3, or 0,2-3.")
    ] = None,
    realtime: Annotated[
        int | None,
        _process("--realtime", metavar="PRIORITY", help="1 to 99: SCHED_FIFO, with all memory locked."),
    ] = None,
    device: Annotated[
        str | None,
        _description("--device", metavar="NAME", help="Of this device. [dim]Default: its host name[/dim]"),
    ] = None,
    connectivity: Annotated[
        str | None,
        _description(
            "--connectivity",
            metavar="NAME",
            help="loopback, wired, wireless, or your word. [dim]Default: looked up[/dim]",
        ),
    ] = None,
    label: Annotated[
        list[str] | None,
        _description("--label", metavar="KEY=VALUE", help="Kept with a ping's run; repeatable."),
    ] = None,
    relay_id: Annotated[
        int | None,
        _description(
            "--relay-id", metavar="N", help="A relay's number in the trace. [dim]Default: drawn[/dim]"
        ),
    ] = None,
    types: Annotated[
        list[str] | None,
        _relay(
            "--type",
            metavar="TYPE",
            help="Send this type back too: sensor_msgs/msg/PointCloud2, say; repeatable.",
        ),
    ] = None,
    recover_path: Annotated[
        Path | None,
        _tools(
            "--recover", metavar="TRACE", help="Make a closed trace of what a killed recorder left, and end."
        ),
    ] = None,
    self_test: Annotated[
        bool,
        _tools(
            "--self-test", metavar="", help="Measure what recording itself costs on this machine, and end."
        ),
    ] = False,
) -> None:
    """Record latency of ROS 2 / DDS messages as a ping or as a relay.

    A ping sends messages on a fixed schedule, a relay sends them back; each writes a trace of its time stamps.
    Start one of each, on one device or on two, then run [bold]dds-analyze[/bold] on the folder with the traces:

    [bold]dds-record --role relay --out relay.mcap[/bold]

    [bold]dds-record --role ping  --out ping.mcap[/bold]
    """
    if recover_path is not None:
        recover_trace(recover_path)
        return
    discovery = discovery or default_discovery()
    if self_test:
        domain = default_domain() if domain is None else domain
        report_own_cost(out, backend, NodeOptions(domain, discovery=discovery, executor=executor, rmw=rmw))
        return
    if role is None or out is None:
        raise OptionError("give --role ping or --role relay, and --out PATH for its trace (see --help)")
    of_ping = {
        "--data": data,
        "--size": size,
        "--seed": seed,
        "--rate": rate,
        "--messages": messages,
        "--warmup": warmup,
        "--wait": wait,
        "--relays": relays,
        "--bridge": bridge,
        "--relay-domain": relay_domain,
        "--bridge-running": bridge_running or None,
        "--bridge-listen": bridge_listen,
        "--bridge-peer": bridge_peer or None,
        "--label": label or None,
    }
    of_relay = {"--relay-id": relay_id, "--type": types or None}
    _refuse_others(role, of_relay if role is Role.PING else of_ping)
    is_bridged = bridge not in (None, "none")
    if domain is None:
        domain = BRIDGED_PING_DOMAIN if is_bridged else default_domain()
    if is_bridged and relay_domain is None:
        relay_domain = default_domain()
    ping = PingOptions(
        data="binary" if data is None else data,
        size_bytes=None if size is None else parse_size(size),
        rate_hz=rate,
        messages=messages,
        warmup=DEFAULT_WARMUP if warmup is None else warmup,
        wait_s=20.0 if wait is None else wait,
        relays=1 if relays is None else relays,
        seed=seed,
        bridge=bridge or "none",
        bridge_running=bridge_running,
        bridge_listen=bridge_listen,
        bridge_peers=tuple(bridge_peer or ()),
        relay_domain_id=relay_domain,
        labels=parse_labels(label or []),
    )
    options = RecordOptions(
        destination=TraceDestination(out, force=force, fsync=fsync),
        node=NodeOptions(
            domain_id=domain,
            discovery=discovery,
            qos=Qos(
                reliability.value,
                durability.value,
                history.value,
                depth,
                _duration_policies(deadline, lifespan),
            ),
            executor=executor,
            rmw=rmw,
            transport=transport,
            tuned=tuned,
            peers=tuple(peer or ()),
        ),
        ping=ping if role is Role.PING else None,
        backend=backend,
        serialization=serialization,
        relay_id=relay_id,
        types=tuple(types or ()),
        device=device,
        connectivity=connectivity,
        duration_s=duration,
        cpu_affinity=cpu_affinity,
        realtime_priority=realtime,
    )
    _report(_record(options), as_json=as_json)


def _refuse_others(role: Role, others: dict[str, Any]) -> None:
    """An option of the other role would be ignored, and its user believes otherwise."""
    given = [name for name, value in others.items() if value is not None]
    if given:
        raise OptionError(f"{', '.join(given)} cannot be given to a {role.value}, only to the other role")


def _duration_policies(deadline: str | None, lifespan: str | None) -> dict[str, int]:
    """What was given, in ns, as it stands in the trace."""
    given = {"deadline_ns": deadline, "lifespan_ns": lifespan}
    return {name: parse_duration(text) for name, text in given.items() if text is not None}


def default_domain() -> int:
    """ROS_DOMAIN_ID, else 10.

    Raises:
        OptionError: the variable is set to no number.
    """
    text = os.environ.get("ROS_DOMAIN_ID", "").strip()
    if not text:
        return DEFAULT_DOMAIN
    if not text.isdecimal():
        raise OptionError(f"ROS_DOMAIN_ID is {text!r}, which is no domain id; set a number or unset it")
    return int(text)


def default_discovery() -> Discovery:
    """What the environment of ROS 2 says, else the subnet."""
    is_local = (
        os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "LOCALHOST"
        or os.environ.get("ROS_LOCALHOST_ONLY") == "1"
    )
    return Discovery.LOCALHOST if is_local else Discovery.SUBNET


def parse_labels(texts: list[str]) -> dict[str, str]:
    """The labels in `KEY=VALUE` texts.

    Raises:
        OptionError: one of them has no key or no `=`.
    """
    labels = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not key or not equals:
            raise OptionError(f"--label {text!r}: write KEY=VALUE")
        labels[key] = value
    return labels


def _record(options: RecordOptions) -> Recorded:
    """Record until done; Ctrl-C and SIGTERM end it with a closed trace, however often they come."""
    from cli.progress import TerminalWatch

    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    with TerminalWatch() as watch:
        return record(options, stop, watch)


def _report(recorded: Recorded, *, as_json: bool) -> None:
    """Print what was written.

    Raises:
        OutputError: not all of it could be.
    """
    from cli.progress import describe_progress

    trace = recorded.trace
    if as_json:
        print(json.dumps(_result(recorded)))
    else:
        print(f"Wrote {trace.path}")
        print(
            f"{describe_progress(recorded.progress)}; {trace.events} events, {trace.dropped_events} dropped"
        )
    if trace.error is not None:
        raise trace.error


def _result(recorded: Recorded) -> dict[str, Any]:
    """The JSON object of `--json`."""
    from dataclasses import asdict

    session, run, trace = recorded.session, recorded.run, recorded.trace
    return {
        "path": str(trace.path),
        "role": session.role,
        "session_id": f"{session.session_id:016x}",
        "run_id": None if run is None else f"{run.run_id:016x}",
        "relay_id": session.relay_id,
        "events": trace.events,
        "dropped_events": trace.dropped_events,
        "bytes": trace.bytes,
        "error": None if trace.error is None else str(trace.error),
        **asdict(recorded.progress),
    }


def main() -> None:
    """The entry point of `dds-record`."""
    run_command(app)


if __name__ == "__main__":
    main()
