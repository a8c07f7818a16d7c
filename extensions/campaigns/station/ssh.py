"""Another machine as the relay's device, through `ssh`."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import select
import shlex
import shutil
import subprocess
import tempfile
import time
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import IO, BinaryIO

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.base.files import create_file, mode_within, read_settings, replacing
from dds_trace.base.units import counted
from dds_trace.base.version import __version__

from ..folder import LOG_ENDINGS, TRACE_ENDINGS, log_path, remove_files
from ..plan.plan import DeviceSettings
from .devices import RelayDevice, StartedProgram
from .programs import DEFAULTS_VARIABLE, Program

SSH_TIMEOUT_S = 60.0
MOST_TRACE_BYTES = 1 << 30
"""Largest fetched trace: a hundred million events."""

MOST_ANSWER_BYTES = 1 << 16
_COPY_BYTES = 1 << 18
_POLL_S = 0.2
_WAIT_FOR_END = "for i in $(seq 100); do kill -0 $(cat {pid}) 2>/dev/null || break; sleep 0.2; done; rm -f {pid}"
"""Waits up to 20 s for the process of the file {pid} to end, and removes the file."""


class SshDevice(RelayDevice):
    """Another machine, through the system's `ssh` and with its keys; it is not trusted (docs/how-to/sweep.md)."""

    def __init__(self, settings: DeviceSettings, folder: Path, sweep: str) -> None:
        assert settings.ssh is not None
        self._host = settings.ssh
        self._ssh = [
            *("ssh", "-o", "BatchMode=yes", "-o", "ConnectTimeout=10", "-o", "ServerAliveInterval=5"),
            *(*settings.ssh_options, "--", settings.ssh),  # a host, whatever it begins with
        ]
        path = f"PATH={quoted_path(settings.path)}:$PATH" if settings.path else ":"
        # The setup prints to stderr, so that its output is not taken for an answer.
        self._setup = f"export {DEFAULTS_VARIABLE}=; {{ {path} && {settings.setup or ':'}; }} >&2 || exit 127;"
        self._folder = folder
        self._remote = f'"$HOME"/.cache/dds-trace/{shlex.quote(sweep)}'

    def check(self) -> None:
        self._compare_versions("")

    def rehearse(self, arguments: Sequence[str]) -> str | None:
        name = f"dds-trace-rehearsal-{os.getpid()}.mcap"
        return self._rehearse(f"cd /; dds-record {self._sent(arguments)} --out {name} --check")

    def rehearse_half(self, arguments: Sequence[str]) -> str | None:
        return self._rehearse(f"dds-trace bridge {shlex.join(arguments)} --check")

    def _rehearse(self, command: str) -> str | None:
        try:
            self._run(command)
        except BackendUnavailableError as err:
            return str(err)
        return None

    def prepare(self) -> None:
        self._compare_versions(f"umask 077; mkdir -p {self._remote} && ")

    def _compare_versions(self, prefix: str) -> None:
        answer = self._run(f"{prefix}dds-trace --version").split()
        there = answer[-1] if answer else "nothing"
        if there != __version__:
            raise OptionError(
                f"{self._host} has dds-trace {there}, this machine {__version__}; install the same version "
                "on both; results of different versions must not be mixed"
            )

    def start(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        command = f"dds-record {self._sent(arguments)} --out {self._remote}/{shlex.quote(segment)}"
        return self._start(command, self._pid_file(segment), log_path(self._folder, segment))

    def _sent(self, arguments: Sequence[str]) -> str:
        """Copy the configuration that the arguments name to the device, and return the words with its name there."""
        words = list(map(shlex.quote, arguments))
        if "--configuration" in arguments:
            number = arguments.index("--configuration") + 1
            path = Path(arguments[number])
            words[number] = f"{self._remote}/{shlex.quote(path.name)}"
            text = read_settings(path, "a configuration", "give the path of a file")
            self._run(f"umask 077; mkdir -p {self._remote} && printf %s {shlex.quote(text)} >{words[number]}")
        return " ".join(words)

    def start_half(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        name = f"{segment}.half"
        return self._start(
            f"dds-trace bridge {shlex.join(arguments)}", self._pid_file(name), log_path(self._folder, name)
        )

    def _start(self, command: str, pid: str, log: Path) -> StartedProgram:
        # The id in the file is this shell's, which ends after the program.
        # A command in the background reads from /dev/null unless it gets a copy of the input.
        script = (
            f"{self._setup} exec 3<&0; echo $$ >{pid}; {command} </dev/null 3<&- & program=$!; "
            "{ cat <&3 >/dev/null; kill -TERM $program; } 2>/dev/null & watch=$!; "
            f"wait $program; code=$?; rm -f {pid}; kill $watch 2>/dev/null; exit $code"
        )
        return Program([*self._ssh, script], log, stops_by_input=True)

    def collect(self, segment: str) -> Path | None:
        # If the connection broke, the relay there may still be closing its trace.
        self._run(_WAIT_FOR_END.format(pid=self._pid_file(segment)))
        fetched = [ending for ending in TRACE_ENDINGS if self._fetch(segment + ending)]
        return self._folder / segment if "" in fetched else None

    def _fetch(self, name: str) -> bool:
        quoted = f"{self._remote}/{shlex.quote(name)}"
        rights = self._run(f"test ! -f {quoted} || stat -c %a {quoted}").strip()
        if not re.fullmatch(r"[0-7]{1,4}", rights, re.ASCII):
            return False
        mode = mode_within(int(rights, 8))
        with replacing(self._folder / name) as draft, create_file(draft, mode) as file:
            self._call(f"cat {quoted}", file, MOST_TRACE_BYTES)
        return True

    def discard(self, segment: str) -> None:
        names = (f"{self._remote}/{shlex.quote(segment + ending)}" for ending in TRACE_ENDINGS)
        self._run(f"rm -f {' '.join(names)}")
        remove_files(self._folder, segment, (*TRACE_ENDINGS, *LOG_ENDINGS))

    def clear(self, keep: Collection[str]) -> None:
        names = " ".join(shlex.quote(name) for name in keep) or "''"
        ended = _WAIT_FOR_END.format(pid='"$pid"')
        self._run(
            f"cd {self._remote} || exit; "
            f'for pid in pid-*; do [ -f "$pid" ] || continue; {ended}; done; '
            'for name in *.mcap *.mcap.ring; do [ -f "$name" ] || continue; '
            f'for keep in {names}; do case "$name" in "$keep"|"$keep".ring) continue 2;; esac; done; '
            'rm -f -- "$name"; done'
        )

    def _pid_file(self, segment: str) -> str:
        return f"{self._remote}/pid-{shlex.quote(segment)}"

    def _run(self, script: str) -> str:
        with tempfile.TemporaryFile() as file:
            self._call(script, file, MOST_ANSWER_BYTES)
            file.seek(0)
            return file.read().decode(errors="replace")

    def _call(self, script: str, output: BinaryIO, most_bytes: int) -> None:
        if shutil.which("ssh") is None:
            raise BackendUnavailableError("ssh is not installed; apt install openssh-client")
        with tempfile.TemporaryFile() as errors:
            process = subprocess.Popen(
                [*self._ssh, f"{self._setup} {script}"], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors
            )
            try:
                assert process.stdout is not None
                fault = _copy(process.stdout, output, errors, most_bytes)
                code = process.wait(1.0) if fault is None else None
            except subprocess.TimeoutExpired:
                code = fault = None
            finally:
                process.kill()
                process.communicate()
            errors.seek(0)
            answer = errors.read(MOST_ANSWER_BYTES).decode(errors="replace").strip().splitlines()
        if fault is not None:
            raise BackendUnavailableError(f"{self._host}: {fault}; look at the device and its network")
        if code != 0:
            lines = answer or [f"status {code}"]
            raise BackendUnavailableError(
                f"{self._host}: {lines[-1]}; try it by hand: ssh -- {shlex.quote(self._host)}"
            )


def _copy(source: IO[bytes], output: BinaryIO, errors: BinaryIO, most_bytes: int) -> str | None:
    deadline_s, copied = time.monotonic() + SSH_TIMEOUT_S, 0
    os.set_blocking(source.fileno(), False)
    while (left_s := deadline_s - time.monotonic()) > 0:
        if max(copied, os.fstat(errors.fileno()).st_size) > most_bytes:
            return f"sent more than {counted(most_bytes, 'byte')}"
        if not select.select([source], [], [], min(left_s, _POLL_S))[0]:
            continue
        data = os.read(source.fileno(), _COPY_BYTES)
        if not data:
            return None
        output.write(data)
        copied += len(data)
    return f"no end of its answer within {SSH_TIMEOUT_S:g} s"


def quoted_path(path: str) -> str:
    home, relative = ("~/", path[2:]) if path.startswith("~/") else ("", path)
    return home + (shlex.quote(relative) if relative else "")


def folder_there(plan: str, folder: Path) -> str:
    """Return a sweep's folder there, with a hash of this machine and folder: plans may share a name."""
    id_file = Path("/etc/machine-id")
    machine = id_file.read_text() if id_file.is_file() else platform.node()
    mark = hashlib.sha256(f"{machine}\0{folder.resolve()}".encode(errors="surrogateescape")).hexdigest()[:8]
    return f"{re.sub(r'[^A-Za-z0-9._-]', '-', plan).lstrip('.-')}-{mark}"
