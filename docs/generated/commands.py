"""Every command, as its own `--help` prints it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

from dds_trace.cli import analyze, trace
from dds_trace.cli.record import command as record
from dds_trace.recorder.choices import Role
from dds_trace.recorder.option_table import OPTIONS, flag_of, help_of, is_setting, key_of

if TYPE_CHECKING:
    from collections.abc import Iterator

COLUMNS = 100


def _commands() -> Iterator[tuple[str, Any]]:
    """Yield name and command, in the order of a measurement, and the two names of programs that stay."""
    yield trace.PROGRAM, typer.main.get_command(trace.build([]))
    for name in trace.commands():
        command: Any = typer.main.get_command(trace.build(name.split()))
        for word in name.split():
            command = command.commands[word]
        yield f"{trace.PROGRAM} {name}", command
    yield "dds-record", typer.main.get_command(record.app)
    yield "dds-analyze", typer.main.get_command(analyze.app)


def commands() -> str:
    """Return a section for each command."""
    return "\n".join(f"## {name}\n\n```text\n{_help(name, command)}\n```\n" for name, command in _commands())


def _help(name: str, command: Any) -> str:
    context = command.make_context(name, [], resilient_parsing=True, terminal_width=COLUMNS)
    role = next((role for role in Role if name == f"{trace.PROGRAM} record {role.value}"), None)
    return "\n".join([str(command.get_help(context)), *(_settings(role) if role else ())])


def _settings(role: Role) -> Iterator[str]:
    yield "\nSettings:"
    for row in OPTIONS.values():
        if role in (row.roles or Role) and is_setting(row, role):
            yield f"  -o {key_of(row)}={row.metavar or flag_of(row)}\n      {help_of(row)}"
