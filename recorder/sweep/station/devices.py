"""Where a relay runs: on this machine, on another through `ssh`, or wherever a person starts it."""

from __future__ import annotations

import shlex
import shutil
import subprocess
from typing import TYPE_CHECKING, Protocol

from dds_trace.tracefile import BackendUnavailableError, OptionError, __version__

from .programs import Program

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from ..plan.plan import DeviceSettings

SSH_TIMEOUT_S = 60.0


class StartedProgram(Protocol):
    """A relay, or a half of a bridge, that was started on its device."""

    @property
    def failure(self) -> str | None:
        """What it said when it ended by itself, None while it runs."""

    @property
    def exit_code(self) -> int | None:
        """Its exit code if it has ended."""

    def stop(self) -> None:
        """Ends it; its trace is closed when this returns."""


class RelayDevice(Protocol):
    """Starts relays and brings their traces."""

    @property
    def keeps_traces(self) -> bool:
        """Whether the traces stay there for a person to bring."""

    def prepare(self) -> None:
        """Checks that relays can be started there.

        Raises:
            BackendUnavailableError: the device or its `dds-record` cannot be reached.
            OptionError: it has another version of dds-trace.
        """

    def start(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        """A relay that writes the trace `segment`."""

    def start_half(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        """The relay's half of a bridge, beside the relay that writes `segment`."""

    def collect(self, segment: str) -> Path | None:
        """The trace `segment` on this machine, None if it was never begun.

        Raises:
            BackendUnavailableError: the device cannot be reached.
        """

    def discard(self, segment: str) -> None:
        """Removes the trace `segment` once all of it is in the cells' files."""


class LocalDevice:
    """This machine.

    Args:
        folder: for the relays' traces and logs.
        command: `dds-record`, with what has to stand before it.
        held: the lock of the sweep's folder.
    """

    keeps_traces = False

    def __init__(self, folder: Path, command: Sequence[str], held: int | None = None) -> None:
        self._folder = folder
        self._command = command
        self._held = held

    def prepare(self) -> None:
        """Nothing is needed."""

    def start(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        """A relay on this machine."""
        command = [*self._command, *arguments, "--out", str(self._folder / segment)]
        return _RelayProgram(Program(command, _log_path(self._folder, segment), held=self._held))

    def start_half(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        """Not called: on one machine the ping's `dds-record` runs both halves."""
        raise NotImplementedError

    def collect(self, segment: str) -> Path | None:
        """The trace, where it was written."""
        path = self._folder / segment
        return path if path.exists() else None

    def discard(self, segment: str) -> None:
        """Removes trace and log."""
        for path in self._folder.glob(f"{segment}*"):
            path.unlink()


class SshDevice:
    """Another machine, through the system's `ssh` and with its keys.

    The relay's shell there ends it when its standard input closes: at the word of this machine, or when the
    connection or this machine is gone. Its traces lie under `~/.cache/dds-trace/SWEEP/` until they are fetched.

    Args:
        folder: on this machine, for the traces when they are fetched, and for logs.
        sweep: names the folder there.
    """

    keeps_traces = False

    def __init__(self, settings: DeviceSettings, folder: Path, sweep: str) -> None:
        assert settings.ssh is not None
        self._host = settings.ssh
        self._ssh = [
            *("ssh", "-o", "BatchMode=yes", "-o", "ConnectTimeout=10", "-o", "ServerAliveInterval=5"),
            *(*settings.ssh_options, settings.ssh),
        ]
        # The folder is not quoted, so that the shell there expands its ~.
        path = f"PATH={settings.path}:$PATH" if settings.path else ":"
        # What the setup prints is not to be taken for an answer.
        self._setup = f"{{ {path} && {settings.setup or ':'}; }} >&2 || exit 127;"
        self._folder = folder
        self._remote = f'"$HOME"/.cache/dds-trace/{shlex.quote(sweep)}'

    def prepare(self) -> None:
        """Makes the folder there and compares versions."""
        said = self._run(f"mkdir -p {self._remote} && dds-sweep --version").split()
        there = said[-1] if said else "nothing"
        if there != __version__:
            raise OptionError(
                f"{self._host} has dds-trace {there}, this machine {__version__}; install the same on both, "
                "as unlike recorders are not one measurement",
            )

    def start(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        """A relay there."""
        command = f"dds-record {shlex.join(arguments)} --out {self._remote}/{shlex.quote(segment)}"
        return self._start(command, self._pid_file(segment), _log_path(self._folder, segment))

    def start_half(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        """A half there."""
        name = f"{segment}.half"
        return self._start(
            f"dds-bridge {shlex.join(arguments)}", self._pid_file(name), _log_path(self._folder, name)
        )

    def _start(self, command: str, pid: str, log: Path) -> StartedProgram:
        # A command in the background reads from /dev/null unless it is given a copy of the input.
        script = (
            f"{self._setup} exec 3<&0; {command} </dev/null 3<&- & program=$!; echo $program >{pid}; "
            "{ cat <&3 >/dev/null; kill -TERM $program; } 2>/dev/null & watch=$!; "
            f"wait $program; code=$?; rm -f {pid}; kill $watch 2>/dev/null; exit $code"
        )
        return _RelayProgram(Program([*self._ssh, script], log, stops_by_input=True))

    def collect(self, segment: str) -> Path | None:
        """Copies the trace here, and the ring beside it if its relay was killed."""
        pid = self._pid_file(segment)
        # Where the connection broke, the relay there may still be closing its trace.
        self._run(
            f"for i in $(seq 100); do kill -0 $(cat {pid}) 2>/dev/null || break; sleep 0.2; done; rm -f {pid}"
        )
        names = self._run(f"cd {self._remote} && ls -d {shlex.quote(segment)}* 2>/dev/null || true").split()
        for name in names:
            with (self._folder / name).open("wb") as file:
                self._call(f"cat {self._remote}/{shlex.quote(name)}", file)
        return self._folder / segment if segment in names else None

    def discard(self, segment: str) -> None:
        """Removes trace and log, here and there."""
        self._run(f"rm -f {self._remote}/{shlex.quote(segment)}*")
        for path in self._folder.glob(f"{segment}*"):
            path.unlink()

    def _pid_file(self, segment: str) -> str:
        return f"{self._remote}/pid-{shlex.quote(segment)}"

    def _run(self, script: str) -> str:
        return self._call(script, subprocess.PIPE).decode(errors="replace")

    def _call(self, script: str, output: object) -> bytes:
        if shutil.which("ssh") is None:
            raise BackendUnavailableError("ssh is not installed; apt install openssh-client")
        try:
            done = subprocess.run(
                [*self._ssh, f"{self._setup} {script}"],
                stdin=subprocess.DEVNULL,
                stdout=output,  # type: ignore[call-overload]  # a file or PIPE
                stderr=subprocess.PIPE,
                timeout=SSH_TIMEOUT_S,
                check=True,
            )
        except subprocess.CalledProcessError as err:
            said = err.stderr.decode(errors="replace").strip().splitlines() or [f"status {err.returncode}"]
            raise BackendUnavailableError(
                f"{self._host}: {said[-1]}; try it by hand: ssh {self._host}"
            ) from err
        except subprocess.TimeoutExpired as err:
            raise BackendUnavailableError(f"{self._host}: no answer within {SSH_TIMEOUT_S:g} s") from err
        return done.stdout or b""


class PrintedDevice:
    """A device that a person works: each relay's command is shown, and the pings wait for its echo.

    Args:
        show: prints a line.
    """

    keeps_traces = True

    def __init__(self, show: Callable[[str], None]) -> None:
        self._show = show
        self._running = False

    def prepare(self) -> None:
        """Nothing can be checked."""

    def start(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        """Shows the command to start there."""
        before = "end the relay there (Ctrl-C), then start" if self._running else "start on the other device"
        self._running = True
        self._show(f"{before}: {printed_command(arguments, segment.split('-', maxsplit=1)[0])}")
        return _PrintedRelay()

    def start_half(self, arguments: Sequence[str], segment: str) -> StartedProgram:  # noqa: ARG002 - the role's signature
        """Shows the command to start beside the relay there."""
        self._show(f"and beside it: dds-bridge {shlex.join(arguments)}")
        return _PrintedRelay()

    def collect(self, segment: str) -> Path | None:  # noqa: ARG002 - the role's signature
        """The trace stays there; copied into the sweep's folder later, it is paired by its run ids."""
        return None

    def discard(self, segment: str) -> None:
        """Nothing is here."""


def printed_command(arguments: Sequence[str], number: int | str) -> str:
    """The command line of a group's relay as a person types it."""
    return f"dds-record {shlex.join(arguments)} --out relay-{number}.mcap"


class _RelayProgram:
    def __init__(self, program: Program) -> None:
        self._program = program

    @property
    def failure(self) -> str | None:
        return None if self._program.exit_code is None else self._program.last_words()

    @property
    def exit_code(self) -> int | None:
        return self._program.exit_code

    def stop(self) -> None:
        self._program.stop()


class _PrintedRelay:
    failure = None
    exit_code = None

    def stop(self) -> None:
        """A person ends it."""


def _log_path(folder: Path, segment: str) -> Path:
    return folder / f"{segment}.log"
