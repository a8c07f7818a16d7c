"""The HTML report on a local address, made again when a trace below its folder changes.

`/version` names the page, `/status` the progress of the sweep, `/update` the page without plotly.js.
"""

from __future__ import annotations

import ipaddress
import json
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from html import escape
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from typing import TypeAlias

from dds_trace.analyzer.loading.traces import TraceSpool
from dds_trace.analyzer.pipeline import analyze, default_output
from dds_trace.base.errors import OutputError, TraceError
from dds_trace.base.files import open_regular
from dds_trace.base.local_server import LocalServer
from dds_trace.base.streams import say

from ..book.book import Book
from .page import render_live, render_waiting, without_plotly

Stamp: TypeAlias = "tuple[tuple[str, int, int], ...]"
"""Path, size in bytes and time of change in ns of every file below a folder."""

TRACE_ENDINGS = (".mcap", ".db3", ".yaml", ".ring")

_STATE, _PARTS = "state.json", ".parts"
"""A sweep's state, and the folder of what it records."""

_DONE = ("recorded", "complete")


@dataclass(frozen=True, slots=True)
class SweepStatus:
    """Sweeps below a folder, taken together."""

    done: int = 0
    planned: int = 0
    age_s: float | None = None
    left_s: float = 0.0

    @property
    def running(self) -> bool:
        return self.done < self.planned

    @property
    def words(self) -> str:
        if self.age_s is None:
            return ""
        left = f"{_rounded(self.age_s)} ago, about {_rounded(self.left_s)} left" if self.running else "complete"
        return f"{self.done} of {self.planned}, {left}"


