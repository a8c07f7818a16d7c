"""A running bridge: `open_bridge` starts its programs and ends them."""

from __future__ import annotations

import shutil
import socket
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from enum import Enum
from pathlib import Path

from dds_trace.base.errors import BackendUnavailableError
from dds_trace.tracefile.format.json_fields import Json

from ...applied.differences import Difference
from ...errors import BridgeError
from ..base import Bridge, BridgeOptions, Half, load_bridge, split_halves
from .programs import program_environment
from .read_back import ProgramReadBack
from .supervise import SupervisedProgram, describe_end, killing_signal

UP_TIMEOUT_S = 20.0
"""ROS 2 on a small board needs seconds to start."""


class BridgeState(Enum):
    STARTING = "starting"
    READY = "ready"  # an echo has come back through it
    STOPPED = "stopped"  # was ready until it was asked to stop
    NEVER_READY = "never_ready"  # was asked to stop before any echo
    DIED = "died"  # ended by itself


@dataclass(frozen=True, slots=True)
class _RunningHalf:
    options: BridgeOptions
    version: str
    configuration: str
    environment: Mapping[str, str]
    program: SupervisedProgram
    read_back: ProgramReadBack

    @property
    def half(self) -> Half:
        return self.options.half

    @property
    def label(self) -> str:
        return "bridge" if self.half is Half.BOTH else f"bridge_{self.half.value}"


class RunningBridge:
    """A bridge with its programs running; `mark_ready` follows the first echo."""

    def __init__(self, bridge: Bridge, options: BridgeOptions, halves: tuple[_RunningHalf, ...]) -> None:
        self.name = bridge.name
        self.options = options
        self._halves = halves
        self._ready = False
        self._stopped = False

    def mark_ready(self) -> None:
        self._ready = True

    @property
    def state(self) -> BridgeState:
        if self.failure is not None:
            return BridgeState.DIED
        if self._stopped:
            return BridgeState.STOPPED if self._ready else BridgeState.NEVER_READY
        return BridgeState.READY if self._ready else BridgeState.STARTING

    @property
    def failure(self) -> str | None:
        failed = self._failed_half()
        if failed is None or failed.program.report is None:
            return None
        code = failed.program.report.exit_code
        end = describe_end(code, failed.program.last_line())
        return f"the bridge {self.name} " + (
            f"was {end}" if killing_signal(code) else f"ended with status {code}: {end}"
        )

    def check(self) -> None:
        if (failure := self.failure) is not None:
            raise BridgeError(f"{failure}; run `dds-bridge {self.name}` to see its log")

    @property
    def parts(self) -> tuple[BridgeOptions, ...]:
        return tuple(half.options for half in self._halves)

    @property
    def processes(self) -> Mapping[str, int]:
        return {half.label: half.program.pid for half in self._halves}

    def read_applied(self) -> tuple[Difference, ...]:
        for half in self._halves:
            half.read_back.read()
        return tuple(setting for half in self._halves for setting in half.read_back.not_applied)

    def describe(self) -> dict[str, Json]:
        return {
            "bridge": self.name,
            "state": self.state.value,
            "ping_domain_id": self.options.ping_domain_id,
            "relay_domain_id": self.options.relay_domain_id,
            "failure": self.failure,
            "programs": [
                {
                    "half": half.half.value,
                    "version": half.version,
                    # Without folders: a trace is passed on to others.
                    "command": [Path(part).name if part.startswith("/") else part for part in half.program.command],
                    "configuration": half.configuration,
                    "environment": dict(half.environment),
                    "log_tail": self.log_tail(half.half),
                    "read_back": half.read_back.fields(),
                    **(asdict(half.program.report) if half.program.report else {}),
                }
                for half in self._halves
            ],
        }

    def sample(self) -> dict[str, Json]:
        return {
            "monotonic_ns": time.monotonic_ns(),
            "bridge": self.name,
            "programs": {half.label: asdict(half.program.load()) for half in self._halves},
        }

    def log_tail(self, half: Half | None = None) -> str:
        default = self._failed_half() or self._halves[0]
        return next((part for part in self._halves if part.half is half), default).program.log_tail()

    def wait_until_up(self, timeout_s: float) -> None:
        deadline = time.monotonic() + timeout_s
        for half in self._halves:
            while not half.program.is_up:
                self.check()
                if time.monotonic() > deadline:
                    raise BridgeError(
                        f"the bridge {self.name} did not come up within {timeout_s:g} s: {half.program.last_line()}; "
                        f"run `dds-bridge {self.name}` to see its log"
                    )
                time.sleep(0.02)
        self.check()

    def stop(self) -> None:
        for half in self._halves:
            half.program.stop()
        self._stopped = True

    def _failed_half(self) -> _RunningHalf | None:
        reports = ((half, half.program.report) for half in self._halves)
        return next((half for half, report in reports if report is not None and not report.asked), None)


@contextmanager
def open_bridge(name: str, options: BridgeOptions, *, up_timeout_s: float = UP_TIMEOUT_S) -> Iterator[RunningBridge]:
    """Run a bridge during the block; no message has crossed yet when the block starts.

    Raises:
        OptionError: there is no such bridge, or it does not support the options.
        BackendUnavailableError: its program is not on this machine.
        BridgeError: it did not come up in time.
    """
    bridge = load_bridge(name)
    program = find_program(bridge)
    folder = Path(tempfile.mkdtemp(prefix="dds-trace-bridge-"))
    halves: list[_RunningHalf] = []
    running: RunningBridge | None = None
    try:
        version = bridge.version(program)
        for half_options in split_halves(bridge, options, _free_local_link()):
            halves.append(_start_half(bridge, program, version, half_options, folder))  # noqa: PERF401 - after a failed start the list has the started ones
        running = RunningBridge(bridge, options, tuple(halves))
        running.wait_until_up(up_timeout_s)
        yield running
    finally:
        for half in halves:
            half.program.stop()
        if running is not None:
            running.stop()
        shutil.rmtree(folder, ignore_errors=True)


def find_program(bridge: Bridge) -> Path:
    program = bridge.find()
    if program is None:
        raise BackendUnavailableError(f"the bridge {bridge.name} is not installed; {bridge.install}")
    return program


def _start_half(bridge: Bridge, program: Path, version: str, options: BridgeOptions, folder: Path) -> _RunningHalf:
    folder = folder / options.half.value
    folder.mkdir()
    text = bridge.configuration(options)
    file = folder / f"configuration{bridge.suffix}"
    file.write_text(text)
    extra = bridge.environment(options)
    variables = program_environment(extra, foreign=program != Path(sys.executable))
    command = (str(program), *bridge.arguments(program), str(file))
    supervised = SupervisedProgram(command, folder, variables, bridge.up_pattern)
    read_back = ProgramReadBack(bridge, options, supervised.pid)
    if options.keys is not None:  # a trace has no private path
        text = text.replace(options.keys, "KEYS")
    return _RunningHalf(options, version, text, extra, supervised, read_back)


def _free_local_link() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{probe.getsockname()[1]}"
