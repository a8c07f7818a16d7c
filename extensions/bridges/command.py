"""`dds-trace bridge`: run one bridge between two DDS domains, or show what it would run with."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any

from dds_trace.cli.program import argument, command, make_app, option, starting
from dds_trace.cli.table_options import default_discovery, given_values, read_record, with_options
from dds_trace.recorder.choices import Side
from dds_trace.recorder.option_table import CommandOptions

from . import BRIDGE_MODULES

if TYPE_CHECKING:
    from .base import Bridge, BridgeOptions
    from .running import RunningBridge

LOOK_S = 0.2

app = make_app()


_SHARED = ("discovery", "reliability", "durability", "depth", "deadline", "lifespan", "tuned")


@command(
    app,
    "bridge",
    table="bridge",
    often=("shows_configuration", "check", "from_domain", "to_domain", "topics", "half", "listen", "peer"),
)
@with_options(_SHARED)
def bridge_command(
    name: Annotated[str, argument("NAME", f"{', '.join(BRIDGE_MODULES)}.", autocompletion=starting(BRIDGE_MODULES))],
    shows_configuration: Annotated[
        bool, option("--config", "Print the bridge's configuration and run nothing.")
    ] = False,
    check: Annotated[
        bool, option("--check", "Check that the program is here and takes these options; run nothing.")
    ] = False,
    from_domain: Annotated[int, option("--from ID", "Domain of the ping. Default: 5")] = 5,
    to_domain: Annotated[int, option("--to ID", "Domain of the relay. Default: 10")] = 10,
    topics: Annotated[
        list[str] | None, option("--topic NAME:TYPE", "Carry this topic and NAME_relay, its way back; repeatable.")
    ] = None,
    half: Annotated[
        Side | None, option("--half ROLE", "Run only the half of ping or relay, with --listen or --peer.")
    ] = None,
    listen: Annotated[
        str | None, option("--listen HOST:PORT", "Address at which this half waits for the other.")
    ] = None,
    peer: Annotated[
        list[str] | None, option("--peer HOST:PORT", "Address at which the other half waits; repeatable.")
    ] = None,
    **values: Any,
) -> None:
    """Run a bridge between two DDS domains until Ctrl-C.

    `dds-trace record ping --bridge NAME` does this around a recording, `dds-trace doctor` lists the installed ones. A bridge of two halves runs one on each device:

        dds-trace bridge zenoh-bridge-dds --half ping --listen 0.0.0.0:7447

        dds-trace bridge zenoh-bridge-dds --half relay --peer 192.168.0.5:7447
    """
    from .base import BRIDGED_TOPICS, BridgeOptions, Half, bridged_topic, load_bridge

    chosen = given_values(values)
    options = BridgeOptions(
        from_domain,
        to_domain,
        topics=(*BRIDGED_TOPICS, *map(bridged_topic, topics or ())),
        qos=read_record(CommandOptions, chosen).qos,
        discovery=chosen.get("discovery") or default_discovery(),
        tuned=chosen.get("tuned", False),
        half=Half.BOTH if half is None else Half(half.value),
        listen=listen,
        peers=tuple(peer or ()),
    )
    if check:
        _check(load_bridge(name), options)
    elif shows_configuration:
        _print_configuration(load_bridge(name), options)
    else:
        _run(name, options)


def _print_configuration(bridge: Bridge, options: BridgeOptions) -> None:
    from .base import split_halves

    parts = split_halves(bridge, options)
    for part in parts:
        if len(parts) > 1:
            print(f"# the {part.half.value}'s half, domain {part.sides()[0].domain_id}", file=sys.stderr)
        print(bridge.configuration(part), end="", flush=True)


def _check(bridge: Bridge, options: BridgeOptions) -> None:
    from .base import split_halves
    from .running import find_program

    program = find_program(bridge)
    for part in split_halves(bridge, options):
        bridge.configuration(part)
    print(f"{bridge.name} can run: {program}")


def _run(name: str, options: BridgeOptions) -> None:
    from dds_trace.recorder.host.process import stop_at_signals

    from .running import open_bridge

    stop = stop_at_signals()
    with open_bridge(name, options) as bridge:
        print(f"{name} runs: {_describe(bridge)}; Ctrl-C ends it", file=sys.stderr)
        while bridge.failure is None and not stop.wait(LOOK_S):
            pass
        if bridge.failure is not None:
            print(bridge.log_tail(), file=sys.stderr)
        bridge.check()


def _describe(bridge: RunningBridge) -> str:
    parts = []
    for part, pid in zip(bridge.parts, bridge.processes.values(), strict=True):
        domains = " and ".join(str(side.domain_id) for side in part.sides())
        parts.append(f"domain {domains}, pid {pid}")
    return "; ".join(parts)


def installed() -> Iterator[tuple[str, str, bool, str]]:
    """Yield the checks of `doctor`: each bridge, and its version here or how to install it."""
    from .base import load_bridge

    for bridge in map(load_bridge, BRIDGE_MODULES):
        program = bridge.find()
        detail = bridge.install if program is None else bridge.version(program) or str(program)
        yield "bridges", bridge.name, program is not None, f"{detail} (tried: {bridge.tried})"
