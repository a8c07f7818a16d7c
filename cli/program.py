"""What commands share: their options and help, their defaults from a file, and an error as one line."""

from __future__ import annotations

import errno
import inspect
import os
import re
import signal
import sys
import textwrap
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.models import ArgumentInfo, OptionInfo

from dds_trace.base.errors import BackendUnavailableError, OptionError, OutputError, TraceError
from dds_trace.base.shortage import Room, shortage
from dds_trace.base.streams import plain_streams, say, wrapped
from dds_trace.base.version import __version__

from .defaults import PRINT_CONFIG, set_defaults, values_in_force

SETTINGS: dict[str, Any] = {"help_option_names": ["--help"], "max_content_width": 120}
SHORT_COLUMNS = 73  # of an option's name and what it means in a line of `-h`


def option(name: str, help: str, *, show_default: bool = False, **more: Any) -> OptionInfo:  # noqa: A002 - typer's word
    flag, _, metavar = name.partition(" ")
    info: OptionInfo = typer.Option(flag, metavar=metavar or None, help=help, show_default=show_default, **more)
    return info


def argument(metavar: str, help: str, **more: Any) -> ArgumentInfo:  # noqa: A002 - typer's word
    info: ArgumentInfo = typer.Argument(metavar=metavar, help=help, show_default=False, **more)
    return info


def starting(names: Iterable[str]) -> Callable[[str], list[str]]:
    def complete(incomplete: str) -> list[str]:
        return [name for name in names if name.startswith(incomplete)]

    return complete


def make_app(*, completes: bool = False, **more: Any) -> typer.Typer:
    return typer.Typer(add_completion=completes, pretty_exceptions_enable=False, rich_markup_mode=None, **more)


def command(
    app: typer.Typer,
    name: str,
    *,
    table: str = "",
    ignored: Collection[str] = (),
    often: Collection[str] = (),
    overridden: Callable[[Mapping[str, Any]], Mapping[str, str]] = lambda _: {},
    defaults: Mapping[str, object] | None = None,
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a function a command of an app.

    Args:
        table: its table in `dds-trace.toml`, where `ignored` are keys of other commands.
        often: parameters that `-h` shows; none for all.
        overridden: returns why configured defaults do not count.
        defaults: shown by `--print-config` where a value is None.
    """

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        declared = inspect.signature(function, eval_str=True).parameters
        context = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
        parameters = {"context": context, **declared}
        parameters["is_short"] = _flag("is_short", "-h", "Show the most used options, in short.", _short_help(often))
        if table:
            parameters[PRINT_CONFIG] = _flag(
                PRINT_CONFIG,
                "--print-config",
                "Show the value in force of each option and where it is from, and exit.",
                set_defaults(table, ignored),
            )

        @wraps(function)
        def run(context: typer.Context, **values: Any) -> None:
            in_force = values_in_force(context, values, overridden(values), defaults or {}) if table else values
            arguments = {"context": context, **in_force}
            function(**{parameter: value for parameter, value in arguments.items() if parameter in declared})

        run.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
            [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in parameters.values()]
        )
        run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters.values()}
        app.command(name, context_settings=SETTINGS)(run)
        return function

    return decorate


def _flag(name: str, flag: str, help: str, callback: Callable[..., object]) -> inspect.Parameter:  # noqa: A002 - typer's word
    info = typer.Option(flag, callback=callback, is_eager=True, help=help)
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=Annotated[bool, info])


def _short_help(often: Collection[str]) -> Callable[[typer.Context, bool], None]:
    def show(context: typer.Context, is_given: bool) -> None:
        if not is_given:
            return
        parameters: list[Any] = context.command.params
        for parameter in parameters:
            is_rare = often and parameter.param_type_name == "option" and parameter.name not in often
            parameter.hidden = parameter.hidden or is_rare
        shown = [parameter for parameter in parameters if not getattr(parameter, "hidden", False)]
        longest = max(len(f"{max(row.opts, key=len)} {row.metavar or ''}") for row in shown)
        for parameter in shown:
            parameter.help = textwrap.shorten(parameter.help or "", SHORT_COLUMNS - longest, placeholder=" ...")
        print(context.get_help())
        raise typer.Exit

    return show


def _print_version(context: typer.Context, is_given: bool) -> None:
    if is_given:
        print(f"{context.info_name} {__version__}")
        raise typer.Exit


ShortHelp = Annotated[
    bool, typer.Option("-h", callback=_short_help(("version",)), is_eager=True, help="Show this in short.")
]
Version = Annotated[bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version.")]


def ask_about_folder(path: Path, what: str) -> None:
    if not path.suffix[1:].isalpha() or path.exists():
        return
    text = f"{path.name} becomes a folder, {what}"
    if not (os.isatty(0) and os.isatty(2)):
        say(text)
    elif not typer.confirm(f"{text}; continue?", err=True, default=True):
        raise OptionError("give another --out")


_EXTRA = re.compile(r"""(?P<package>[\w-]+).*\bextra == ['"](?P<extra>\w+)['"]""")
"""As in `polars<3,>=1.30; extra == 'analyze'`."""


def run_command(command: Callable[[], object], *, needs_stdout: bool = True, room: Room | None = None) -> None:
    """Call a command's app; a user's error, too little `room`, or a needed stdout that is closed end it with one line."""
    ended: SystemExit | None = None
    with plain_streams() as stdout, _unwinding_at_sigterm() if needs_stdout else nullcontext():
        try:
            _run(command, room)
        except SystemExit as end:
            ended = end
    failure = stdout.failure
    if failure is not None and needs_stdout and not (ended and ended.code):
        if failure.errno == errno.EPIPE:  # `| head` has read enough
            sys.exit(1)
        with plain_streams():
            print_error(f": stdout cannot be written ({failure.strerror}); free space or write elsewhere")
        sys.exit(OutputError.exit_code)
    if ended is not None:
        raise ended


@contextmanager
def _unwinding_at_sigterm() -> Iterator[None]:
    """Let SIGTERM remove temporary files as Ctrl-C does; a second one ends at once, and a handler of the command's own counts."""

    def unwind(number: int, _frame: object) -> None:
        signal.signal(number, signal.SIG_DFL)
        sys.exit(128 + number)

    is_default = signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    if is_default and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, unwind)
    try:
        yield
    finally:
        if signal.getsignal(signal.SIGTERM) is unwind:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _run(command: Callable[[], object], room: Room | None) -> None:
    try:
        if room is not None:
            room.check()
        command()
    except (SystemExit, KeyboardInterrupt):
        raise
    except ModuleNotFoundError as error:
        extra = _extra_with(error.name or "")
        if extra is None:
            raise
        cure = f"pip install 'dds-trace[{extra}]' (in a clone '.[{extra}]')"
        print_error(f" needs {error.name}, which is not installed: {cure}")
        sys.exit(BackendUnavailableError.exit_code)
    except TraceError as error:
        print_error(f": {error}")
        sys.exit(error.exit_code)
    except BaseException as error:
        short_of = shortage(error)
        if not short_of:
            raise
        print_error(f": {short_of}")
        sys.exit(TraceError.exit_code)


def print_error(text: str) -> None:
    print(wrapped(f"{Path(sys.argv[0]).name}{text}"), file=sys.stderr)


def _extra_with(module: str) -> str | None:
    from importlib.metadata import requires  # slow, and rarely needed

    package = module.partition(".")[0]
    for requirement in requires("dds-trace") or ():
        matched = _EXTRA.match(requirement)
        if matched is not None and matched["package"].lower() == package:
            return matched["extra"]
    return None
