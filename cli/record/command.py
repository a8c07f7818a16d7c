"""`dds-trace record ROLE`, and `dds-record --role ROLE`: record as a ping, a relay, a tap or a beacon into a trace."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import typer

from dds_trace.base.errors import OptionError
from dds_trace.base.extension import load
from dds_trace.base.streams import say
from dds_trace.recorder.backends import load_backend
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Role
from dds_trace.recorder.option_table import OFTEN, OPTIONS, CommandOptions, flag_of, is_setting, key_of, settings_of
from dds_trace.recorder.options import BEACON_RATE_HZ, PingOptions, RecordOptions, TapOptions, chosen_qos

from .. import table_options
from ..program import Version, ask_about_folder, command, make_app

BRIDGED_PING_DOMAIN = 5

_DEFAULTS = {name: row.field_default for name, row in OPTIONS.items() if row.metavar and not row.default}
_OFTEN = ("role", *(name for name, row in OPTIONS.items() if row.name[2:] in OFTEN[Role.PING]))

app = make_app(completes=True)


@command(app, "record", table="record", often=_OFTEN, overridden=table_options.overridden, defaults=_DEFAULTS)
@table_options.with_options(OPTIONS, is_setting)
def record_command(
    context: typer.Context,
    settings_given: table_options.SettingsOption = None,  # noqa: ARG001 - read before
    version: Version = False,  # noqa: ARG001 - its callback does it
    **values: Any,
) -> None:
    """Record latency of ROS 2 / DDS messages, as `dds-trace record ROLE` does."""
    _record(context, table_options.given_values(values))


_HELP = {
    Role.PING: "Send messages on a schedule, and record what a relay sends back.",
    Role.RELAY: "Send messages back, and record them (Ctrl-C to stop).",
    Role.TAP: "Record latency and loss of topics that other programs publish.",
    Role.BEACON: "Align the clocks of several devices: run one on each.",
}


def role_app(role: Role, names: Iterable[str]) -> typer.Typer:
    app = make_app()

    def record_role(context: typer.Context, settings_given: table_options.SettingsOption = None, **values: Any) -> None:  # noqa: ARG001 - read before
        _record(context, {"role": role, **table_options.given_values(values)})

    record_role.__doc__ = _HELP[role]
    keys = [row.name.lstrip("-") for row in OPTIONS.values()]
    settings: Any = {"table": "record", "ignored": keys, "defaults": _DEFAULTS}
    declare = command(
        app, role.value, overridden=lambda values: table_options.overridden({"role": role, **values}), **settings
    )
    declare(table_options.with_options(names, lambda row: is_setting(row, role))(record_role))
    return app


ping, relay, tap, beacon = (
    role_app(role, [name for name, row in OPTIONS.items() if name != "role" and role in (row.roles or Role)])
    for role in Role
)


def _record(context: typer.Context, chosen: dict[str, Any]) -> None:
    from dds_trace.recorder.backends.base import Meeting
    from dds_trace.recorder.recording import rehearse

    from .run import TerminalWatch, record_until_stopped

    command = table_options.read_record(CommandOptions, chosen)
    backend = load_backend(chosen.get("backend", OPTIONS["backend"].field_default))
    # Where a relay listens at an address, other devices reach it only on request.
    is_open = backend.meeting is not Meeting.PEERS or bool(chosen.get("peers"))
    chosen.setdefault("discovery", table_options.default_discovery(is_open=is_open))
    if command.role is None or command.out is None:
        role = "" if command.role else "--role ping, relay, tap or beacon, and "
        raise OptionError(f"give {role}--out PATH for its trace (see --help)")
    table_options.refuse_other_role(command.role, {OPTIONS[name].name: OPTIONS[name] for name in chosen})
    options = _record_options(command, chosen)
    take: Callable[[RecordOptions], None] | None = context.obj
    if take is not None:  # a sweep checks all recordings before the first
        take(options)
    elif command.check:
        with TerminalWatch() as watch:
            rehearse(options, watch)
        print(f"a {command.role.value} can begin")
    else:
        if command.out.suffix != ".mcap":
            ask_about_folder(command.out, "a rosbag2 recording; one file is NAME.mcap")
        gates = []
        if command.limits_path is not None:
            gates = load("parts", "read_limits")(command.limits_path, of_recording=True)
        record_until_stopped(options, as_json=command.as_json, fail_if_lost=command.fail_if_lost, gates=gates)


def _record_options(command: CommandOptions, chosen: dict[str, Any]) -> RecordOptions:
    from dds_trace.recorder.domains import default_domain
    from dds_trace.tracefile.writing.destination import TraceDestination

    assert command.out is not None
    is_bridged = chosen.get("bridge", "none") != "none"
    joins_robot = command.role in (Role.TAP, Role.BEACON)
    chosen.setdefault("domain_id", BRIDGED_PING_DOMAIN if is_bridged else default_domain(joins_robot=joins_robot))
    if is_bridged:
        chosen.setdefault("relay_domain_id", default_domain())
    options = table_options.read_record(
        RecordOptions,
        chosen,
        destination=TraceDestination(
            command.out, force=command.force, fsync=command.fsync, mode=command.file_mode.bits
        ),
        node=table_options.read_record(NodeOptions, chosen, qos=command.qos),
        ping=table_options.read_record(PingOptions, chosen) if command.role is Role.PING else None,
        tap=table_options.read_record(TapOptions, chosen) if command.role is Role.TAP else None,
        tap_qos=chosen_qos(chosen.get("reliability"), chosen.get("durability"), chosen.get("depth")),
        beacon_rate_hz=OPTIONS["rate_hz"].read(chosen.get("rate_hz", BEACON_RATE_HZ))
        if command.role is Role.BEACON
        else None,
    )
    if command.keep is None:
        return options
    if options.rotation is None:
        raise OptionError("-o keep counts the files of rotate: give both, for example -o rotate=1GB,1h -o keep=20")
    return replace(options, rotation=replace(options.rotation, keep=command.keep))


def words_of_role(words: Sequence[str]) -> list[str]:
    """Return the words with settings as options; an option that became one is said."""
    role = next((role for role in Role if role.value in words[1:2]), None)
    if role is None:
        return list(words)
    rows = settings_of(role)
    for word in words:
        if (row := rows.get(word.partition("=")[0])) is not None:
            say(f"{row.name} is a setting now: -o {key_of(row)}={row.metavar or flag_of(row)}")
    return table_options.settings_as_options(words, role)
