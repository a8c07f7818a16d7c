"""The frame that every command's app is made in: `--help` and usage errors are written without rich.

Rich and the four libraries that typer's own help imports with it take longer to load than everything else that `--help` does;
`docs/explanation/performance.md` has the figures. The words stay marked as rich has them, [bold] and [dim]: a terminal shows them so, and a
file or a pipe gets the plain text, because `typer.echo` takes escape sequences off there.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dds_trace.base.version import __version__

from .defaulted import DefaultedCommand

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

WIDEST_COLUMNS = 120
"""Columns of help on a wide terminal; on a narrower one, its own."""

_HELD = {"[bold]": "\ue000", "[dim]": "\ue001", "[/bold]": "\ue002", "[/dim]": "\ue002", "-": "\ue003"}
"""What one character stands for while lines are broken: a mark must not count as a word, and no name breaks at its hyphen."""

_SHOWN = str.maketrans({"\ue000": "\x1b[1m", "\ue001": "\x1b[2m", "\ue002": "\x1b[0m", "\ue003": "-"})
_HOLD = re.compile("|".join(map(re.escape, _HELD)))


class QuickHelpCommand(DefaultedCommand):
    """A command whose help is written by click's formatter, one section for each panel of options."""

    def get_help(self, ctx: Any) -> str:
        """Return the help page, broken into lines for the terminal."""
        return super().get_help(ctx).translate(_SHOWN)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write usage, text, arguments and options to the formatter of the help page."""
        self.format_usage(ctx, formatter)
        formatter.write_paragraph()
        with formatter.indentation():
            formatter.write_text(_held(self.help or ""))
        for title, rows in self._panels(ctx).items():
            with formatter.section(title):
                formatter.write_dl(rows)

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Return options and arguments as the usage line has them: `[NAME]` may be left out, `NAME` may not."""
        return [piece.removeprefix("{").removesuffix("}") for piece in super().collect_usage_pieces(ctx)]

    def _panels(self, ctx: Any) -> dict[str, list[tuple[str, str]]]:
        """Return title -> (name, help) of each parameter, in the order they are declared: arguments first, options of no panel last."""
        panels: dict[str, list[tuple[str, str]]] = {"Arguments": []}
        general: list[tuple[str, str]] = []
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                kind = "Options" if parameter.param_type_name == "option" else "Arguments"
                title = getattr(parameter, "rich_help_panel", None) or kind
                rows = general if title == "Options" else panels.setdefault(title, [])
                rows.append((record[0].rstrip(), _held(record[1])))
        return {title: rows for title, rows in {**panels, "Options": general}.items() if rows}


def command_app(*, completes: bool = False) -> typer.Typer:
    """Return an empty app; `declare_command` gives it its command.

    Args:
        completes: whether it is a program by itself, with options that install or show its completion in the shell.
    """
    return typer.Typer(add_completion=completes, pretty_exceptions_enable=False, rich_markup_mode=None)


def declare_command(
    app: typer.Typer,
    table: str = "",
    passes_over: Callable[[Mapping[str, Any]], Mapping[str, str]] | None = None,
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return the decorator that makes a function the command of an app, with -h, the quick help and `dds-trace.toml`.

    Args:
        app: the app.
        table: table of the command in the file; empty for none.
        passes_over: see `DefaultedCommand`.
    """
    own: dict[str, Any] = {"table": table}
    if passes_over is not None:
        own["passes_over"] = staticmethod(passes_over)
    command = type("Command", (QuickHelpCommand,), own)
    names = {"help_option_names": ["-h", "--help"], "max_content_width": WIDEST_COLUMNS}
    return app.command(cls=command, context_settings=names)


def _print_version(context: typer.Context, asked: bool) -> None:
    """Print name and version of the program, and end it."""
    if asked:
        print(f"{context.info_name} {__version__}")
        raise typer.Exit


Version = Annotated[
    bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version.")
]
"""The option of every program that shows its version."""


def _held(text: str) -> str:
    """Return a text with its marks and hyphens held by one character each."""
    return _HOLD.sub(lambda mark: _HELD[mark[0]], text)
