"""Every command with its arguments and options, as its own `--help` declares them."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any

import typer

from dds_trace.cli import analyze, bridge, trace
from dds_trace.cli.record import command as record
from dds_trace.cli.sweep import command as sweep

from .markdown import code, escaped, table

if TYPE_CHECKING:
    from collections.abc import Iterator


def _apps() -> Iterator[tuple[str, typer.Typer]]:
    """Yield name and app of every command, in the order of a measurement."""
    yield trace.PROGRAM, trace.app
    yield "dds-record", record.app
    for name, app in record.COMMANDS.items():
        yield f"dds-record {name}", app
    yield "dds-bridge", bridge.app
    yield "dds-sweep", sweep.app
    for name, app in sweep.COMMANDS.items():
        yield f"dds-sweep {name}", app
    yield "dds-analyze", analyze.app
    for name, app in analyze.COMMANDS.items():
        yield f"dds-analyze {name}", app


def commands() -> str:
    """Return a section for each command: usage, what it does, and a table of options for each panel of its help."""
    return "\n".join(part for name, app in _apps() for part in _command(name, app))


def _command(name: str, app: typer.Typer) -> Iterator[str]:
    command = typer.main.get_command(app)
    context = command.make_context(name, [], resilient_parsing=True)
    usage = command.collect_usage_pieces(context)
    yield f"## {name}\n\n```text\n{name} {' '.join(usage)}\n```\n\n{_prose(command.help or '')}\n"
    for title, rows in _panels(command, context).items():
        yield table((escaped(title), ""), rows)


def _panels(command: Any, context: Any) -> dict[str, list[list[str]]]:
    """Return title -> rows of each panel of the help, arguments first, in the order in which they are declared."""
    panels: dict[str, list[list[str]]] = {"Arguments": [], "Options": []}
    if command.commands:
        panels = {"Commands": [[code(name), _prose(text)] for name, text in command.commands.items()], **panels}
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is not None:
            kind = "Options" if parameter.param_type_name == "option" else "Arguments"
            title = getattr(parameter, "rich_help_panel", None) or kind
            panels.setdefault(title, []).append([code(record[0]), _prose(record[1])])
    return {title: rows for title, rows in panels.items() if rows}


def _prose(text: str) -> str:
    """Return a text of a help page as Markdown; an indented paragraph is a command."""
    paragraphs = inspect.cleandoc(text).split("\n\n")
    return "\n\n".join(code(line) if line.startswith("    ") else escaped(line) for line in paragraphs)
