"""A beacon's recording from its options to a closed trace: a ping and a relay on one node."""

from __future__ import annotations

import secrets
import shutil
import subprocess
import threading
import time
from contextlib import ExitStack
from functools import partial
from typing import cast

from dds_trace.recorder.backends.node import Publisher, RawMessage
from dds_trace.recorder.base_recording import BaseRecording, Recorded
from dds_trace.recorder.host.clock import read_adjtimex
from dds_trace.recorder.options import BEACON_RATE_HZ
from dds_trace.recorder.payloads import data_types
from dds_trace.recorder.roles.ping import AnyPing, PingThread, open_ping
from dds_trace.recorder.roles.plan import RunPlan
from dds_trace.recorder.roles.progress import BeaconProgress
from dds_trace.recorder.roles.relay import Relay
from dds_trace.tracefile.format.descriptions import Run, Session
from dds_trace.tracefile.format.events import SESSION_TOPIC
from dds_trace.tracefile.format.json_fields import Json, JsonObject
from dds_trace.tracefile.writing.destination import ClosedTrace
from dds_trace.tracefile.writing.sink import TraceSink

from .exchange import NOTES_TOPIC, NOTES_TYPE, ClockNote, Exchanges, NotingSink

TIMEOUT_S = 2.0
_NAME, _OFFSET_S, _LEAP = 1, 4, 13
_NOT_SYNCHRONIZED = 0x40


def time_service() -> str:
    if words := chrony_words(_output("chronyc", "-c", "tracking")):
        return words
    value = _output("timedatectl", "show", "--property=NTPSynchronized", "--value").strip()
    if value in ("yes", "no"):
        return f"timedatectl: {'synchronized' if value == 'yes' else 'not synchronized'}"
    correction = read_adjtimex()
    if correction is None:
        return "kernel: state of the clock unknown"
    is_synchronized = not int(str(correction["status"])) & _NOT_SYNCHRONIZED
    return f"kernel: {'synchronized' if is_synchronized else 'not synchronized'}"


