"""How a recording of any role starts, looks around twice a second, and ends."""

from __future__ import annotations

import os
import secrets
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, TypeAlias, TypeVar

from dds_trace.base.errors import TraceError
from dds_trace.base.extension import load
from dds_trace.base.limits import RELAY_ID
from dds_trace.base.version import __version__
from dds_trace.tracefile.format.descriptions import Run, Session
from dds_trace.tracefile.format.events import HOST_TOPIC
from dds_trace.tracefile.format.json_fields import Json, JsonObject
from dds_trace.tracefile.writing.destination import ClosedTrace, discard
from dds_trace.tracefile.writing.sink import TraceSink

from .backends import load_backend, load_backends, open_node
from .backends.node import Node, NodeOptions
from .choices import Discovery, Security
from .errors import NotAppliedError, NothingHeardError, StoppedError
from .host.clock import SystemClock, measured_step_ns, read_adjtimex
from .host.environment import join_environments
from .host.fingerprint import host_fingerprint, read_boot_id
from .host.process import SPIN_S, StopEvent, apply_privileges, realtime_threads, tuned_gc
from .host.sampling import HostSampler
from .kernel.counters import LOOPBACK, read_interfaces
from .options import RecordOptions, side_settings
from .roles.floor import measured_cost, measured_floor
from .roles.ping import PingThread
from .roles.progress import Progress, Role, Watch
from .roles.read_back import ReadBack
from .security.keys import public_hash

ResultT = TypeVar("ResultT")

_SPUN = (
    f"a thread under -o realtime computed for {SPIN_S:g} s without a pause, and none has that priority any more: the recording ended "
    "there; repeat it without -o realtime, or on another transport"
)
LOOK_S = 0.5


@dataclass(frozen=True, slots=True)
class Recorded:
    """The result of a recording: no `trace` where nothing was met; `error` is why it ended early or what it missed."""

    trace: ClosedTrace | None
    session: Session
    progress: Progress
    run: Run | None = None
    error: TraceError | None = None


Leave: TypeAlias = "Callable[[Recorded | BaseException], AbstractContextManager[object]]"
"""Given the end of a recording with its trace closed: the context in which the middleware is left."""


class Capture:
    """Counts of the wire, here none: `--wire` asks the part `wire` for one that counts."""

    processes: Mapping[str, int] = MappingProxyType({})

    def begin(self, run_id: int | None = None) -> None:
        """Restart counting."""

    def write_run(self, run: Run, sink: TraceSink) -> Run:  # noqa: ARG002 - there is nothing to write
        """Write the counts of a ping's run; return the run with them."""
        return run

    def write_relay(self, relayed: int, session_id: int, sink: TraceSink, *, go_on: bool = False) -> None:
        """Write the counts of a relay since the last time."""


