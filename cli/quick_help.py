"""Apps with their own `--help`: rich, which typer's imports, loads slowly (benchmarks/performance.md)."""

from __future__ import annotations

import inspect
import textwrap
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dds_trace.base.version import __version__

from .defaults import DefaultedCommand

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from typer.models import ArgumentInfo, OptionInfo

WIDEST_COLUMNS = 120
"""Columns of help on a wide terminal."""
WIDEST_NAME = 30
"""A longer name of an option has its help on the next line."""


class QuickHelpCommand(DefaultedCommand):
    """A command with a section of its help for each panel of options."""

    commands: Mapping[str, str] = {}

    def format_help(self, ctx: Any, formatter: Any) -> None:
        self.format_usage(ctx, formatter)
        for paragraph in inspect.cleandoc(self.help or "").split("\n\n"):
            is_command = paragraph.startswith("    ")
            text = paragraph.strip() if is_command else " ".join(paragraph.split())
            formatter.write("\n" + (f"      {text}\n" if is_command else _filled(text, "  ", formatter.width)))
        for title, rows in self._panels(ctx).items():
            formatter.write(f"\n{title}:\n")
            column = 4 + max(len(name) for name, _ in rows if len(name) <= WIDEST_NAME)
            for name, text in rows:
                filled = _filled(text, " " * column, formatter.width)
                first = f"  {name}\n" if len(name) > column - 4 else f"  {name}".ljust(column)
                formatter.write(first + (filled if first.endswith("\n") else filled[column:]))

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        return [piece.removeprefix("{").removesuffix("}") for piece in super().collect_usage_pieces(ctx)]

    def _panels(self, ctx: Any) -> dict[str, list[tuple[str, str]]]:
        panels: dict[str, list[tuple[str, str]]] = {"Commands": [*self.commands.items()], "Arguments": []}
        general: list[tuple[str, str]] = []
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                kind = "Options" if parameter.param_type_name == "option" else "Arguments"
                title = getattr(parameter, "rich_help_panel", None) or kind
                rows = general if title == "Options" else panels.setdefault(title, [])
                rows.append((record[0].rstrip(), record[1].replace("[required]", "").rstrip()))
        return {title: rows for title, rows in {**panels, "Options": general}.items() if rows}


def _filled(text: str, indent: str, width: int) -> str:
    lines = textwrap.wrap(
        text,
        max(width, len(indent) + 20),
        initial_indent=indent,
        subsequent_indent=indent,
        break_on_hyphens=False,
        break_long_words=False,
    )
    return "\n".join(lines or [""]) + "\n"


def option(name: str, help: str, *, also: str = "", show_default: bool = False, **more: Any) -> OptionInfo:  # noqa: A002 - typer's word
    flag, _, metavar = name.partition(" ")
    flags = (flag, also) if also else (flag,)
    info: OptionInfo = typer.Option(*flags, metavar=metavar or None, help=help, show_default=show_default, **more)
    return info


def argument(metavar: str, help: str, **more: Any) -> ArgumentInfo:  # noqa: A002 - typer's word
    info: ArgumentInfo = typer.Argument(metavar=metavar, help=help, show_default=False, **more)
    return info


def starting(names: Iterable[str]) -> Callable[[str], list[str]]:
    def complete(incomplete: str) -> list[str]:
        return [name for name in names if name.startswith(incomplete)]

    return complete


def command_app(*, completes: bool = False) -> typer.Typer:
    return typer.Typer(add_completion=completes, pretty_exceptions_enable=False, rich_markup_mode=None)


def declare_command(
    app: typer.Typer,
    table: str = "",
    overridden: Callable[[Mapping[str, Any]], Mapping[str, str]] | None = None,
    defaults: Mapping[str, object] | None = None,
    commands: Mapping[str, str] | None = None,
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return the decorator that makes a function the command of an app; for the others see `QuickHelpCommand`."""
    values: dict[str, Any] = {"table": table, "defaults": defaults or {}, "commands": commands or {}}
    if overridden is not None:
        values["overridden"] = staticmethod(overridden)
    command = type("Command", (QuickHelpCommand,), values)
    names = {"help_option_names": ["-h", "--help"], "max_content_width": WIDEST_COLUMNS}
    return app.command(cls=command, context_settings=names)


def _print_version(context: typer.Context, is_given: bool) -> None:
    if is_given:
        print(f"{context.info_name} {__version__}")
        raise typer.Exit


Version = Annotated[bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version.")]
