"""A tap's recording from its options to a closed trace, and its live table for others: on a page, and as `DiagnosticArray`."""

from __future__ import annotations

import gc
import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from html import escape
from importlib.resources import files

from dds_trace.base.errors import OptionError
from dds_trace.base.records import to_json
from dds_trace.base.units import SECOND_NS, counted, first_of, format_duration
from dds_trace.extensions.live.local_server import LocalServer
from dds_trace.recorder.backends.node import TapNode, TopicPatterns
from dds_trace.recorder.base_recording import BaseRecording, Recorded
from dds_trace.recorder.options import TapOptions
from dds_trace.recorder.payloads.cdr import CdrWriter
from dds_trace.recorder.roles.progress import Health, LiveRow, TapProgress
from dds_trace.tracefile.format.descriptions import Qos, Session
from dds_trace.tracefile.format.json_fields import Json, JsonObject
from dds_trace.tracefile.writing.destination import ClosedTrace

from .live import LiveTable
from .tap import Tap, summarize

LONELY_S = 5.0
"""Wait for a publisher until the user gets a line about it."""
COLLECT_LOOKS = 60
MOST_REASONS = 5


class TapRecording(BaseRecording):
    ROLE = "tap"
    role: Tap

    @property
    def _tap_options(self) -> TapOptions:
        assert self.options.tap is not None
        return self.options.tap

    def describe(self, role: str | None = None, *, session_id: int | None = None, **extra: Json) -> Session:
        if not isinstance(self.node, TapNode):
            raise OptionError(
                f"a tap: the backend {self.options.backend} only carries our own messages; use ros2, cyclonedds or zenoh"
            )
        return super().describe(role, session_id=session_id, topics=list(self._tap_options.topics), **extra)

    def begin(self, stack: ExitStack) -> None:
        options, node = self._tap_options, self.node
        assert isinstance(node, TapNode)
        self._diagnostics = self.node.create_publisher(TOPIC, TYPE_NAME, qos=Qos()) if options.diagnostics else None
        self._live = LiveTable(options.expected_hz)
        self.role = Tap(
            node,
            self.upkeep.sink,
            TopicPatterns(options.topics),
            session_id=self.session_id,
            qos=self.options.tap_qos,
            note=self.watch.note,
            live=self._live,
            clock=self.clock,
            has_worker=True,
            keeps_payload=options.payload,
        )
        if options.live_port is not None:
            device = self.options.device or os.uname().nodename
            self.watch.note(f"live on {stack.enter_context(serve_page(options.live_port, self._live.rows, device))}")
        self.read_back.read_begin()
        self.node.start()
        self._cpu_ns, self._start_ns = time.process_time_ns(), time.monotonic_ns()
        self._looks, self._is_noted = 0, False
        if not self.rehearses:
            self.watch.note(f"listening to {', '.join(options.topics)} in domain {self.options.node.domain_id}")

    def look_until_done(self) -> None:
        self.role.look()
        super().look_until_done()
        self.role.look()

    def look(self) -> None:
        self.role.look()
        super().look()
        self._looks += 1
        if self._diagnostics is not None and self._looks % 2:
            self._diagnostics.publish(diagnostic_array(self._live.rows(), self.options.device or "", time.time_ns()))
        if not self.role.messages and not self._is_noted and time.monotonic_ns() - self._start_ns > LONELY_S * 1e9:
            self._is_noted = True
            self.watch.note(f"{self._why_nothing()}; the tap joins a topic as soon as it appears")
        if self._looks % COLLECT_LOOKS == 0:
            gc.collect()

    def close(self) -> JsonObject:
        self.role.close()
        cpu_ns, duration_ns = time.process_time_ns() - self._cpu_ns, time.monotonic_ns() - self._start_ns
        left_out = {"payloads_left_out": self.upkeep.sink.payloads.left_out} if self._tap_options.payload else {}
        self._own_cost: JsonObject = {"cpu_ns": cpu_ns, "duration_ns": duration_ns, "messages": self.role.messages}
        return {"own_cost": self._own_cost, **left_out}

    def progress(self) -> TapProgress:
        return replace(self.role.progress(), rows=self._live.rows() if self._tap_options.live else ())

    def result(self, trace: ClosedTrace) -> Recorded:
        messages = self.role.messages
        if self.rehearses or not messages:
            return super().result(trace)
        left_out = self.upkeep.sink.payloads.left_out
        lost = [f"{counted(left_out, 'payload')} left out: too many waited for the disk"] if left_out else []
        cpu_ns, duration_ns = (int(str(self._own_cost[name])) for name in ("cpu_ns", "duration_ns"))
        used = f"{cpu_ns / max(duration_ns, 1):.1%} of one core, {format_duration(cpu_ns / messages)} for each message"
        for line in (*summarize(self.role.streams), *lost, f"the tap itself used {used}"):
            self.watch.note(line)
        return super().result(trace)

    def explain_nothing(self) -> str | None:
        return None if self.role.messages else self._why_nothing()

    def _why_nothing(self) -> str:
        tap, node = self.role, self.node
        names, domain_id = ", ".join(self._tap_options.topics), node.options.domain_id
        if tap.refused:
            reasons = [f"{topic}: {why}" for topic, why in sorted(tap.refused.items())]
            return "; ".join(first_of(reasons, MOST_REASONS, "further topics"))
        if tap.unseen:
            return (
                f"no message of {', '.join(tap.unseen)} came, and no publisher is seen: of a key outside ROS the middleware shows none; "
                "start one, or check the name, --domain and --peer"
            )
        if tap.topics:
            return f"no message of {', '.join(tap.topics)} came: its publishers are there and silent, or the network drops what they send"
        return (
            f"no publisher of {names} in domain {domain_id} ({node.describe_others()} seen): check name, --domain, --discovery and --backend; in a "
            "secured domain give this process its keys (ROS_SECURITY_KEYSTORE, ROS_SECURITY_ENABLE=true)"
        )


