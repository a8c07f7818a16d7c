"""What the recordings of all roles share: process, clock, node, capture, description and notes."""

from __future__ import annotations

import os
import secrets
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

from dds_trace.tracefile.format.events import HOST_TOPIC

from .backends import load_backend, open_node
from .choices import Security
from .host.clock import SystemClock, measured_step_ns, read_adjtimex
from .host.process import apply_privileges, realtime_threads
from .host.sampling import HostSampler
from .options import side_settings
from .roles.floor import measured_cost, measured_floor
from .roles.read_back import ReadBack
from .roles.session import default_connectivity, describe_session
from .roles.wire_record import open_wire
from .security.keys import public_hash

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable
    from contextlib import AbstractContextManager

    from dds_trace.base.errors import TraceError
    from dds_trace.tracefile.format.descriptions import Run, Session
    from dds_trace.tracefile.format.json_fields import Json, JsonObject
    from dds_trace.tracefile.writing.destination import ClosedTrace
    from dds_trace.tracefile.writing.sink import TraceSink

    from .backends.node import Node, NodeOptions
    from .bridges.process.running import RunningBridge
    from .options import PingOptions, RecordOptions
    from .roles.progress import Progress, Watch
    from .roles.wire_record import WireRecord

LOOK_S = 0.5
"""Period of checks of a running role."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """The result of a recording.

    Attributes:
        trace: None for a ping that was stopped before its echo.
        error: why a run ended early, a relay recorded nothing for a while, or a tap heard nothing.
    """

    trace: ClosedTrace | None
    session: Session
    progress: Progress
    run: Run | None = None
    error: TraceError | None = None


class BaseRecording:
    """One recording of any role; `stop` ends it, `watch` receives notes and progress.

    `load_fields` returns the session's field `load`, if the machine is loaded.
    """

    def __init__(
        self,
        options: RecordOptions,
        stop: threading.Event,
        watch: Watch,
        *,
        rehearses: bool,
        load_fields: Callable[[], JsonObject] = dict,
    ) -> None:
        self.options = options
        self.rehearses = rehearses
        self.stop = stop
        self.watch = watch
        self.clock = SystemClock()
        self.session_id = secrets.randbits(64)
        self.privileges = apply_privileges(options.cpu_affinity, options.realtime_priority)
        self.costs: dict[str, Json] = {}
        self.correction = read_adjtimex()
        self.clock_step_ns = measured_step_ns()
        os.environ |= load_backend(options.backend).own_variables(options.node)
        self.environment = dict(os.environ)  # before a node adds what it needs
        self._noted_disk = False
        self._node: Node | None = None
        self._load_fields = load_fields

    @property
    def has_bridge(self) -> bool:
        return self.options.ping is not None and self.options.ping.bridge != "none"

    @property
    def node_options(self) -> NodeOptions:
        """The options of the role's node; with a bridge it is not secured, but the bridge's link."""
        node = self.options.node
        return replace(node, security=Security.OFF, keys=None) if self.has_bridge else node

    def measure_costs(self, rate_hz: float | None = None, *, has_floor: bool = True) -> None:
        """Measure at a run's rate, before there is a node to disturb; without the floor of the client library if it is no part of a result."""
        if self.rehearses or not self.options.own_cost:
            return
        floor = measured_floor(self.options.backend, self.node_options, rate_hz) if has_floor else {}
        self.costs = {**measured_cost(), **floor}

    def open_wire(self, ping_options: PingOptions | None = None) -> AbstractContextManager[WireRecord]:
        """Open the capture, if enabled; with a bridge messages go through two domains."""
        node = self.options.node
        other = None if ping_options is None else ping_options.relay_domain_id
        return open_wire(
            enabled=self.options.wire,
            discovery=node.discovery,
            domain_ids=[node.domain_id, *([] if other is None else [other])],
            note=self.watch.note,
        )

    def open_node(self, role: str) -> Node:
        # Unique, so that the node recognizes its own endpoints.
        name = f"dds_trace_{role}_{self.session_id:016x}"
        listens = role == "relay" or (role == "beacon" and not self.options.node.peers)
        self._node = open_node(self.options.backend, replace(self.node_options, name=name, listens=listens))
        return self._node

    def read_back(self, node: Node) -> ReadBack:
        return ReadBack(node, self.environment, strict=self.options.strict, note=self.watch.note)

    def describe(
        self,
        role: str,
        node: Node,
        read_back: ReadBack,
        relay_id: int | None = None,
        *,
        session_id: int | None = None,
        extra: JsonObject | None = None,
    ) -> Session:
        options = self.options
        connectivity = options.connectivity or default_connectivity(options.node.discovery)
        settings = side_settings(options, connectivity)
        return describe_session(
            node,
            self.clock.anchor(),
            role=role,
            session_id=session_id or self.session_id,
            device=options.device,
            connectivity=connectivity,
            relay_id=relay_id,
            extra={
                **self.privileges,
                **self.costs,
                "settings": settings,
                **read_back.fields(),
                "clock": {"resolution_ns": self.clock_step_ns, "begin": self.correction},
                **(extra or {}),
            },
        )

    def fields_at_end(self) -> JsonObject:
        """Return the session's `clock` (the kernel's correction at start and end), `load`, `realtime_threads` and `security`."""
        clock: JsonObject = {"resolution_ns": self.clock_step_ns, "begin": self.correction, "end": read_adjtimex()}
        keys, security = self.options.node.keys, {}
        if keys is not None and self._node is not None:
            security = {
                "level": self.options.node.security.value,
                "keys_sha256": public_hash(keys),
                "applied": "TLS of the bridge's link" if self.has_bridge else self._node.read_security(),
            }
        return {
            "clock": clock,
            **self._load_fields(),
            **realtime_threads(),
            **({"security": security} if security else {}),
        }

    def note_disk(self, sink: TraceSink) -> None:
        """Note a disk that cannot be written, once."""
        if sink.error is not None and not self._noted_disk:
            self._noted_disk = True
            self.watch.note(f"{sink.error}; the node continues to answer; what was written stays readable")

    def note_strangers(self, node: Node) -> None:
        for kind in node.strangers.take_new():
            self.watch.note(f"somebody else sends here: a {kind} was not accepted; the trace counts further ones")

    def end_ns(self) -> int | None:
        """Return the end of the duration from now on, monotonic; None without one."""
        duration_s = self.options.duration_s
        return None if duration_s is None else self.clock.monotonic_ns() + round(duration_s * 1e9)

    def left_s(self, end_ns: int | None) -> float:
        return float("inf") if end_ns is None else (end_ns - self.clock.monotonic_ns()) / 1e9


def sampled(sink: TraceSink, wire: WireRecord, bridge: RunningBridge | None = None) -> HostSampler:
    """Return a context that writes the load of host and own processes once a second."""
    processes = {**wire.processes, **({} if bridge is None else bridge.processes)}
    return HostSampler(partial(sink.write_json, HOST_TOPIC), processes)


def raise_error_of(node: Node) -> None:
    """Raise the error that ended a thread of the node."""
    if node.error is not None:
        raise node.error
