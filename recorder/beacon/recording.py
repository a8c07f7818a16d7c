"""A beacon's recording from its options to a closed trace: a ping and a relay on one node."""

from __future__ import annotations

import secrets
import shutil
import subprocess
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from typing import Any, cast

from dds_trace.tracefile.format.descriptions import Run
from dds_trace.tracefile.format.events import SESSION_TOPIC
from dds_trace.tracefile.writing.destination import discard
from dds_trace.tracefile.writing.sink import TraceSink

from ..backends.node import Node, Publisher, RawMessage
from ..base_recording import LOOK_S, BaseRecording, Recorded, raise_error_of, sampled
from ..errors import NothingHeardError
from ..host.clock import read_adjtimex
from ..host.process import tuned_gc
from ..options import RecordOptions
from ..payloads import data_types
from ..roles.ping import AnyPing, open_ping
from ..roles.plan import RunPlan
from ..roles.progress import BeaconProgress, Watch
from ..roles.relay import Relay
from ..roles.session import strangers_field
from ..service.upkeep import Upkeep
from .exchange import NOTES_TOPIC, NOTES_TYPE, ClockNote, Exchanges, NotingSink

TIMEOUT_S = 2.0
_NAME, _OFFSET_S, _LEAP = 1, 4, 13
"""Columns of `chronyc -c tracking`."""
_NOT_SYNCHRONIZED = 0x40


def time_service() -> str:
    return _chrony() or _timedatectl() or _kernel()


