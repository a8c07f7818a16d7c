"""`dds-record`: record one role of a measurement, as a ping or as a relay, into a trace."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer  # noqa: TC002 - it reads the annotation

from dds_trace.recorder import choices

from ..program import run_program
from ..quick_help import Version, command_app, declare_command
from . import status, words
from .passed_over import passes_over

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from dds_trace.recorder.options import RecordOptions

BRIDGED_PING_DOMAIN = 5

app = command_app(completes=True)


@declare_command(app, "record", passes_over)
def main_command(
    context: typer.Context,
    role: words.Role = None,
    out: words.Out = None,
    force: words.Force = False,
    fsync: words.Fsync = False,
    file_mode: words.FileMode = choices.FileMode.GROUP,
    keep_free: words.KeepFree = None,
    duration: words.Duration = None,
    as_json: words.AsJson = False,
    data: words.Data = None,
    size: words.Size = None,
    seed: words.Seed = None,
    rate: words.Rate = None,
    messages: words.Messages = None,
    warmup: words.Warmup = None,
    wait: words.Wait = None,
    fail_if_lost: words.FailIfLost = None,
    relays: words.Relays = None,
    domain: words.Domain = None,
    bridge: words.Bridge = None,
    bridge_running: words.BridgeRunning = False,
    bridge_listen: words.BridgeListen = None,
    bridge_peer: words.BridgePeer = None,
    relay_domain: words.RelayDomain = None,
    discovery: words.Discovery = None,
    peer: words.Peer = None,
    reliability: words.Reliability = choices.Reliability.RELIABLE,
    durability: words.Durability = choices.Durability.VOLATILE,
    history: words.History = choices.History.KEEP_LAST,
    depth: words.Depth = 10,
    deadline: words.Deadline = None,
    lifespan: words.Lifespan = None,
    serialization: words.Serialization = choices.Serialization.RAW,
    backend: words.Backend = "ros2",
    rmw: words.Rmw = None,
    transport: words.Transport = choices.Transport.DEFAULT,
    tuned: words.Tuned = False,
    congestion_control: words.CongestionControl = None,
    strict: words.Strict = False,
    wire: words.Wire = False,
    no_own_cost: words.NoOwnCost = False,
    executor: words.Executor = choices.ExecutorKind.AUTO,
    cpu_affinity: words.CpuAffinity = None,
    realtime: words.Realtime = None,
    device: words.Device = None,
    connectivity: words.Connectivity = None,
    label: words.Label = None,
    setting: words.Setting = None,
    relay_id: words.RelayId = None,
    types: words.Types = None,
    rotate: words.Rotate = None,
    keep: words.Keep = None,
    recover_path: words.RecoverPath = None,
    self_test: words.SelfTest = False,
    check: words.Check = False,
    version: Version = False,  # noqa: ARG001 - its callback does it
) -> None:
    """Record latency of ROS 2 / DDS messages as a ping or as a relay.

    A ping sends messages on a fixed schedule, a relay sends them back; each writes a trace of its time stamps.
    Start one of each, on one device or on two, then run [bold]dds-analyze[/bold] on the folder with the traces:

    [bold]dds-record --role relay --out relay.mcap[/bold]

    [bold]dds-record --role ping  --out ping.mcap[/bold]

    What records on this machine now:

    [bold]dds-record status[/bold]
    """
    from dds_trace.base import limits
    from dds_trace.base.errors import OptionError
    from dds_trace.base.units import parse_size
    from dds_trace.recorder.backends import load_backend
    from dds_trace.recorder.backends.node import NodeOptions
    from dds_trace.recorder.options import DEFAULT_WARMUP, PingOptions, RecordOptions, check_fields
    from dds_trace.tracefile.format.descriptions import Qos
    from dds_trace.tracefile.writing.destination import TraceDestination

    from .run import print_result, record_until_stopped
    from .tools import check_start, recover_trace, report_own_cost
    from .values import (
        default_discovery,
        default_domain,
        parse_durations,
        parse_keep_free,
        parse_pairs,
        parse_percentage,
        parse_rotation,
        refuse_others,
    )

    if recover_path is not None:
        limits.check(limits.INPUT, str(recover_path), "--recover")
        recover_trace(recover_path)
        return
    if discovery is None:
        discovery = default_discovery()
    if self_test:
        domain = default_domain() if domain is None else domain
        node = NodeOptions(domain, discovery=discovery, executor=executor, rmw=rmw)
        limits.check(limits.PATH, None if out is None else str(out), "--out")
        check_fields(node)
        load_backend(backend)
        report_own_cost(out, backend, node)
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
        "--fail-if-lost": fail_if_lost,
        "--relays": relays,
        "--bridge": bridge,
        "--relay-domain": relay_domain,
        "--bridge-running": bridge_running or None,
        "--bridge-listen": bridge_listen,
        "--bridge-peer": bridge_peer or None,
        "--label": label or None,
        "--setting": setting or None,
    }
    of_relay = {"--relay-id": relay_id, "--type": types or None, "--rotate": rotate, "--keep": keep}
    refuse_others(role.value, of_relay if role is choices.Role.PING else of_ping)
    allowed = None if fail_if_lost is None else parse_percentage("--fail-if-lost", fail_if_lost)
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
        labels=parse_pairs("--label", label or [], "site=lab"),
        settings=parse_pairs("--setting", setting or [], "cpu_load=50%"),
    )
    options = RecordOptions(
        destination=TraceDestination(out, force=force, fsync=fsync, mode=file_mode.bits),
        node=NodeOptions(
            domain_id=domain,
            discovery=discovery,
            qos=Qos(
                reliability.value,
                durability.value,
                history.value,
                depth,
                parse_durations(deadline_ns=deadline, lifespan_ns=lifespan),
            ),
            executor=executor,
            rmw=rmw,
            transport=transport,
            tuned=tuned,
            congestion_control=congestion_control,
            peers=tuple(peer or ()),
        ),
        ping=ping if role is choices.Role.PING else None,
        backend=backend,
        serialization=serialization,
        relay_id=relay_id,
        types=tuple(types or ()),
        device=device,
        connectivity=connectivity,
        duration_s=duration,
        cpu_affinity=cpu_affinity,
        realtime_priority=realtime,
        strict=strict,
        wire=wire,
        own_cost=not no_own_cost,
        rotation=parse_rotation(rotate, keep),
        keep_free=parse_keep_free(keep_free),
    )
    take: Callable[[RecordOptions], None] | None = context.obj
    if take is not None:  # of a sweep, which looks at the options of each cell before it starts any
        take(options)
    elif check:
        check_start(options)
    else:
        print_result(record_until_stopped(options), as_json=as_json, fail_if_lost=allowed)


COMMANDS: Mapping[str, typer.Typer] = {"status": status.app}
"""Name -> command; anything else as first argument belongs to the command without a name."""


def main() -> None:
    """Run `dds-record` with the arguments of the process."""
    run_program("dds-record", app, COMMANDS, None)


if __name__ == "__main__":
    main()