def _rounded(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"


def sweep_status(folder: Path) -> SweepStatus:
    total = SweepStatus()
    for path in sorted(folder.rglob(_STATE)):
        try:
            with open_regular(path) as file:
                state, changed_s = json.load(file), os.fstat(file.fileno()).st_mtime
            recorded = sum(cell["status"] in _DONE for cell in state["cells"].values())
            planned, left_s = int(state["planned"]), float(state["left_s"])
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            continue
        age_s = max(0.0, time.time() - changed_s)
        total = SweepStatus(
            total.done + recorded,
            total.planned + planned,
            age_s if total.age_s is None else min(age_s, total.age_s),
            total.left_s + (max(0.0, left_s - age_s) if recorded < planned else 0.0),
        )
    return total


@dataclass(frozen=True, slots=True)
class WatchOptions:
    folder: Path
    out: Path | None = None


@dataclass(frozen=True, slots=True)
class Shown:
    page: bytes
    version: str


class Watcher:
    def __init__(self, options: WatchOptions, host: str = "127.0.0.1", port: int = 0) -> None:
        """Bind the address at once; nothing is analyzed before `refresh`.

        Raises:
            OutputError: the address cannot be bound.
        """
        self._options = options
        self._stamp: Stamp | None = None
        self._spool = TraceSpool()
        self._report = self._analyzed_version = ""
        self.shown = _waiting("")
        try:
            self._server = _server_class(host)((host, port), _handler(self, host))
        except (OSError, OverflowError) as err:
            raise OutputError(
                f"{host}:{port}: cannot serve there ({getattr(err, 'strerror', None) or err}); choose another --port"
            ) from err
        self._server.daemon_threads = True

    @property
    def address(self) -> str:
        host, port = self._server.server_address[:2]
        name = host if isinstance(host, str) else host.decode()
        return f"http://{f'[{name}]' if ':' in name else name}:{port}/"

    def refresh(self) -> bool:
        """Analyze the folder if a file changed, and return whether there is a new report.

        A failed analysis leaves the previous report, under a line with the reason.
        """
        stamp = _stamp_of(self._options.folder, self._target())
        if stamp == self._stamp:
            return False
        self._stamp = stamp
        version = sha256(repr(stamp).encode("utf-8", "backslashreplace")).hexdigest()[:16]
        try:
            self._report, self._analyzed_version = self._analyzed(version), version
        except Exception as err:  # noqa: BLE001 - one bad file must not end a watch
            why = str(err) if isinstance(err, TraceError) else f"{type(err).__name__}: {err}"
            self.shown = self._failed(why, version)
            return False
        self.shown = Shown(_encoded(self._report), version)
        return True

    def _target(self) -> Path:
        return default_output(self._options.folder) if self._options.out is None else self._options.out

    def _analyzed(self, version: str) -> str:
        analysis = analyze(self._options.folder, out=self._target(), spool=self._spool)
        if sweep_status(self._options.folder).running:
            unfinished = {source.path for source in analysis.sources if _PARTS in source.path.split("/")}
            findings = (finding for finding in analysis.findings if not set(finding.where.split(", ")) <= unfinished)
            analysis = replace(analysis, findings=tuple(findings))
        return render_live(Book(analysis), version)

    def _failed(self, why: str, version: str) -> Shown:
        say(f"{self._options.folder}: {why}")
        if not self._report:
            return _waiting(version, why)
        notice = f'<p class="notice" role="status">The latest analysis failed: {escape(why)}</p>'
        # Both precede any text of a trace.
        page = self._report.replace(f'data-version="{self._analyzed_version}"', f'data-version="{version}"', 1)
        return Shown(_encoded(page.replace("<body>", f"<body>\n{notice}", 1)), version)

    def status(self) -> str:
        status = sweep_status(self._options.folder)
        return json.dumps({"version": self.shown.version, "words": status.words, **asdict(status)})

    @contextmanager
    def serving(self) -> Iterator[None]:
        thread = threading.Thread(target=self._server.serve_forever, name="watch", daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._server.shutdown()
            thread.join()
            self._server.server_close()
            self._spool.close()


def _waiting(version: str, why: str = "") -> Shown:
    return Shown(_encoded(render_waiting(version, why)), version)


def _encoded(page: str) -> bytes:
    # The reason of a failure may contain a file name that is not UTF-8.
    return page.encode("utf-8", "backslashreplace")


def _server_class(host: str) -> type[LocalServer]:
    class Server(LocalServer):
        address_family = socket.AF_INET6 if ":" in host else socket.AF_INET

    return Server


def is_own_name(host: str, bound: str) -> bool:
    """Return whether a request's `Host` is this server's: any other name may come from DNS rebinding, and read the page."""
    name = host.strip().lower()
    name = name[1:].partition("]")[0] if name.startswith("[") else name.partition(":")[0]
    if name in {"localhost", bound.lower()}:
        return True
    try:
        address = ipaddress.ip_address(name)
        return address.is_loopback or ipaddress.ip_address(bound).is_unspecified
    except ValueError:
        return False


def _handler(watcher: Watcher, bound: str) -> type[BaseHTTPRequestHandler]:
    paths: dict[str, tuple[str, Callable[[], str]]] = {
        "/version": ("text/plain", lambda: watcher.shown.version),
        "/status": ("application/json", watcher.status),
        "/update": ("text/html", lambda: without_plotly(watcher.shown.page.decode())),
    }

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if not is_own_name(self.headers.get("Host", ""), bound):
                self.send_error(HTTPStatus.MISDIRECTED_REQUEST)
                return
            shown = watcher.shown
            if self.path in paths:
                kind, body = paths[self.path]
                self._send(kind, body().encode())
            elif self.path != "/":
                self.send_error(HTTPStatus.NOT_FOUND)
            elif self.headers.get("If-None-Match") == f'"{shown.version}"':
                self.send_response(HTTPStatus.NOT_MODIFIED)
                self.end_headers()
            else:
                self._send("text/html", shown.page, {"ETag": f'"{shown.version}"'})

        def _send(self, kind: str, body: bytes, headers: dict[str, str] | None = None) -> None:
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", f"{kind}; charset=utf-8")
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-cache")
            for name, value in (headers or {}).items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None: ...  # stderr is for the analysis

    return Handler


def _stamp_of(folder: Path, skip: Path) -> Stamp:
    stamps = []
    for path in sorted(folder.rglob("*")):
        if (path.suffix in TRACE_ENDINGS or not path.suffix) and not path.is_relative_to(skip):
            try:
                status = path.stat()
            except OSError:
                continue  # renamed or deleted since; the next call sees it
            if path.is_file():
                stamps.append((str(path), status.st_size, status.st_mtime_ns))
    return tuple(stamps)
