"""The devices that a relay may run on: this machine, and one that a person works; `ssh.py` has the third."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Protocol

from .programs import Program

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path


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

    def prepare(self) -> None:
        """Check that relays can be started on the device.

        Raises:
            BackendUnavailableError: the device or its `dds-record` cannot be reached.
            OptionError: the device has another version of dds-trace.
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

    def prepare(self) -> None:
        """Check nothing: this machine runs the sweep itself."""

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
        for path in self._folder.glob(f"{segment}*"):
            path.unlink()


class PrintedDevice:
    """A device that a person works: each relay's command is printed, and the pings wait for its echo.

    Args:
        show: prints a line.
    """

    keeps_traces = True

    def __init__(self, show: Callable[[str], None]) -> None:
        self._show = show
        self._running = False

    def prepare(self) -> None:
        """Check nothing: the device cannot be reached from here."""

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


def printed_command(arguments: Sequence[str], number: int | str) -> str:
    """Return the command line of a group's relay as a person types it."""
    return f"dds-record {shlex.join(arguments)} --out relay-{number}.mcap"


class _PrintedRelay:
    """A relay that a person runs; nothing is known of it."""

    failure = None
    exit_code = None

    def stop(self) -> None:
        """Leave the relay to its person."""


def log_path(folder: Path, segment: str) -> Path:
    """Return the path of the log of a relay that writes the trace `segment`."""
    return folder / f"{segment}.log"
