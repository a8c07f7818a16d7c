"""The live table of a tap for others: on a page of this device only, and as `DiagnosticArray` for a robot's own monitors."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from html import escape
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from importlib.resources import files

from dds_trace.base.errors import OptionError
from dds_trace.base.local_server import LocalServer
from dds_trace.base.units import SECOND_NS, format_duration
from dds_trace.tracefile.format.descriptions import Qos

from ..backends.node import Node
from ..payloads.cdr import CdrWriter
from ..roles.live import Health, LiveRow, LiveTable

HOST = "127.0.0.1"
_NAMES = ("127.0.0.1", "localhost")


@contextmanager
def serve_page(port: int, rows: Callable[[], Sequence[LiveRow]], device: str = "this device") -> Iterator[str]:
    """Serve the table of `rows` within the block; yield the address.

    Raises:
        OptionError: the port is in use.
    """

    page = (
        (files("dds_trace.recorder.tap") / "live.html")
        .read_text(encoding="utf-8")
        .replace("{{device}}", escape(device))
    )

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if self.headers.get("Host", "").partition(":")[0] not in _NAMES:  # another name comes from DNS rebinding
                self.send_error(HTTPStatus.MISDIRECTED_REQUEST)
            elif self.path == "/":
                self._send("text/html; charset=utf-8", page)
            elif self.path == "/live.json":
                self._send("application/json", json.dumps([row.to_dict() for row in rows()]))
            else:
                self.send_error(HTTPStatus.NOT_FOUND)

        def _send(self, kind: str, text: str) -> None:
            body = text.encode()
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None: ...

    try:
        server = LocalServer((HOST, port), Handler)
    except OSError as error:
        raise OptionError(f"-o live_port={port}: {error.strerror}; choose another port") from error
    thread = threading.Thread(target=server.serve_forever, name="tap-page", daemon=True)
    thread.start()
    try:
        yield f"http://{HOST}:{server.server_port}/"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


TOPIC, TYPE_NAME = "diagnostics", "diagnostic_msgs/msg/DiagnosticArray"
_LEVELS = {Health.OK: 0, Health.LATE: 1, Health.STALE: 3}
"""OK, WARN and STALE of `diagnostic_msgs/msg/DiagnosticStatus`."""


def open_diagnostics(node: Node, device: str) -> Callable[[LiveTable], None]:
    publisher = node.create_publisher(TOPIC, TYPE_NAME, qos=Qos())
    return lambda table: publisher.publish(diagnostic_array(table.rows(), device, time.time_ns()))


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
