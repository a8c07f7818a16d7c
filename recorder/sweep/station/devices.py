"""The devices that a relay may run on: this machine, and one that a person works; `ssh.py` has the third."""

from __future__ import annotations

import re
import shlex
from typing import TYPE_CHECKING, Protocol

from dds_trace.base.errors import OutputError
from dds_trace.tracefile.format.ring import RING_SUFFIX

from .programs import Program, rehearse_program

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence
    from pathlib import Path


PARTS = ".parts"
"""Folder below that of the sweep for traces that are not yet those of a cell."""

TRACE_ENDINGS = ("", RING_SUFFIX)
"""What follows a segment's name in the names of its trace and of the ring beside it."""

LOG_ENDINGS = (".log", ".half.log")
"""What follows it in the names of the logs of the relay and of the half beside it."""

_SEGMENT = r"\d{1,6}-\d{1,15}-\d{1,6}\.mcap"
_CELL_TRACE = r"[\w+-][\w.+-]*\.ping\.mcap"
_OWN_NAME = re.compile(
    rf"({_SEGMENT}({'|'.join(map(re.escape, (*TRACE_ENDINGS, *LOG_ENDINGS)))})|{_CELL_TRACE}(\.ring|\.log)?)"
    r"(\.[0-9a-f]{8}\.part)?"
)
"""Names of the files that a sweep makes below `PARTS`, and of their drafts."""


def is_segment_name(name: str) -> bool:
    """Return whether a text is the name of a relay's trace of one start: GROUP-MILLISECONDS-START.mcap."""
    return re.fullmatch(_SEGMENT, name, re.ASCII) is not None


def make_parts(folder: Path) -> Path:
    """Make the folder for parts below that of a sweep, and return its path.

    Raises:
        OutputError: it cannot be made, or something else is there: a link would lead what is written and removed elsewhere.
    """
    parts = folder / PARTS
    try:
        parts.mkdir(parents=True, exist_ok=True)
    except OSError as err:
        raise OutputError(f"{parts}: {err.strerror}; give another --out") from err
    if parts.is_symlink():
        raise OutputError(f"{parts} is a link; remove it, or give another --out")
    return parts


def clear_parts(parts: Path) -> list[str]:
    """Remove every file of a sweep in its folder for parts, and return the names of what is not a sweep's and stays."""
    foreign = []
    for path in sorted(parts.iterdir()):
        if _OWN_NAME.fullmatch(path.name) and (path.is_symlink() or path.is_file()):
            path.unlink()
        else:
            foreign.append(path.name)
    return foreign


def remove_files(folder: Path, name: str, endings: Collection[str]) -> None:
    """Remove the files NAME + ENDING in a folder; one that is not there is no error, and a folder of that name stays."""
    for ending in endings:
        path = folder / f"{name}{ending}"
        if path.is_symlink() or path.is_file():
            path.unlink(missing_ok=True)


class StartedProgram(Protocol):
    """A relay, or a half of a bridge, that was started on its device."""

    @property
    def failure(self) -> str | None:
        """Reason of its end that it printed, None while it runs."""

    @property
    def exit_code(self) -> int | None:
        """Exit code, None while it runs."""

    def stop(self) -> object:
        """End the program; its trace is closed when this returns."""


