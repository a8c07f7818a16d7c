"""One tree of errors. Every message says what, where (path, offset, topic), and what to do next.

`cli` turns a `TraceError` into one line on stderr and the class's `exit_code`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from pathlib import Path


class TraceError(Exception):
    """What a user can act on; its text is one clear line."""

    exit_code: ClassVar[int] = 1


class TraceFormatError(TraceError):
    """Bytes on disk that do not follow `docs/trace-format.md`.

    Args:
        path: the file.
        what: what is wrong with it, and what to do next where that is known.
        offset: byte offset in the file, if one is to blame.
    """

    exit_code = 3

    def __init__(self, path: Path | str, what: str, offset: int | None = None) -> None:
        where = f"{path}" if offset is None else f"{path} at byte {offset}"
        super().__init__(f"{where}: {what}")
        self.path = str(path)
        self.what = what
        self.offset = offset


class MissingEventsError(TraceError):
    """A folder or a file holds no event that could be analyzed."""

    exit_code = 4


class OutputExistsError(TraceError):
    """An output is there already; nothing recorded is overwritten without `--force`."""

    exit_code = 5


class OutputError(TraceError):
    """An output cannot be written (disk full, read-only, folder gone)."""

    exit_code = 6


class OptionError(TraceError):
    """A value on the command line or in a plan that cannot be meant."""

    exit_code = 2


class BackendUnavailableError(TraceError):
    """A middleware, bridge program or licence that is not on this machine."""

    exit_code = 7


class NoEchoError(TraceError):
    """No relay answered in time."""

    exit_code = 8


class BridgeError(TraceError):
    """A bridge's program failed: it ended, never came up, or cannot be started; the text holds its last line."""

    exit_code = 9
