"""`dds-record`: record as a ping, a relay, a tap or a beacon into a trace."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import typer  # noqa: TC002 - it reads the annotation

from dds_trace.recorder.choices import Role
from dds_trace.recorder.option_table import OPTIONS, CommandOptions

from ..program import ask_about_folder, run_program
from ..quick_help import Version, command_app, declare_command
from ..table_options import default_discovery, default_domain, given_values, overridden, read_record, with_options
from . import status

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from dds_trace.recorder.options import RecordOptions

BRIDGED_PING_DOMAIN = 5

app = command_app(completes=True)


_DEFAULTS = {name: row.field_default for name, row in OPTIONS.items() if row.metavar and not row.default}


@declare_command(app, "record", overridden, _DEFAULTS)
@with_options(OPTIONS, in_panels=True)
def main_command(
    context: typer.Context,
    version: Version = False,  # noqa: ARG001 - its callback does it
    **values: Any,
) -> None:
    """Record latency of ROS 2 / DDS messages as a ping or as a relay, or of the topics of others as a tap.

    A ping sends messages on a fixed schedule, a relay sends them back; each writes a trace of its time stamps.
    Start one of each, on one device or on two, then run `dds-analyze` on the folder with the traces:

        dds-record --role relay --out relay.mcap

        dds-record --role ping  --out ping.mcap

    On any device of a running system, its own topics:

        dds-record --role tap --topics /scan --out tap.mcap

    What records on this machine now:

        dds-record status
    """
    from dds_trace.base import limits
    from dds_trace.base.errors import OptionError
    from dds_trace.recorder.backends import load_backend
    from dds_trace.recorder.backends.base import Meeting
    from dds_trace.recorder.backends.node import NodeOptions
    from dds_trace.recorder.options import check_fields

    from .run import record_until_stopped
    from .tools import check_start, recover_trace, report_own_cost

    chosen = given_values(values)
    if recover_path := chosen.get("recover_path"):
        limits.check(limits.INPUT, str(recover_path), "--recover")
        out = chosen.get("out")
        limits.check(limits.PATH, None if out is None else str(out), "--out")
        recover_trace(recover_path, out)
        return
    command = read_record(CommandOptions, chosen)
    backend = load_backend(chosen.get("backend", OPTIONS["backend"].field_default))
    # Where a relay listens at an address, other devices reach it only on request.
    is_open = backend.meeting is not Meeting.PEERS or bool(chosen.get("peers"))
    chosen.setdefault("discovery", default_discovery(is_open=is_open))
    if command.self_test:
        chosen.setdefault("domain_id", default_domain())
        node = read_record(NodeOptions, chosen)
        limits.check(limits.PATH, None if command.out is None else str(command.out), "--out")
        check_fields(node)
        report_own_cost(command.out, backend.name, node)
        return
    if command.role is None or command.out is None:
        raise OptionError("give --role ping, relay, tap or beacon, and --out PATH for its trace (see --help)")
    _refuse_other_role(command.role, chosen)
    options = _record_options(command, chosen)
    take: Callable[[RecordOptions], None] | None = context.obj
    if take is not None:  # a sweep checks all recordings before the first
        take(options)
    elif command.check:
        check_start(options)
    else:
        if command.out.suffix != ".mcap":
            ask_about_folder(command.out, "a rosbag2 recording; one file is NAME.mcap")
        gates = []
        if command.limits_path is not None:
            from ..limits_file import read_limits

            gates = read_limits(command.limits_path, of_recording=True)
        record_until_stopped(options, as_json=command.as_json, fail_if_lost=command.fail_if_lost, gates=gates)


def _refuse_other_role(role: Role, chosen: Mapping[str, Any]) -> None:
    from dds_trace.base.errors import OptionError

    rows = [OPTIONS[name] for name in chosen if OPTIONS[name].roles and role not in OPTIONS[name].roles]
    if rows:
        others = dict.fromkeys(other.value for row in rows for other in row.roles)
        raise OptionError(
            f"{', '.join(row.name for row in rows)} cannot be given to a {role.value}, only to a {' or '.join(others)}; remove "
            f"{'it' if len(rows) == 1 else 'them'}"
        )


def _record_options(command: CommandOptions, chosen: dict[str, Any]) -> RecordOptions:
    from dds_trace.base.errors import OptionError
    from dds_trace.recorder.backends.node import NodeOptions
    from dds_trace.recorder.options import BEACON_RATE_HZ, PingOptions, RecordOptions, TapOptions
    from dds_trace.recorder.tap.tap import chosen_qos
    from dds_trace.tracefile.writing.destination import TraceDestination

    assert command.out is not None
    if command.for_s is not None:
        if "duration_s" in chosen:
            raise OptionError("--for is another name of --duration: give one of them")
        chosen["duration_s"] = command.for_s
    is_bridged = chosen.get("bridge", "none") != "none"
    chosen.setdefault("domain_id", BRIDGED_PING_DOMAIN if is_bridged else default_domain())
    if is_bridged:
        chosen.setdefault("relay_domain_id", default_domain())
    options = read_record(
        RecordOptions,
        chosen,
        destination=TraceDestination(
            command.out, force=command.force, fsync=command.fsync, mode=command.file_mode.bits
        ),
        node=read_record(NodeOptions, chosen, qos=command.qos),
        ping=read_record(PingOptions, chosen) if command.role is Role.PING else None,
        tap=read_record(TapOptions, chosen) if command.role is Role.TAP else None,
        tap_qos=chosen_qos(chosen.get("reliability"), chosen.get("durability"), chosen.get("depth")),
        beacon_rate_hz=OPTIONS["rate_hz"].read(chosen.get("rate_hz", BEACON_RATE_HZ))
        if command.role is Role.BEACON
        else None,
    )
    if command.keep is None:
        return options
    if options.rotation is None:
        raise OptionError("--keep counts the files of --rotate: give both, for example --rotate 1GB,1h --keep 20")
    return replace(options, rotation=replace(options.rotation, keep=command.keep))


COMMANDS: Mapping[str, typer.Typer] = {"status": status.app}
"""Any other first argument belongs to the command without a name."""


def main(
    arguments: Sequence[str] | None = None, *, name: str = "dds-record", adapt: Callable[[Any], object] | None = None
) -> None:
    run_program(name, app, COMMANDS, arguments, adapt=adapt, needs_stdout=False)


if __name__ == "__main__":
    main()