class BaseRecording(ABC):
    """One recording.

    `record` does, in this order: measure costs, open capture and node, `meet` the other side, open the trace, `begin`,
    `look` until the end, count the role's `traffic`, end what delivers (the node's thread), then what consumes (`close`), close the
    trace, leave the middleware.
    """

    ROLE: ClassVar[str]
    HAS_FLOOR: ClassVar[bool] = False
    run: Run | None = None
    error: TraceError | None = None
    role: Role
    wire: Capture
    node: Node
    read_back: ReadBack
    session: Session
    upkeep: Any

    def __init__(
        self,
        options: RecordOptions,
        stop: threading.Event,
        watch: Watch,
        *,
        rehearses: bool,
        load: Any,
        leave: Leave = nullcontext,
    ) -> None:
        self.options = options
        self.rehearses = rehearses
        self.stop = stop
        self.watch = watch
        self.clock = SystemClock()
        self.session_id = secrets.randbits(64)
        self.relay_id = options.relay_id or 1 + secrets.randbelow(RELAY_ID.high)
        self.privileges = apply_privileges(options.cpu_affinity, options.realtime_priority)
        self.costs: dict[str, Json] = {}
        self.bridge: Any = None  # what `open_bridge` of the extension gives
        self.clock_fields: JsonObject = {"resolution_ns": measured_step_ns(), "begin": read_adjtimex()}
        os.environ |= load_backend(options.backend).own_variables(options.node)
        self.environment = dict(os.environ)  # before a node adds what it needs
        self.end_ns: int | None = None
        self._noted_disk = False
        self.load = load  # what `loaded` of the extension gives, if there is a load
        self._leave = leave

    def record(self) -> Recorded:
        with ExitStack() as last, ExitStack() as stack:
            self.prepare(stack)
            self.wire = stack.enter_context(self._open_wire())
            self.node = stack.enter_context(self.open_node(self.ROLE))
            ended: list[Recorded] = []

            def begin_leaving(_kind: object, error: BaseException | None, _trace: object) -> None:
                last.enter_context(self._leave(error or ended[0]))

            stack.push(begin_leaving)
            stack.enter_context(tuned_gc())
            self.read_back = ReadBack(self.node, self.environment, strict=self.options.strict, note=self.watch.note)
            is_met = self.meet(stack)
            self.session = self.describe()
            ended.append(self._record_trace(stack) if is_met else Recorded(None, self.session, self.progress()))
            return ended[0]

    def _record_trace(self, stack: ExitStack) -> Recorded:
        upkeep = load("parts", "upkeep")(self.options, self.session, self.clock.monotonic_ns, self.watch.note)
        self.upkeep = stack.enter_context(upkeep)
        sink = self.upkeep.sink
        if isinstance(self.stop, StopEvent):
            self.stop.last_act = sink.close
        self.begin(stack)
        if self.rehearses:
            self.stop.set()
        duration_s = self.options.duration_s
        self.end_ns = None if duration_s is None else self.clock.monotonic_ns() + round(duration_s * 1e9)
        processes = {**self.wire.processes, **({} if self.bridge is None else self.bridge.processes)}
        with HostSampler(partial(sink.write_json, HOST_TOPIC), processes):
            self.look_until_done()
        self.write_wire()
        self.read_back.read_end(self.role.traffic)
        self.node.stop_receiving()
        trace = self.upkeep.close_trace(**self.close(), **self.fields_at_end())
        self.read_back.report(trace.path)
        recorded = self.result(trace)
        if getattr(self.stop, "is_spinning", False) and recorded.error is None:
            recorded = replace(recorded, error=StoppedError(_SPUN))
        if recorded.trace is None:  # the next try may have the name
            discard(self.upkeep.destination)
        return recorded

    def prepare(self, stack: ExitStack) -> None:  # noqa: ARG002 - a ping opens its payload
        self.measure_costs()

    def meet(self, stack: ExitStack) -> bool:  # noqa: ARG002 - a ping waits for its relay
        """Wait for the other side, if there has to be one; False ends the recording without a trace."""
        return True

    @abstractmethod
    def begin(self, stack: ExitStack) -> None: ...

    def look_until_done(self) -> None:
        while (left_s := self.left_s()) > 0 and not self.read_back.wait(self.stop, min(LOOK_S, left_s)):
            self.raise_error_of_node()
            self.look()

    def look(self) -> None:
        sink = self.upkeep.sink
        if sink.error is not None and not self._noted_disk:
            self._noted_disk = True
            self.watch.note(f"{sink.error}; the node continues to answer; what was written stays readable")
        try:
            self.read_back.report()
        except NotAppliedError:  # before the first message: the trace is empty
            sink.close()
            discard(self.upkeep.destination)
            raise
        for kind in self.node.strangers.take_new():
            self.watch.note(f"somebody else sends here: a {kind} was not accepted; the trace counts further ones")
        progress = self.progress()
        self.upkeep.look(progress.messages, self.read_back.fields)
        self.watch.progress(progress)

    def write_wire(self) -> None:  # noqa: B027 - not every role has such counts
        ...

    def close(self) -> JsonObject:
        """End what consumes; return further fields of the session."""
        return {}

    def progress(self) -> Progress:
        return self.role.progress()

    def result(self, trace: ClosedTrace) -> Recorded:
        """Return the result; without a trace in it the closed one is removed."""
        silence = None if self.rehearses else self.explain_nothing()
        if silence is not None:
            return Recorded(None, self.session, self.progress(), error=NothingHeardError(silence))
        return Recorded(trace, self.session, self.progress(), self.run, self.error or self.upkeep.shortage)

    def explain_nothing(self) -> str | None:
        """Return why a role that is there to hear heard nothing; the result then has no trace."""
        return None

    def measure_costs(self, rate_hz: float | None = None) -> None:
        if self.rehearses or not self.options.own_cost:
            return
        floor = measured_floor(self.options.backend, self._node_options, rate_hz) if self.HAS_FLOOR else {}
        self.costs = {**measured_cost(), **floor}

    @property
    def _has_bridge(self) -> bool:
        return self.options.ping is not None and self.options.ping.bridge != "none"

    @property
    def _node_options(self) -> NodeOptions:
        """The options of the role's node; with a bridge it is not secured, but the bridge's link."""
        node = self.options.node
        return replace(node, security=Security.OFF, keys=None) if self._has_bridge else node

    def _open_wire(self) -> AbstractContextManager[Capture]:
        node, ping = self.options.node, self.options.ping
        other = None if ping is None else ping.relay_domain_id
        if not self.options.wire:
            return nullcontext(Capture())
        opened: AbstractContextManager[Capture] = load("parts", "wire")(
            discovery=node.discovery,
            domain_ids=[node.domain_id, *([] if other is None else [other])],
            note=self.watch.note,
        )
        return opened

    def open_node(self, role: str) -> Node:
        # Unique, so that the node recognizes its own endpoints.
        name = f"dds_trace_{role}_{self.session_id:016x}"
        listens = role == "relay" or (role == "beacon" and not self.options.node.peers)
        return open_node(self.options.backend, replace(self._node_options, name=name, listens=listens))

    def describe(self, role: str | None = None, *, session_id: int | None = None, **extra: Json) -> Session:
        options, role, anchor, middleware = self.options, role or self.ROLE, self.clock.anchor(), self.node.middleware
        connectivity = options.connectivity or default_connectivity(options.node.discovery)
        # Of all backends: ROS middleware reads its vendor's files, and a bridge may have another vendor.
        environment = join_environments(backend.environment for backend in load_backends())
        host = host_fingerprint(middleware.versions, environment)
        return Session(
            session_id=session_id or self.session_id,
            role=role,
            device=options.device or os.uname().nodename,
            backend=middleware.backend,
            vendor=middleware.vendor,
            rmw=middleware.rmw,
            domain_id=self.node.options.domain_id,
            relay_id=self.relay_id if role == "relay" else None,
            connectivity=connectivity,
            wall_anchor_ns=anchor.wall_ns,
            monotonic_anchor_ns=anchor.monotonic_ns,
            host={**host, "middleware": dict(middleware.settings)},
            extra={
                "vendor_label": middleware.vendor_label or load_backend(middleware.backend).label,
                "recorder_version": __version__,
                "boot_id": read_boot_id(),
                **self.privileges,
                **self.costs,
                "settings": side_settings(options, connectivity),
                **self.read_back.fields(),
                "clock": self.clock_fields,
                **extra,
            },
        )

    def fields_at_end(self) -> JsonObject:
        keys, security, strangers = self.options.node.keys, {}, self.node.strangers.counts
        if keys is not None:
            security = {
                "level": self.options.node.security.value,
                "keys_sha256": public_hash(keys),
                "applied": "TLS of the bridge's link" if self._has_bridge else self.node.read_security(),
            }
        return {
            **self.read_back.fields(),
            **({"strangers": dict(sorted(strangers.items()))} if strangers else {}),
            "clock": {**self.clock_fields, "end": read_adjtimex()},
            **(self.load() if self.load else {}),
            **realtime_threads(),
            **({"security": security} if security else {}),
        }

    def look_until_pinged(self, thread: PingThread[ResultT]) -> ResultT | None:
        while not thread.wait(LOOK_S if thread.enough.is_set() else min(LOOK_S, max(self.left_s(), 0))):
            self.look()
            if self.error is not None or getattr(self.stop, "is_repeated", False):
                thread.enough.set()
                thread.hopeless.set()
            if self.stop.is_set() or self.node.error is not None or self.left_s() <= 0:
                thread.enough.set()
        return thread.result()

    def left_s(self) -> float:
        return float("inf") if self.end_ns is None else (self.end_ns - self.clock.monotonic_ns()) / 1e9

    def raise_error_of_node(self) -> None:
        if self.node.error is not None:
            raise self.node.error


def default_connectivity(discovery: Discovery, root: Path = Path("/")) -> str:
    """Return `loopback`, also where no interface leads elsewhere; else `wireless` or `wired` by the default route."""
    if discovery is Discovery.LOCALHOST:
        return "loopback"
    try:
        routes = [line.split() for line in (root / "proc/net/route").read_text().splitlines()[1:]]
        other_interfaces = read_interfaces(root / "proc").keys() - {LOOPBACK}
    except OSError:
        routes, other_interfaces = [], {""}
    if not routes and not other_interfaces:
        return "loopback"
    interface = next((route[0] for route in routes if route[1] == "00000000"), None)
    is_wireless = interface is not None and (root / "sys/class/net" / interface / "wireless").exists()
    return "wireless" if is_wireless else "wired"
