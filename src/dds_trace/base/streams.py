"""The door of all text to a terminal or a log: no device, peer, file or trace commands its reader.

`plain_streams` strips control and invisible characters from stdout and stderr, and lines that GitHub's runner takes for
commands (`::name::` at the start, `##[name]` anywhere). Rich writes its escapes past that, so `plain_console` cleans each
segment. `printable` makes one line of what comes from outside.
"""

from __future__ import annotations

import os
import re
import sys
import textwrap
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from io import StringIO, TextIOWrapper
from shutil import get_terminal_size
from typing import TYPE_CHECKING, Any

from .printable import MAX_FINDING_CHARACTERS, is_hidden, printable

if TYPE_CHECKING:
    from rich.console import Console


def plain(text: str) -> str:
    r"""Return text with all but line feeds and tabs spelled out as in JSON: `\u001b`, so that JSON stays JSON."""
    if text.replace("\n", "").replace("\t", "").isprintable():
        return text
    return "".join(c if c in "\n\t" or not is_hidden(c) else _spelled(c) for c in text)


def _spelled(character: str) -> str:
    encoded = character.encode("utf-16-be", "surrogatepass")
    return "".join(f"\\u{int.from_bytes(encoded[at : at + 2], 'big'):04x}" for at in range(0, len(encoded), 2))


def without_commands(text: str, *, is_at_start: bool = True) -> str:
    """Return text without what GitHub's runner takes for a command; `is_at_start` if it begins a line."""
    first, *others = text.replace("##[", "#\\u0023[").split("\n")
    return "\n".join([_without_command(first) if is_at_start else first, *map(_without_command, others)])


def _without_command(line: str) -> str:
    return line.replace("::", ":\\u003a", 1) if line.lstrip().startswith("::") else line


class PlainStream:
    """A text stream that is written plainly; what cannot be written is lost, and `failure` says why."""

    def __init__(self, stream: Any, *, has_escapes: bool = False) -> None:
        self._stream = stream
        self._has_escapes = has_escapes
        self._is_at_start = True
        self.failure: OSError | None = None
        if not has_escapes:
            self.rich_proxied_file = PlainStream(stream, has_escapes=True)

    def write(self, text: str) -> int:
        try:
            self._stream.write(self._without_commands(text if self._has_escapes else plain(text)))
        except OSError as err:
            self._give_up(err)
        return len(text)

    def write_commands(self, text: str) -> None:
        """Write lines that GitHub's runner is to take for commands, as a report of ours is made of them."""
        self.flush()
        self._stream.write(plain(text))

    def flush(self) -> None:
        try:
            self._stream.flush()
        except OSError as err:
            self._give_up(err)

    def writelines(self, lines: Iterable[str]) -> None:
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _without_commands(self, text: str) -> str:
        shown = without_commands(text, is_at_start=self._is_at_start)
        last = text.rpartition("\n")
        self._is_at_start = not last[2].strip() and (bool(last[1]) or self._is_at_start)
        return shown

    def _give_up(self, err: OSError) -> None:
        """Drop what follows and what is buffered: Python would fail again at exit."""
        self.failure = self.failure or err
        with suppress(OSError, ValueError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)


@contextmanager
def plain_streams() -> Iterator[PlainStream]:
    before = sys.stdout, sys.stderr
    for stream in before:
        if isinstance(stream, TextIOWrapper):  # escape what its encoding lacks
            stream.reconfigure(errors="backslashreplace")
    out, err = PlainStream(before[0]), PlainStream(before[1])
    sys.stdout, sys.stderr = out, err
    try:
        yield out
    finally:
        out.flush()
        err.flush()
        out.failure = out.failure or out.rich_proxied_file.failure
        sys.stdout, sys.stderr = before


def say(text: object) -> None:
    print(wrapped(printable(text, MAX_FINDING_CHARACTERS)), file=sys.stderr, flush=True)


def wrapped(text: str, stream: Any = None, *, in_pipe: int | None = None) -> str:
    """Return lines as a terminal shows them, words whole; a log has no width, or `in_pipe` columns."""
    is_terminal = (stream or sys.stderr).isatty()
    width = min(get_terminal_size().columns, WIDEST_SCREEN) if is_terminal else in_pipe
    if width is None:
        return text
    lines = text.splitlines()
    whole = textwrap.TextWrapper(width, break_long_words=False, break_on_hyphens=False)
    for number, line in enumerate(lines):
        whole.subsequent_indent = " " * (len(line) - len(line.lstrip()) + 2)
        lines[number] = whole.fill(line)
    return "\n".join(lines)


_ARGUMENT = re.compile(r"""(?:[^\s'"]|'[^']*'|"[^"]*")+""")


def command_lines(command: str) -> str:
    """Return a command for a shell in lines that a screen has room for, broken between its arguments."""
    width = SCREEN_WIDTH - len("      ") - len(" \\")
    first, *arguments = _ARGUMENT.findall(command)
    lines = [first]
    for argument in arguments:
        if len(lines[-1]) + len(argument) < width:
            lines[-1] += f" {argument}"
        else:
            lines.append(argument)
    return "    " + " \\\n      ".join(lines)


def plain_console(**options: Any) -> Console:
    """Return a rich console that draws plain text: no markup, and no control characters but its own."""
    from rich.console import Console  # noqa: PLC0415 - slow, and not needed for most commands
    from rich.segment import Segment  # noqa: PLC0415

    class PlainConsole(Console):
        def render(self, renderable: Any, options: Any = None) -> Iterable[Segment]:
            for segment in super().render(renderable, options):
                yield segment if segment.control else Segment(plain(segment.text), segment.style)

    stream = sys.stderr if options.pop("stderr", False) else sys.stdout
    options.setdefault("file", getattr(stream, "rich_proxied_file", stream))
    return PlainConsole(**{"markup": False, "highlight": False, "emoji": False, "legacy_windows": False, **options})


SCREEN_WIDTH, WIDEST_SCREEN = 80, 120


def print_screen(part: Any) -> None:
    console = plain_console()
    console.print(part, width=min(console.width, WIDEST_SCREEN) if console.is_terminal else SCREEN_WIDTH)


def screen_text(part: Any) -> str:
    text = StringIO()
    plain_console(file=text, width=SCREEN_WIDTH, color_system=None).print(part)
    return without_commands("\n".join(line.rstrip() for line in text.getvalue().splitlines()) + "\n")
