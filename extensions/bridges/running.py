"""A running bridge: `open_bridge` starts its programs and ends them."""

from __future__ import annotations

import socket
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from enum import Enum
from pathlib import Path

import psutil

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.base.records import to_json
from dds_trace.recorder.applied.applied import Applied, read_applied
from dds_trace.recorder.applied.asked import Asked, asked_settings
from dds_trace.recorder.applied.differences import Difference, differences
from dds_trace.recorder.backends import load_backend
from dds_trace.recorder.choices import Security
from dds_trace.recorder.errors import BridgeError
from dds_trace.recorder.options import PingOptions, RecordOptions
from dds_trace.recorder.payloads.base import DataType
from dds_trace.tracefile.format.json_fields import Json

from . import BRIDGE_MODULES
from .base import BRIDGED_TOPICS, Bridge, BridgedTopic, BridgeOptions, Half, load_bridge, split_halves
from .programs import program_environment
from .supervise import SupervisedProgram, describe_end, killing_signal

LINK_MIDDLEWARES = ("zenoh", "socket")
"""Middlewares that join the halves of a bridge; `-o transport` and `--tuned` are not for them."""


class ProgramReadBack:
    """What one program of a bridge uses, read after the first echo and before the program is stopped."""

    def __init__(self, bridge: Bridge, options: BridgeOptions, pid: int) -> None:
        self._bridge = bridge
        self._options = options
        self._pid = pid  # or its first child that has sockets, if it is a script
        self._requested: tuple[Asked, ...] = ()
        self._applied: Applied | None = None

    def read(self) -> None:
        if self._applied is None:
            self._pid = self._pid_with_sockets()
        applied = read_applied(self._applied, self._pid)
        if applied.latest.sockets is None:  # it has ended, or is another user's
            return
        self._applied = applied
        vendors = (library.vendor for library in applied.begin.libraries)
        vendor = next((vendor for vendor in vendors if vendor not in LINK_MIDDLEWARES), self._bridge.compiled_in)
        self._requested = tuple(
            asked_settings(
                vendor,
                domain_id=side.domain_id,
                transport=self._options.transport.value,
                tuned=self._options.tuned,
                discovery=self._options.discovery.value,
            )
            for side in self._options.sides()
        )

    def _pid_with_sockets(self) -> int:
        pids = [self._pid]
        with suppress(psutil.Error):
            pids += [child.pid for child in psutil.Process(self._pid).children(recursive=True)]
        return next((pid for pid in pids if read_applied(pid=pid).begin.sockets), self._pid)

    @property
    def not_applied(self) -> tuple[Difference, ...]:
        if self._applied is None:
            return ()
        name = self._bridge.name
        by_setting = {
            difference.setting: replace(
                difference, asked=f"{name}: {difference.asked}", words=f"the bridge {name}: {difference.words}"
            )
            for requested in self._requested
            for difference in differences(requested, self._applied)
        }
        return tuple(by_setting.values())

    def fields(self) -> dict[str, Json]:
        if self._applied is None:
            return {}
        return {
            "asked": to_json(self._requested),
            "applied": to_json(self._applied),
            "not_applied": to_json(self.not_applied),
        }


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

    def __init__(self, bridge: Bridge, options: BridgeOptions, halves: Sequence[_RunningHalf]) -> None:
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
            raise BridgeError(f"{failure}; run `dds-trace bridge {self.name}` to see its log")

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
                        f"run `dds-trace bridge {self.name}` to see its log"
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
    """Run a bridge during the block, through which no message has crossed yet; a `TraceError` where it cannot."""
    bridge = load_bridge(name)
    program = find_program(bridge)
    version = bridge.version(program)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        link = f"127.0.0.1:{probe.getsockname()[1]}"
    halves: list[_RunningHalf] = []
    running = RunningBridge(bridge, options, halves)
    with tempfile.TemporaryDirectory(prefix="dds-trace-bridge-", ignore_cleanup_errors=True) as folder:
        try:
            for half_options in split_halves(bridge, options, link):
                halves.append(_start_half(bridge, program, version, half_options, Path(folder)))  # noqa: PERF401 - after a failed start the list has the started ones
            running.wait_until_up(up_timeout_s)
            yield running
        finally:
            running.stop()


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


def check_requested_bridge(options: RecordOptions, ping: PingOptions, data_type: DataType) -> BridgeOptions | None:
    """Return the requested bridge's options, None if it runs already; an `OptionError` for one that does not support them."""
    bridge = load_bridge(ping.bridge)
    # Also if it already runs: the trace keeps its name.
    if bridge.needs_ros_nodes and not load_backend(options.backend).has_ros:
        raise OptionError(
            f"--bridge {ping.bridge}: it finds nodes by ros_discovery_info, which nodes of the backend {options.backend} do "
            "not publish; use --backend ros2, or zenoh-bridge-dds"
        )
    if ping.bridge_running:
        return None
    node = options.node
    if node.security is not Security.OFF and not (bridge.secures_link and node.security is Security.ENCRYPT_RTPS):
        names = ", ".join(name for name in BRIDGE_MODULES if load_bridge(name).secures_link)
        raise OptionError(
            f"-o security={node.security.value} with --bridge {ping.bridge}: what can be secured is the link between two halves, by "
            f"TLS (encrypt-rtps) of {names}"
        )
    topic = BridgedTopic(data_type.topic, data_type.type_name)
    bridge_options = BridgeOptions(
        node.domain_id,
        node.domain_id if ping.relay_domain_id is None else ping.relay_domain_id,
        topics=tuple(dict.fromkeys((*BRIDGED_TOPICS, topic))),
        qos=node.qos,
        discovery=node.discovery,
        transport=node.transport,
        tuned=node.tuned,
        listen=ping.bridge_listen,
        peers=ping.bridge_peers,
        keys=node.keys,
    )
    split_halves(bridge, bridge_options)
    return bridge_options
