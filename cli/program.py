"""A program of several commands, also as the shell completes it: the first word chooses one."""

from __future__ import annotations

import errno
import os
import re
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Protocol

import typer

from dds_trace.base.errors import BackendUnavailableError, OptionError, OutputError, TraceError
from dds_trace.base.streams import plain_streams, say

BASH_WORDS, BASH_POSITION, OTHER_WORDS = "COMP_WORDS", "COMP_CWORD", "_TYPER_COMPLETE_ARGS"
"""Variables of typer's scripts: words with line breaks and the cursor's position (bash), or the line (zsh, fish)."""

CLOSE_ENOUGH = 0.7
"""From this similarity (`difflib`: 1 is equal) a word is a misspelt command."""


class Adapt(Protocol):
    """Changes a command in place before it runs."""

    def __call__(self, command: Any, /) -> object:
        """Change it."""


def run_program(
    name: str,
    app: typer.Typer,
    commands: Mapping[str, typer.Typer],
    arguments: Sequence[str] | None,
    *,
    adapt: Adapt | None = None,
    needs_stdout: bool = True,
) -> None:
    words = list(sys.argv[1:] if arguments is None else arguments)
    completed = take_completed_command(name, app, commands)

    def run() -> None:
        chosen = completed or (words[0] if words and words[0] in commands else None)
        if chosen is None:
            refuse_misspelt(name, commands, words)
        command = typer.main.get_command(app if chosen is None else commands[chosen])
        if adapt is not None:
            adapt(command)
        if completed is not None or chosen is None:
            command(words, prog_name=name)
        else:
            command(words[1:], prog_name=f"{name} {chosen}")

    run_command(run, needs_stdout=needs_stdout)


def refuse_misspelt(name: str, commands: Collection[str], words: Sequence[str], *, takes_paths: bool = True) -> None:
    word = words[0] if words else "-"
    meant = get_close_matches(word, commands, n=1, cutoff=CLOSE_ENOUGH)
    if word.startswith("-") or (takes_paths and (not meant or Path(word).exists())):
        return
    what = "file or folder" if takes_paths else "command"
    raise OptionError(
        f"there is no {what} {word}; " + (f"did you mean `{name} {meant[0]}`?" if meant else "see --help")
    )


def take_completed_command(program: str, app: typer.Typer, commands: Collection[str]) -> str | None:
    """Take the command from the words to complete; None if there is none."""
    if f"_{program}_COMPLETE".replace("-", "_").upper() not in os.environ:
        return None
    variable = BASH_WORDS if BASH_WORDS in os.environ else OTHER_WORDS
    text = os.environ.get(variable, "")
    first, _, others = text.partition("\n" if "\n" in text else " ")
    name = next(iter(others.split()), "")
    remainder = others[len(name) :]
    if name not in commands or not remainder[:1].isspace():  # without a space after it the word itself is being typed
        return None
    typer.main.get_command(app)  # an app that completes sets it up for all
    os.environ[variable] = first + remainder
    if BASH_POSITION in os.environ:
        os.environ[BASH_POSITION] = str(int(os.environ[BASH_POSITION]) - 1)
    return name


def ask_about_folder(path: Path, what: str) -> None:
    """Ask whether a new folder is meant by a name that looks like a file's; without a terminal, print that it is one.

    Raises:
        OptionError: it is not meant.
    """
    if not path.suffix[1:].isalpha() or path.exists():
        return
    text = f"{path.name} becomes a folder, {what}"
    if not (os.isatty(0) and os.isatty(2)):
        say(text)
    elif not typer.confirm(f"{text}; continue?", err=True, default=True):
        raise OptionError("give another --out")


_EXTRA = re.compile(r"""(?P<package>[\w-]+).*\bextra == ['"](?P<extra>\w+)['"]""")
"""As in `polars<3,>=1.30; extra == 'analyze'`."""


_TOO_LARGE = "not enough memory; request smaller or fewer messages, or give a part of the traces"


def run_command(command: Callable[[], object], *, needs_stdout: bool = True) -> None:
    """Call a command's app; end the process with one line at a user's error.

    Words that stderr or stdout does not take are lost; for stdout that is an error where `needs_stdout`.
    """
    ended: SystemExit | None = None
    with plain_streams() as stdout:
        try:
            _run(command)
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


def _run(command: Callable[[], object]) -> None:
    try:
        command()
    except MemoryError:
        print_error(f": {_TOO_LARGE}")
        sys.exit(1)
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


def print_error(text: str) -> None:
    print(f"{Path(sys.argv[0]).name}{text}", file=sys.stderr)  # some errors have several lines


def _extra_with(module: str) -> str | None:
    from importlib.metadata import requires  # slow, and rarely needed

    package = module.partition(".")[0]
    for requirement in requires("dds-trace") or ():
        matched = _EXTRA.match(requirement)
        if matched is not None and matched["package"].lower() == package:
            return matched["extra"]
    return None