class RelayDevice(Protocol):
    """A device that starts relays and hands over their traces."""

    @property
    def keeps_traces(self) -> bool:
        """Whether the traces stay on the device until a person copies them."""

    def check(self) -> None:
        """Check that relays can be started on the device, and leave nothing there.

        Raises:
            BackendUnavailableError: the device or its `dds-record` cannot be reached.
            OptionError: the device has another version of dds-trace.
        """

    def rehearse(self, arguments: Sequence[str]) -> str | None:
        """Start a relay that ends before its first message; return the reason why it cannot start, None if it can."""

    def rehearse_half(self, arguments: Sequence[str]) -> str | None:
        """Look for the program of the relay's half of a bridge; return the reason why it cannot start, None if it can."""

    def prepare(self) -> None:
        """Check that relays can be started on the device, and make room for their traces.

        Raises:
            BackendUnavailableError, OptionError: as `check`.
        """

    def start(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        """Start a relay that writes the trace `segment`."""

    def start_half(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        """Start the relay's half of a bridge, beside the relay that writes `segment`."""

    def collect(self, segment: str) -> Path | None:
        """Return the path of the trace `segment` on this machine, None if it was never begun.

        Raises:
            BackendUnavailableError: the device cannot be reached.
        """

    def discard(self, segment: str) -> None:
        """Remove the trace `segment`; all of it is in the cells' files."""

    def clear(self, kept: Collection[str]) -> None:
        """Remove what an interrupted sweep left on the device, but for the segments `kept`.

        Raises:
            BackendUnavailableError: the device cannot be reached.
        """


class LocalDevice:
    """This machine.

    Args:
        folder: folder of the relays' traces and logs.
        command: `dds-record`, with the words that must precede it.
        held: file descriptor of the lock of the sweep's folder.
    """

    keeps_traces = False

    def __init__(self, folder: Path, command: Sequence[str], held: int | None = None) -> None:
        self._folder = folder
        self._command = command
        self._held = held

    def check(self) -> None:
        """Check nothing: this machine runs the sweep itself."""

    def rehearse(self, arguments: Sequence[str]) -> str | None:
        """Rehearse a relay on this machine."""
        return rehearse_program([*self._command, *arguments], self._folder)

    def rehearse_half(self, arguments: Sequence[str]) -> str | None:
        """Raise: on one machine the ping's `dds-record` runs both halves."""
        raise NotImplementedError

    def prepare(self) -> None:
        """Prepare nothing: the folder for parts is there."""

    def start(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        """Start a relay on this machine."""
        command = [*self._command, *arguments, "--out", str(self._folder / segment)]
        return Program(command, log_path(self._folder, segment), held=self._held)

    def start_half(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        """Raise: on one machine the ping's `dds-record` runs both halves."""
        raise NotImplementedError

    def collect(self, segment: str) -> Path | None:
        """Return the path at which the relay wrote its trace."""
        path = self._folder / segment
        return path if path.exists() else None

    def discard(self, segment: str) -> None:
        """Remove trace and log."""
        remove_files(self._folder, segment, (*TRACE_ENDINGS, *LOG_ENDINGS))

    def clear(self, kept: Collection[str]) -> None:
        """Remove nothing: the sweep itself clears the folder for parts."""


class PrintedDevice:
    """A device that a person works: each relay's command is printed, and the pings wait for its echo.

    Args:
        show: prints a line.
    """

    keeps_traces = True

    def __init__(self, show: Callable[[str], None]) -> None:
        self._show = show
        self._running = False

    def check(self) -> None:
        """Check nothing: the device cannot be reached from here."""

    def rehearse(self, arguments: Sequence[str]) -> str | None:  # noqa: ARG002 - the role's signature
        """Return None: the person who starts the relay sees why it does not start."""
        return None

    def rehearse_half(self, arguments: Sequence[str]) -> str | None:  # noqa: ARG002 - the role's signature
        """Return None: as of a relay."""
        return None

    def prepare(self) -> None:
        """Prepare nothing: the device cannot be reached from here."""

    def start(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        """Print the command to start on the device."""
        before = "end the relay there (Ctrl-C), then start" if self._running else "start on the other device"
        self._running = True
        self._show(f"{before}: {printed_command(arguments, segment.split('-', maxsplit=1)[0])}")
        return _PrintedRelay()

    def start_half(self, arguments: Sequence[str], segment: str) -> StartedProgram:  # noqa: ARG002 - the role's signature
        """Print the command to start beside the relay."""
        self._show(f"and beside it: dds-bridge {shlex.join(arguments)}")
        return _PrintedRelay()

    def collect(self, segment: str) -> Path | None:  # noqa: ARG002 - the role's signature
        """Return None: the trace stays on the device; copied into the sweep's folder later, it is paired by its run ids."""
        return None

    def discard(self, segment: str) -> None:
        """Remove nothing: no trace is on this machine."""

    def clear(self, kept: Collection[str]) -> None:
        """Remove nothing: the device is the person's."""


def printed_command(arguments: Sequence[str], number: int | str) -> str:
    """Return the command line of a group's relay as a person types it: without the defaults of that device."""
    return f"DDS_TRACE_CONFIG= dds-record {shlex.join(arguments)} --out relay-{number}.mcap"


class _PrintedRelay:
    """A relay that a person runs; nothing is known of it."""

    failure = None
    exit_code = None

    def stop(self) -> None:
        """Leave the relay to its person."""


def log_path(folder: Path, segment: str) -> Path:
    """Return the path of the log of a relay that writes the trace `segment`."""
    return folder / f"{segment}.log"
