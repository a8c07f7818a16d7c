"""The relay's device: this machine, or one that a person operates."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Protocol

from dds_trace.recorder.choices import Role
from dds_trace.recorder.option_table import typed_words

from ..folder import LOG_ENDINGS, TRACE_ENDINGS, log_path, place_of, remove_files
from .programs import DEFAULTS_VARIABLE, Program, rehearse_program


class StartedProgram(Protocol):
    """A relay, or half of a bridge, on its device."""

    @property
    def failure(self) -> str | None:
        """Reason of its end, None while it runs."""

    @property
    def exit_code(self) -> int | None: ...

    @property
    def relay_id(self) -> int | None:
        """The number of a relay in its replies, None before it serves."""

    def stop(self) -> object:
        """End the program and wait until its trace is closed."""

    def kill(self) -> object: ...


class RelayDevice:
    keeps_traces = False
    """Whether the traces stay on the device until a person copies them."""

    def check(self) -> None:
        """Check that relays of this version can start there."""

    def rehearse(self, arguments: Sequence[str]) -> str | None:  # noqa: ARG002 - the signature of all devices
        return None

    def rehearse_half(self, arguments: Sequence[str]) -> str | None:  # noqa: ARG002
        return None

    def prepare(self) -> None:
        """Check the device, and make a folder for traces there."""

    def start(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        raise NotImplementedError

    def start_half(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        raise NotImplementedError

    def collect(self, segment: str) -> Path | None:  # noqa: ARG002
        return None

    def discard(self, segment: str) -> None: ...

    def clear(self, keep: Collection[str]) -> None:
        """Remove traces of an interrupted sweep, except these segments."""


class LocalDevice(RelayDevice):
    def __init__(
        self, folder: Path, command: Sequence[str], lock: int | None = None, bridge: Sequence[str] = ()
    ) -> None:
        self._folder = folder
        self._command = command
        self._lock = lock
        self._bridge = bridge

    def rehearse(self, arguments: Sequence[str]) -> str | None:
        return rehearse_program([*self._command, *arguments], self._folder)

    def start(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        command = [*self._command, *arguments, "--out", str(self._folder / segment)]
        return Program(command, log_path(self._folder, segment), lock=self._lock)

    def start_half(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        return Program([*self._bridge, *arguments], log_path(self._folder, f"{segment}.half"), lock=self._lock)

    def collect(self, segment: str) -> Path | None:
        path = self._folder / segment
        return path if path.exists() else None

    def discard(self, segment: str) -> None:
        remove_files(self._folder, segment, (*TRACE_ENDINGS, *LOG_ENDINGS))


class SpreadDevice(RelayDevice):
    def __init__(self, hosts: Sequence[RelayDevice]) -> None:
        self.hosts = hosts

    def _host(self, segment: str) -> RelayDevice:
        return self.hosts[place_of(segment)[1]]

    def check(self) -> None:
        for host in self.hosts:
            host.check()

    def rehearse(self, arguments: Sequence[str]) -> str | None:
        return next(filter(None, (host.rehearse(arguments) for host in self.hosts)), None)

    def prepare(self) -> None:
        for host in self.hosts:
            host.prepare()

    def start(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        return self._host(segment).start(arguments, segment)

    def collect(self, segment: str) -> Path | None:
        return self._host(segment).collect(segment)

    def discard(self, segment: str) -> None:
        self._host(segment).discard(segment)

    def clear(self, keep: Collection[str]) -> None:
        for host in self.hosts:
            host.clear(keep)


class PrintedDevice(RelayDevice):
    keeps_traces = True

    def __init__(self, show: Callable[[str], None]) -> None:
        self._show = show
        self._is_running = False

    def start(self, arguments: Sequence[str], segment: str) -> StartedProgram:
        prefix = "end the relay there (Ctrl-C), then start" if self._is_running else "start on the other device"
        self._is_running = True
        self._show(f"{prefix}: {printed_command(arguments, segment.split('-', maxsplit=1)[0])}")
        return _PrintedProgram()

    def start_half(self, arguments: Sequence[str], segment: str) -> StartedProgram:  # noqa: ARG002
        self._show(f"and next to it: dds-trace bridge {shlex.join(arguments)}")
        return _PrintedProgram()


def printed_command(arguments: Sequence[str], number: int | str) -> str:
    _, role, *options = arguments
    words = ["dds-trace", "record", role, *typed_words(options, Role(role)), "--out", f"relay-{number}.mcap"]
    return f"{DEFAULTS_VARIABLE}= {shlex.join(words)}"


class _PrintedProgram:
    failure = None
    exit_code = None
    relay_id = None

    def stop(self) -> None: ...

    kill = stop
