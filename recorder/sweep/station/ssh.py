"""Another machine as the relay's device, through the system's `ssh`."""

from __future__ import annotations

import shlex
import shutil
import subprocess
from typing import TYPE_CHECKING

from dds_trace.tracefile import BackendUnavailableError, OptionError, __version__

from .devices import log_path
from .programs import Program

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path
    from typing import IO

    from ..plan.plan import DeviceSettings
    from .devices import StartedProgram

SSH_TIMEOUT_S = 60.0


class SshDevice:
    """Another machine, through the system's `ssh` and with its keys.

    The shell there ends the relay when its standard input closes: because this machine closes it, or because the
    connection or this machine is gone. The traces lie there in `~/.cache/dds-trace/SWEEP/` until they are fetched.

    Args:
        settings: the device of the plan; its `ssh` is set.
        folder: folder on this machine for the fetched traces and for logs.
        sweep: name of the folder there.
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
        # The output of the setup must not be taken for an answer.
        self._setup = f"{{ {path} && {settings.setup or ':'}; }} >&2 || exit 127;"
        self._folder = folder
        self._remote = f'"$HOME"/.cache/dds-trace/{shlex.quote(sweep)}'

    def prepare(self) -> None:
        """Make the folder there and compare versions."""
        answer = self._run(f"mkdir -p {self._remote} && dds-sweep --version").split()
        there = answer[-1] if answer else "nothing"
        if there != __version__:
            raise OptionError(
                f"{self._host} has dds-trace {there}, this machine {__version__}; install the same on both, "
                "as unlike recorders are not one measurement",
            )

    def start(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        """Start a relay there."""
        command = f"dds-record {shlex.join(arguments)} --out {self._remote}/{shlex.quote(segment)}"
        return self._start(command, self._pid_file(segment), log_path(self._folder, segment))

    def start_half(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        """Start a half there."""
        name = f"{segment}.half"
        return self._start(
            f"dds-bridge {shlex.join(arguments)}", self._pid_file(name), log_path(self._folder, name)
        )

    def _start(self, command: str, pid: str, log: Path) -> StartedProgram:
        # A command in the background reads from /dev/null unless it is given a copy of the input.
        script = (
            f"{self._setup} exec 3<&0; {command} </dev/null 3<&- & program=$!; echo $program >{pid}; "
            "{ cat <&3 >/dev/null; kill -TERM $program; } 2>/dev/null & watch=$!; "
            f"wait $program; code=$?; rm -f {pid}; kill $watch 2>/dev/null; exit $code"
        )
        return Program([*self._ssh, script], log, stops_by_input=True)

    def collect(self, segment: str) -> Path | None:
        """Copy the trace here, with the ring beside it if its relay was killed."""
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
        """Remove trace and log, here and there."""
        self._run(f"rm -f {self._remote}/{shlex.quote(segment)}*")
        for path in self._folder.glob(f"{segment}*"):
            path.unlink()

    def _pid_file(self, segment: str) -> str:
        return f"{self._remote}/pid-{shlex.quote(segment)}"

    def _run(self, script: str) -> str:
        return self._call(script, subprocess.PIPE).decode(errors="replace")

    def _call(self, script: str, output: int | IO[bytes]) -> bytes:
        if shutil.which("ssh") is None:
            raise BackendUnavailableError("ssh is not installed; apt install openssh-client")
        try:
            done = subprocess.run(
                [*self._ssh, f"{self._setup} {script}"],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.PIPE,
                timeout=SSH_TIMEOUT_S,
                check=True,
            )
        except subprocess.CalledProcessError as err:
            lines = err.stderr.decode(errors="replace").strip().splitlines() or [f"status {err.returncode}"]
            raise BackendUnavailableError(
                f"{self._host}: {lines[-1]}; try it by hand: ssh {self._host}"
            ) from err
        except subprocess.TimeoutExpired as err:
            raise BackendUnavailableError(
                f"{self._host}: no answer within {SSH_TIMEOUT_S:g} s; look at the device and its network"
            ) from err
        return done.stdout or b""
