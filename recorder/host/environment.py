"""A middleware's configuration in environment variables and files, by name and hash."""

from __future__ import annotations

import hashlib
import os
import re
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.base.files import read_regular

LOG_S = 0.1
"""Fast DDS writes its log on a thread of its own."""

STDOUT, STDERR = 1, 2
_COLOUR = re.compile(r"\x1b\[[\d;]*m")
_REFUSAL = re.compile(
    r"\bconfig: (?P<cyclonedds>.*(?:unknown|invalid|no unit).*)"
    r"|XMLPARSER Error\] (?P<fastdds>.+?) -> Function"  # it then goes on without the file
)
_ERROR = re.compile(r" Error\] (?P<fastdds>.+?) -> Function|^\d+\.\d+ \[\d+\] +\S+: (?P<cyclonedds>.+)$", re.MULTILINE)

_INLINE_STARTS = ("<", "{", "str://")
"""A value that starts so is a configuration itself, not the name of a file."""


@dataclass(frozen=True, slots=True)
class ConfigurationVariable:
    name: str
    separator: str | None = None


@dataclass(frozen=True, slots=True)
class MiddlewareEnvironment:
    settings: tuple[str, ...] = ()
    configuration: tuple[ConfigurationVariable, ...] = ()
    files: tuple[str, ...] = ()

    def sources(self) -> list[str]:
        return list(self.hash_configuration(os.environ, Path.cwd()))

    def read_settings(self, variables: Mapping[str, str]) -> dict[str, str]:
        return {name: variables[name] for name in self.settings if name in variables}

    def hash_configuration(self, variables: Mapping[str, str], folder: Path) -> dict[str, list[dict[str, str | None]]]:
        """Return each configuration in effect: variable, or `./NAME` for a file in `folder` -> `name` and `sha256` of each entry.

        The name of inline text is `inline`; the hash of a file that cannot be read is null.
        """
        hashes = {
            variable.name: [_hashed(entry) for entry in _entries(variables[variable.name], variable.separator)]
            for variable in self.configuration
            if variables.get(variable.name)
        }
        return hashes | {f"./{name}": [_hashed(str(folder / name))] for name in self.files if (folder / name).is_file()}


def join_environments(environments: Iterable[MiddlewareEnvironment]) -> MiddlewareEnvironment:
    everything = list(environments)
    return MiddlewareEnvironment(
        settings=tuple(dict.fromkeys(name for item in everything for name in item.settings)),
        configuration=tuple(dict.fromkeys(variable for item in everything for variable in item.configuration)),
        files=tuple(dict.fromkeys(name for item in everything for name in item.files)),
    )


def _entries(value: str, separator: str | None) -> list[str]:
    # Inline XML or JSON may contain the separator.
    is_inline = value.lstrip().startswith(_INLINE_STARTS)
    parts = [value] if is_inline or separator is None else value.split(separator)
    return [part.strip() for part in parts if part.strip()]


def _hashed(entry: str) -> dict[str, str | None]:
    path = Path(entry.removeprefix("file://"))
    try:
        return {"name": path.name, "sha256": hashlib.sha256(read_regular(path)).hexdigest()}
    except OSError:
        if entry.startswith(_INLINE_STARTS) or "=" in entry:
            return {"name": "inline", "sha256": hashlib.sha256(entry.encode()).hexdigest()}
        return {"name": path.name, "sha256": None}


@contextmanager
def watched_configuration(label: str, environment: MiddlewareEnvironment) -> Iterator[None]:
    """Open a node in the block; an `OptionError` has what the middleware prints of a configuration that it refuses."""
    if not (sources := environment.sources()):
        yield
        return
    with tempfile.TemporaryFile() as printed:
        failure: BackendUnavailableError | None = None
        try:
            with _redirected(printed, STDOUT, STDERR):
                yield
                time.sleep(LOG_S)
        except BackendUnavailableError as err:
            failure = err
        text = _text(printed)
        if (match := _REFUSAL.search(text)) is not None:
            words = (match["cyclonedds"] or match["fastdds"]).strip()
            raise OptionError(f"{label} does not accept {', '.join(sources)}: {words}; correct it there") from failure
        os.write(STDERR, text.encode())
        if failure is not None:
            raise failure


@contextmanager
def kept_output() -> Iterator[Callable[[], str]]:
    """Yield what reads the first error of Fast DDS or Cyclone DDS on stdout and stderr, and passes on what was printed since.

    What Python prints on stderr is printed at once.
    """
    passed_bytes = 0
    with tempfile.TemporaryFile() as printed, os.fdopen(os.dup(STDERR), "w", buffering=1) as stderr:

        def read_error() -> str:
            nonlocal passed_bytes
            text = _text(printed)
            with suppress(OSError):  # nobody reads it
                os.write(stderr.fileno(), text[passed_bytes:].encode())
            passed_bytes = len(text)
            return next((match[match.lastgroup or 0] for match in _ERROR.finditer(text)), "")

        try:
            with _redirected(printed, STDOUT, STDERR), redirect_stderr(stderr):
                yield read_error
        finally:
            read_error()


@contextmanager
def _redirected(file: BinaryIO, *outputs: int) -> Iterator[None]:
    copies = [os.dup(output) for output in outputs]
    for output in outputs:
        os.dup2(file.fileno(), output)
    try:
        yield
    finally:
        for output, copy in zip(outputs, copies, strict=True):
            os.dup2(copy, output)
            os.close(copy)


def _text(printed: BinaryIO) -> str:
    size_bytes = os.fstat(printed.fileno()).st_size
    return _COLOUR.sub("", os.pread(printed.fileno(), size_bytes, 0).decode(errors="replace"))