def _output(*command: str) -> str:
    program = shutil.which(command[0])
    if program is None:
        return ""
    try:
        done = subprocess.run(
            [program, *command[1:]], capture_output=True, text=True, timeout=TIMEOUT_S, check=False, errors="replace"
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout if done.returncode == 0 else ""


def _chrony() -> str:
    return chrony_words(_output("chronyc", "-c", "tracking"))


def chrony_words(tracking: str) -> str:
    """Return words for the output of `chronyc -c tracking`; empty if it is something else."""
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


def _timedatectl() -> str:
    value = _output("timedatectl", "show", "--property=NTPSynchronized", "--value").strip()
    return {"yes": "timedatectl: synchronized", "no": "timedatectl: not synchronized"}.get(value, "")


def _kernel() -> str:
    correction = read_adjtimex()
    if correction is None:
        return "kernel: state of the clock unknown"
    is_synchronized = not int(str(correction["status"])) & _NOT_SYNCHRONIZED
    return f"kernel: {'synchronized' if is_synchronized else 'not synchronized'}"


DATA = "string"
RUN_S = 3600
"""Length of a run: a new one keeps the ledger of messages small."""
WAIT_S = 1.0
"""Longest wait between two looks at the end, before another beacon is met."""
REPORT_S = 10.0
"""Time between two reports of the clocks."""
SERVICE_S = 60.0
"""Time between two looks at the time service."""


class BeaconRecording(BaseRecording):
    """The recording of a beacon."""

    def __init__(self, options: RecordOptions, stop: threading.Event, watch: Watch, **more: Any) -> None:
        super().__init__(options, stop, watch, **more)
        self.exchanges = Exchanges()
        self.pings: list[AnyPing] = []
        self._reported_s = self._served_s = -float("inf")
        self._service = ""

    def record(self, rate_hz: float) -> Recorded:
        """Compare clocks until done; errors as for `recorder.recording.record`.

        With `NothingHeardError` in the result no other beacon answered, and there is no trace.
        """
        options = self.options
        self.measure_costs(has_floor=False)
        with self.open_wire() as wire, self.open_node("beacon") as node, tuned_gc():
            read_back = self.read_back(node)
            session = self.describe("ping", node, read_back)
            relay_id = options.relay_id or secrets.randbits(32) or 1
            relay_session = self.describe("relay", node, read_back, relay_id, session_id=secrets.randbits(64))
            with ExitStack() as stack:
                upkeep = stack.enter_context(Upkeep(options, session, self.clock.monotonic_ns, self.watch.note))
                sink = upkeep.sink
                sink.write_json(SESSION_TOPIC, relay_session.to_dict())
                notes = node.create_publisher(NOTES_TOPIC, NOTES_TYPE, qos=options.node.qos)
                relay = Relay(
                    node,
                    sink,
                    relay_id,
                    data_types=data_types().values(),
                    qos=options.node.qos,
                    is_own=self._is_own,
                    on_relayed=partial(self._publish_note, notes, session.device, relay_id),
                )
                node.create_subscription(NOTES_TOPIC, NOTES_TYPE, self.exchanges.take_note, qos=options.node.qos)
                self._service = time_service()
                read_back.read_begin()
                node.start()
                if self.rehearses:
                    self.stop.set()
                else:
                    self.watch.note(f"beacon {relay_id:08x} in domain {options.node.domain_id}; {self._service}")
                with sampled(sink, wire):
                    run = self._send(node, sink, upkeep, rate_hz)
                relay.close()
                read_back.read_end(relay.traffic)
                fields = {**read_back.fields(), **self.fields_at_end(), **strangers_field(node.strangers)}
                sink.write_json(SESSION_TOPIC, relay_session.closed(sink.dropped_events, **fields).to_dict())
                trace = upkeep.close_trace(**fields)
                read_back.report(trace.path)
                progress = self._progress()
                self._report(progress)
                if not progress.clocks and not self.rehearses:  # the next try may have the name
                    discard(upkeep.destination)
                    return Recorded(None, session, progress, error=_lonely(node))
                return Recorded(trace, session, progress, run, upkeep.shortage)

    def _is_own(self, run_id: int, sequence: int) -> bool:
        return any(ping.is_own(run_id, sequence) for ping in self.pings[-2:])

    def _publish_note(
        self,
        notes: Publisher[RawMessage],
        device: str,
        relay_id: int,
        run_id: int,
        sequence: int,
        relay_in_ns: int,
        relay_out_ns: int,
    ) -> None:
        offset_ns = self.clock.anchor().offset_ns
        ClockNote(device, run_id, sequence, relay_id, relay_in_ns, relay_out_ns, offset_ns, self._service).publish(
            notes
        )

    def _send(self, node: Node, sink: TraceSink, upkeep: Upkeep, rate_hz: float) -> Run | None:
        """Send run after run until the end; return the last one."""
        end_ns, run = self.end_ns(), None
        noting = cast("TraceSink", NotingSink(sink, self.exchanges))
        with ThreadPoolExecutor(1, thread_name_prefix="beacon") as pool:
            while (left_s := self.left_s(end_ns)) > 0 and not self.stop.is_set():
                ping = open_ping(node, self._plan(min(left_s, RUN_S), rate_hz), self.clock)
                self.pings.append(ping)
                self.exchanges.run_ids.add(ping.run_id)
                enough = threading.Event()
                future = pool.submit(_run_once_met, ping, noting, enough)
                while not future.done():
                    self.stop.wait(LOOK_S)
                    self._look(node, upkeep)
                    if self.stop.is_set() or self.left_s(end_ns) <= 0 or node.error is not None:
                        enough.set()
                        break
                run = future.result() or run
                raise_error_of(node)
                ping.close()
        return run

    def _plan(self, length_s: float, rate_hz: float) -> RunPlan:
        seed = secrets.randbits(32)
        return RunPlan(
            payload=data_types()[DATA].make(None, seed, None),
            rate_hz=rate_hz,
            messages=max(round(length_s * rate_hz), 1),
            qos=self.options.node.qos,
            relay_domain_id=self.options.node.domain_id,
            labels={"role": "beacon"},
            extra={"session_id": f"{self.session_id:016x}", "seed": seed, "settings": {}},
        )

    def _look(self, node: Node, upkeep: Upkeep) -> None:
        self.note_disk(upkeep.sink)
        self.note_strangers(node)
        progress = self._progress()
        upkeep.look(progress.received, dict)
        self.watch.progress(progress)
        now_s = time.monotonic()
        if now_s - self._reported_s >= REPORT_S:
            self._reported_s = now_s
            self._report(progress)
        if now_s - self._served_s >= SERVICE_S:
            self._served_s, self._service = now_s, time_service()

    def _report(self, progress: BeaconProgress) -> None:
        for line in progress.clocks:
            self.watch.note(line)

    def _progress(self) -> BeaconProgress:
        anchor = self.clock.anchor()
        parts = [ping.progress() for ping in self.pings]
        clocks = self.exchanges.words(anchor.monotonic_ns, anchor.offset_ns)
        return BeaconProgress(sum(part.sent for part in parts), sum(part.received for part in parts), tuple(clocks))


def _lonely(node: Node) -> NothingHeardError:
    return NothingHeardError(
        f"no other beacon answered in domain {node.options.domain_id}: start `dds-record --role beacon` on another device "
        "with the same --domain, --discovery and --backend"
    )


def _run_once_met(ping: AnyPing, sink: TraceSink, enough: threading.Event) -> Run | None:
    """Run once another beacon has echoed a probe: what nobody could receive is not lost."""
    while not enough.is_set():
        if ping.wait_for_echo(WAIT_S, enough):
            return ping.run(sink, enough)
    return None