HOST = "127.0.0.1"


@contextmanager
def serve_page(port: int, rows: Callable[[], Sequence[LiveRow]], device: str = "this device") -> Iterator[str]:
    """Serve the table of `rows` within the block; yield the address. An `OptionError` for a port in use."""
    page = (
        (files("dds_trace.extensions.topics") / "live.html")
        .read_text(encoding="utf-8")
        .replace("{{device}}", escape(device))
    )

    try:
        server = LocalServer(
            HOST,
            port,
            {
                "/": lambda: ("text/html", page.encode(), ""),
                "/live.json": lambda: ("application/json", json.dumps(to_json(rows())).encode(), ""),
            },
        )
    except OSError as error:
        raise OptionError(f"-o live_port={port}: {error.strerror}; choose another port") from error
    with server.serving():
        yield f"http://{HOST}:{server.server_port}/"


TOPIC, TYPE_NAME = "diagnostics", "diagnostic_msgs/msg/DiagnosticArray"
_LEVELS = {Health.OK: 0, Health.SLOW: 1, Health.LATE: 1, Health.STALE: 3}
"""OK, WARN and STALE of `diagnostic_msgs/msg/DiagnosticStatus`."""


def diagnostic_array(rows: tuple[LiveRow, ...], device: str, wall_ns: int) -> bytearray:
    writer = CdrWriter()
    writer.uint32(wall_ns // SECOND_NS)
    writer.uint32(wall_ns % SECOND_NS)
    writer.string(b"")
    writer.uint32(len(rows))
    for row in rows:
        values = {
            "rate_hz": f"{row.rate_hz:.3g}",
            "expected_hz": "" if row.expected_hz is None else f"{row.expected_hz:.3g}",
            "age": format_duration(row.age_ns),
            "age_p99": format_duration(row.age_p99_ns),
            "missing": str(row.missing),
        }
        writer.uint8(_LEVELS[row.health])
        for text in (f"dds-trace: {row.topic}", row.health.value, device):
            writer.string(text.encode())
        writer.uint32(len(values))
        for key, value in values.items():
            writer.string(key.encode())
            writer.string(value.encode())
    return writer.message()
