"""The HTML report on a local address, made again when a trace below its folder changes.

`/version` names the page, `/status` the progress of the sweep, `/update` the page without plotly.js.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from html import escape
from pathlib import Path
from typing import TypeAlias

from dds_trace.analyzer.loading.place import default_output
from dds_trace.analyzer.loading.traces import TraceSpool
from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.errors import UNREADABLE, OutputError, TraceError
from dds_trace.base.files import open_regular
from dds_trace.base.streams import say
from dds_trace.reports.book.book import Book
from dds_trace.reports.html.page import render_live, render_waiting, without_plotly

from .local_server import Answer, LocalServer

Stamp: TypeAlias = "tuple[tuple[str, int, int], ...]"
"""Path, size in bytes and time of change in ns of every file below a folder."""

TRACE_ENDINGS = (".mcap", ".db3", ".yaml", ".ring")

_STATE, _PARTS = "state.json", ".parts"
"""A sweep's state, and the folder of what it records."""

_DONE = ("recorded", "complete")
_MOST = 1e12
"""Beyond it a count or a time in seconds is no sweep's."""


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
            if not (0 <= planned < _MOST and 0 <= left_s < _MOST):
                continue
        except UNREADABLE:
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

    @property
    def answer(self) -> Answer:
        return "text/html", self.page, self.version


class Watcher:
    def __init__(
        self, options: WatchOptions, host: str = "127.0.0.1", port: int = 0, names: Sequence[str] = ()
    ) -> None:
        """Bind the address at once, or raise an `OutputError`; nothing is analyzed before `refresh`."""
        self._options = options
        self._stamp: Stamp | None = None
        self._spool = TraceSpool()
        self._report = self._analyzed_version = ""
        self.shown = _waiting("")
        answers: dict[str, Callable[[], Answer]] = {
            "/": lambda: self.shown.answer,
            "/version": lambda: ("text/plain", self.shown.version.encode(), ""),
            "/status": lambda: ("application/json", self.status().encode(), ""),
            "/update": lambda: ("text/html", without_plotly(self.shown.page.decode()).encode(), ""),
        }
        try:
            self._server = LocalServer(host, port, answers, names)
        except (OSError, OverflowError) as err:
            raise OutputError(
                f"{host}:{port}: cannot serve there ({getattr(err, 'strerror', None) or err}); choose another --port"
            ) from err

    @property
    def address(self) -> str:
        host, port = self._server.server_address[:2]
        name = host if isinstance(host, str) else host.decode()
        return f"http://{f'[{name}]' if ':' in name else name}:{port}/"

    def refresh(self) -> bool:
        """Analyze the folder if a file changed; return whether there is a new report. A failure is said in the old one."""
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
        try:
            with self._server.serving():
                yield
        finally:
            self._spool.close()


def _waiting(version: str, why: str = "") -> Shown:
    return Shown(_encoded(render_waiting(version, why)), version)


def _encoded(page: str) -> bytes:
    # The reason of a failure may contain a file name that is not UTF-8.
    return page.encode("utf-8", "backslashreplace")


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
