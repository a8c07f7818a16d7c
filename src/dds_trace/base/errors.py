"""The tree of errors. A message says what is wrong, where (path, offset, topic), and what to do next."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

UNREADABLE = (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError)
"""What the reading of JSON that anybody may have written raises."""


class TraceError(Exception):
    """Error that a user can act on, in one line."""

    exit_code: ClassVar[int] = 1


class TraceFormatError(TraceError):
    """Bytes on disk that do not follow `docs/trace-format.md`; `offset` is in the file `path`, if the fault has one."""

    exit_code = 3

    def __init__(self, path: Path | str, what: str, offset: int | None = None) -> None:
        where = f"{path}" if offset is None else f"{path} at byte {offset}"
        super().__init__(f"{where}: {what}")
        self.path = str(path)
        self.what = what
        self.offset = offset

    def __reduce__(self) -> tuple[type, tuple[str, str, int | None]]:
        return type(self), (self.path, self.what, self.offset)  # for another process


class MissingEventsError(TraceError):
    """Folder or file without an event to analyze."""

    exit_code = 4


class OutputExistsError(TraceError):
    """Output that exists already; nothing recorded is overwritten without `--force`."""

    exit_code = 5


class OutputError(TraceError):
    """Output that cannot be written (disk full, read-only, folder gone)."""

    exit_code = 6


class OptionError(TraceError):
    """Value on the command line or in a plan that is wrong or impossible."""

    exit_code = 2


class BackendUnavailableError(TraceError):
    """Middleware, bridge program or licence that is not on this machine."""

    exit_code = 7
