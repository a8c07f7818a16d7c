"""Every command, as its own `--help` prints it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

from dds_trace.cli import analyze, trace
from dds_trace.cli.record import command as record

if TYPE_CHECKING:
    from collections.abc import Iterator

COLUMNS = 100


def _commands() -> Iterator[tuple[str, Any]]:
    """Yield name and command, in the order of a measurement, and the two names of programs that stay."""
    yield trace.PROGRAM, typer.main.get_command(trace.build([]))
    for name in trace.COMMANDS:
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
    return str(command.get_help(context))
