"""A program of several commands, also as the shell completes it: the first word chooses one."""

from __future__ import annotations

import os
import re
import sys
from difflib import get_close_matches
from functools import partial
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from dds_trace.base.errors import OptionError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

BASH_WORDS, BASH_POSITION, OTHER_WORDS = "COMP_WORDS", "COMP_CWORD", "_TYPER_COMPLETE_ARGS"
"""Variables of typer's scripts: words with line breaks and the cursor's position (bash), or the line (zsh, fish)."""

CLOSE_ENOUGH = 0.7
"""Similarity from which a word is taken for a misspelt command (`difflib`: 1 is equal)."""


def run_program(
    name: str, app: typer.Typer, commands: Mapping[str, typer.Typer], arguments: Sequence[str] | None
) -> None:
    """Run the command that the first word names, or the one without a name."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    completed = _take_completed_command(name, app, commands)
    if completed is not None:
        run_command(partial(commands[completed], [], prog_name=name))
    elif given and given[0] in commands:
        run_command(partial(commands[given[0]], given[1:], prog_name=f"{name} {given[0]}"))
    else:
        run_command(partial(_run_nameless, name, app, commands, given))


def _run_nameless(name: str, app: typer.Typer, commands: Collection[str], given: list[str]) -> None:
    """Run the command without a name, unless the first word is not a path and nearly another command."""
    word = given[0] if given else "-"
    meant = get_close_matches(word, commands, n=1, cutoff=CLOSE_ENOUGH)
    if meant and not word.startswith("-") and not Path(word).exists():
        raise OptionError(f"there is no file or folder {word}; did you mean `{name} {meant[0]}`?")
    app(given, prog_name=name)


def _take_completed_command(program: str, app: typer.Typer, commands: Collection[str]) -> str | None:
    """Take the command out of the words to complete and return it, None if there is none."""
    if f"_{program}_COMPLETE".replace("-", "_").upper() not in os.environ:
        return None
    variable = BASH_WORDS if BASH_WORDS in os.environ else OTHER_WORDS
    text = os.environ.get(variable, "")
    first, _, others = text.partition("\n" if "\n" in text else " ")
    name = next(iter(others.split()), "")
    rest = others[len(name) :]
    if (
        name not in commands or not rest[:1].isspace()
    ):  # without a space after it the word itself is being typed
        return None
    typer.main.get_command(app)  # an app that completes sets it up for all
    os.environ[variable] = first + rest
    if BASH_POSITION in os.environ:
        os.environ[BASH_POSITION] = str(int(os.environ[BASH_POSITION]) - 1)
    return name


_EXTRA = re.compile(r"""(?P<package>[\w-]+).*\bextra == ['"](?P<extra>\w+)['"]""")
"""A requirement of an extra, such as `polars<3,>=1.30; extra == 'analyze'`."""


_TOO_LARGE = "not enough memory; request smaller or fewer messages, or give a part of the traces"


def run_command(command: Callable[[], object]) -> None:
    """Call a command's app; end the process with one line at a user's error."""
    # Escape what the terminal's encoding lacks.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        command()
    except MemoryError:
        print(f"{Path(sys.argv[0]).name}: {_TOO_LARGE}", file=sys.stderr)
        sys.exit(1)
    except ModuleNotFoundError as error:
        extra = _extra_with(error.name or "")
        if extra is None:
            raise
        from dds_trace.base.errors import BackendUnavailableError

        what = f"needs {error.name}, which is not installed: pip install 'dds-trace[{extra}]'"
        print(f"{Path(sys.argv[0]).name} {what}", file=sys.stderr)
        sys.exit(BackendUnavailableError.exit_code)
    except Exception as error:
        from dds_trace.base.errors import TraceError

        if not isinstance(error, TraceError):
            raise
        print(f"{Path(sys.argv[0]).name}: {error}", file=sys.stderr)
        sys.exit(error.exit_code)


def _extra_with(module: str) -> str | None:
    """Return the extra that brings the package of a module, None if none does."""
    from importlib.metadata import requires  # slow, and rarely needed

    package = module.partition(".")[0]
    for requirement in requires("dds-trace") or ():
        named = _EXTRA.match(requirement)
        if named is not None and named["package"].lower() == package:
            return named["extra"]
    return None