def _output(*command: str) -> str:
    program = shutil.which(command[0])
    if program is None:
        return ""
    try:
        process = subprocess.run(
            [program, *command[1:]], capture_output=True, text=True, timeout=TIMEOUT_S, check=False, errors="replace"
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return process.stdout if process.returncode == 0 else ""


def chrony_words(tracking: str) -> str:
    columns = tracking.strip().split(",")
    if len(columns) <= _LEAP:
        return ""
    if columns[_LEAP] == "Not synchronised":
        return "chrony: not synchronized"
    try:
        return (
            f"chrony: follows {columns[_NAME]}, off by {1e3 * abs(float(columns[_OFFSET_S])):.3f} ms by its own account"
        )
    except ValueError:
        return ""


DATA = "string"
RUN_S = 3600
"""Length of a run: a new one keeps the ledger of messages small."""
WAIT_S = 1.0
"""Longest wait between two looks at the end, before another beacon is met."""
REPORT_S = 10.0
SERVICE_S = 60.0


class BeaconRecording(BaseRecording):
    ROLE = "beacon"

    def describe(self, role: str | None = None, *, session_id: int | None = None, **extra: Json) -> Session:
        return super().describe(role or "ping", session_id=session_id, **extra)

    def begin(self, stack: ExitStack) -> None:  # noqa: ARG002 - the node closes its endpoints
        options, node = self.options, self.node
        self.exchanges = Exchanges(node.strangers)
        self.pings: list[AnyPing] = []
        self._reported_s = self._served_s = -float("inf")
        self._relay_session = self.describe("relay", session_id=secrets.randbits(64))
        self.upkeep.sink.write_json(SESSION_TOPIC, self._relay_session.to_dict())
        notes = node.create_publisher(NOTES_TOPIC, NOTES_TYPE, qos=options.node.qos)
        self.role = Relay(
            node,
            self.upkeep.sink,
            self.relay_id,
            data_types=data_types().values(),
            qos=options.node.qos,
            is_own=self._is_own,
            on_relayed=partial(self._publish_note, notes),
        )
        node.create_subscription(NOTES_TOPIC, NOTES_TYPE, self.exchanges.take_note, qos=options.node.qos)
        self._service = time_service()
        self.read_back.read_begin()
        node.start()
        if not self.rehearses:
            self.watch.note(f"beacon {self.relay_id:08x} in domain {options.node.domain_id}; {self._service}")

    def _is_own(self, run_id: int, sequence: int) -> bool:
        return any(ping.is_own(run_id, sequence) for ping in self.pings[-2:])

    def _publish_note(
        self, notes: Publisher[RawMessage], run_id: int, sequence: int, relay_in_ns: int, relay_out_ns: int
    ) -> None:
        device, offset_ns = self.session.device, self.clock.anchor().offset_ns
        ClockNote(device, run_id, sequence, self.relay_id, relay_in_ns, relay_out_ns, offset_ns, self._service).publish(
            notes
        )

    def look_until_done(self) -> None:
        noting = cast("TraceSink", NotingSink(self.upkeep.sink, self.exchanges))
        while self.left_s() > 0 and not self.stop.is_set():
            ping = open_ping(self.node, self._plan(min(self.left_s(), RUN_S)), self.clock)
            self.pings.append(ping)
            self.exchanges.run_ids.add(ping.run_id)
            thread = PingThread(ping, partial(_run_once_met, ping, noting), self.node.stop_receiving)
            self.run = self.look_until_pinged(thread) or self.run
            self.raise_error_of_node()
            ping.close()

    def _plan(self, length_s: float) -> RunPlan:
        seed, rate_hz = secrets.randbits(32), self.options.beacon_rate_hz or BEACON_RATE_HZ
        return RunPlan(
            payload=data_types()[DATA].make(None, seed, None),
            rate_hz=rate_hz,
            messages=max(round(length_s * rate_hz), 1),
            qos=self.options.node.qos,
            relay_domain_id=self.options.node.domain_id,
            labels={"role": "beacon"},
            extra={"session_id": f"{self.session_id:016x}", "seed": seed, "settings": {}},
        )

    def look(self) -> None:
        super().look()
        now_s = time.monotonic()
        if now_s - self._reported_s >= REPORT_S:
            self._reported_s = now_s
            self._report()
        if now_s - self._served_s >= SERVICE_S:
            self._served_s, self._service = now_s, time_service()

    def _report(self) -> None:
        for line in self.progress().clocks:
            self.watch.note(line)

    def close(self) -> JsonObject:
        sink = self.upkeep.sink
        closed = self._relay_session.closed(sink.dropped_events, **self.fields_at_end())
        sink.write_json(SESSION_TOPIC, closed.to_dict())
        return {}

    def progress(self) -> BeaconProgress:
        anchor = self.clock.anchor()
        parts = [ping.progress() for ping in self.pings]
        clocks = self.exchanges.words(anchor.monotonic_ns, anchor.offset_ns)
        return BeaconProgress(sum(part.sent for part in parts), sum(part.received for part in parts), tuple(clocks))

    def result(self, trace: ClosedTrace) -> Recorded:
        self._report()
        return super().result(trace)

    def explain_nothing(self) -> str | None:
        if self.progress().clocks:
            return None
        return (
            f"no other beacon answered in domain {self.node.options.domain_id}: start `dds-trace record beacon` on "
            "another device with the same --domain, --discovery and --backend"
        )


def _run_once_met(ping: AnyPing, sink: TraceSink, enough: threading.Event, hopeless: threading.Event) -> Run | None:
    """Run once another beacon has echoed a probe: what nobody could receive is not lost."""
    while not enough.is_set():
        if ping.wait_for_echo(WAIT_S, enough):
            return ping.run(sink, enough, hopeless)
    return None
