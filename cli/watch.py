"""`dds-analyze watch FOLDER`: the HTML report on a local address, made anew whenever a trace below the folder changes."""

import ipaddress
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from hashlib import sha256
from html import escape
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import FrameType, TracebackType
from typing import Annotated

import typer

from dds_trace.tracefile import OutputError, TraceError

Stamp = tuple[tuple[str, int, int], ...]
"""Path, size and time of change of every file below a folder."""

LOOK_SECONDS = 3.0
TRACE_ENDINGS = (".mcap", ".db3", ".yaml", ".ring")

_WAITING = (
    '<!doctype html><html lang="en" data-version="{version}"><meta charset="utf-8">'
    "<title>Waiting for traces</title><body><p>No trace can be analyzed yet. This page looks again by itself."
    "<script>{script}</script>"
)

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode="rich")


@dataclass(frozen=True, slots=True)
class WatchOptions:
    """What is watched and how it is analyzed.

    Attributes:
        folder: with traces at any depth.
        out: folder for the analysis' files and its cache; None for its default place.
        cache: keep events there, so that a folder that grew is read only where it grew; without, nothing is written.
    """

    folder: Path
    out: Path | None = None
    cache: bool = True


@dataclass(frozen=True, slots=True)
class Shown:
    """A page and its version, which changes whenever the page does (an HTTP entity tag)."""

    page: bytes
    version: str


class Watcher:
    """The latest page of a folder, and the server that hands it out."""

    def __init__(self, options: WatchOptions, host: str = "127.0.0.1", port: int = 0) -> None:
        """Binds the address at once; nothing is analyzed before `refresh`.

        Raises:
            OutputError: the address cannot be bound.
        """
        self._options = options
        self._stamp: Stamp | None = None
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
        """Where a browser finds the page."""
        host, port = self._server.server_address[:2]
        name = host if isinstance(host, str) else host.decode()
        return f"http://{f'[{name}]' if ':' in name else name}:{port}/"

    def refresh(self) -> bool:
        """Analyzes anew if a file changed since the last time; whether that gave a new report.

        An analysis that fails (there is no trace yet, one has just begun, a mistake of ours) leaves the report that
        there was, under a line that says why.
        """
        stamp = _stamp_of(self._options.folder, self._target())
        if stamp == self._stamp:
            return False
        self._stamp = stamp
        version = sha256(repr(stamp).encode("utf-8", "backslashreplace")).hexdigest()[:16]
        try:
            self._report, self._analyzed_version = self._analyzed(version), version
        except Exception as err:  # noqa: BLE001 - one bad file must not end a watch that runs for a night
            why = str(err) if isinstance(err, TraceError) else f"{type(err).__name__}: {err}"
            self.shown = self._failed(why, version)
            return False
        self.shown = Shown(_encoded(self._report), version)
        return True

    def _target(self) -> Path:
        from dds_trace.analyzer import default_output

        return default_output(self._options.folder) if self._options.out is None else self._options.out

    def _analyzed(self, version: str) -> str:
        from dds_trace.analyzer import analyze
        from dds_trace.reports.book.book import Book
        from dds_trace.reports.html.page import render_live

        cache = self._options.cache
        analysis = analyze(self._options.folder, out=self._target() if cache else None, cache=cache)
        return render_live(Book(analysis), version)

    def _failed(self, why: str, version: str) -> Shown:
        print(f"{self._options.folder}: {why}", file=sys.stderr)
        if not self._report:
            return _waiting(version, why)
        notice = f'<p class="notice" role="status">The latest analysis failed: {escape(why)}</p>'
        # Both are markup of the page's own that no text of a trace can stand before.
        page = self._report.replace(
            f'data-version="{self._analyzed_version}"', f'data-version="{version}"', 1
        )
        return Shown(_encoded(page.replace("<body>", f"<body>\n{notice}", 1)), version)

    @contextmanager
    def serving(self) -> Iterator[None]:
        """Answers requests meanwhile, in a thread of its own."""
        thread = threading.Thread(target=self._server.serve_forever, name="watch", daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._server.shutdown()
            thread.join()
            self._server.server_close()


def _waiting(version: str, why: str = "") -> Shown:
    from dds_trace.reports.html.page import live_script

    page = _WAITING.format(version=version, script=live_script())
    return Shown(_encoded(page + (f"<p>{escape(why)}" if why else "")), version)


def _encoded(page: str) -> bytes:
    # A file name that is no UTF-8 may be in the reason of a failure.
    return page.encode("utf-8", "backslashreplace")


def _server_class(host: str) -> type[ThreadingHTTPServer]:
    class Server(ThreadingHTTPServer):
        address_family = socket.AF_INET6 if ":" in host else socket.AF_INET

    return Server


def is_own_name(asked: str, bound: str) -> bool:
    """Whether a request's `Host` is a name of this server: of loopback, or the address that it listens on.

    Any other name was pointed here by somebody (DNS rebinding): his page would be allowed to read ours. An address
    needs no DNS, so where the server listens on all addresses of the machine each of them will do.
    """
    name = asked.strip().lower()
    name = name[1:].partition("]")[0] if name.startswith("[") else name.partition(":")[0]
    if name in {"localhost", bound.lower()}:
        return True
    try:
        address = ipaddress.ip_address(name)
        return address.is_loopback or ipaddress.ip_address(bound).is_unspecified
    except ValueError:
        return False


def _handler(watcher: Watcher, bound: str) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if not is_own_name(self.headers.get("Host", ""), bound):
                self.send_error(HTTPStatus.MISDIRECTED_REQUEST)
                return
            shown = watcher.shown
            if self.path == "/version":
                self._send("text/plain", shown.version.encode())
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

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - signature of the base class
            """Says nothing: stderr is for the analysis."""

    return Handler


def _stamp_of(folder: Path, skip: Path) -> Stamp:
    """Of every file that may be part of a trace; what the analysis itself writes below `skip` is none."""
    found = []
    for path in sorted(folder.rglob("*")):
        if (path.suffix in TRACE_ENDINGS or not path.suffix) and not path.is_relative_to(skip):
            try:
                status = path.stat()
            except OSError:
                continue  # renamed or deleted meanwhile: the next look sees what became of it
            if path.is_file():
                found.append((str(path), status.st_size, status.st_mtime_ns))
    return tuple(found)


@app.command(context_settings={"help_option_names": ["-h", "--help"]})
def watch_command(
    folder: Annotated[
        Path,
        typer.Argument(metavar="FOLDER", help="Where a sweep writes.", show_default=False, exists=True),
    ],
    host: Annotated[
        str, typer.Option(metavar="ADDRESS", help="To listen on; anybody who reaches it can read the report.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(metavar="PORT", help="0 takes a free one.", min=0, max=65535)] = 8765,
    every: Annotated[
        float, typer.Option(metavar="SECONDS", help="Between two looks at the files.", min=0.1)
    ] = LOOK_SECONDS,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Where files and the cache go. [dim]Default: analysis/ in the folder of the traces[/dim]",
            show_default=False,
        ),
    ] = None,
    no_cache: Annotated[
        bool, typer.Option("--no-cache", help="Read every trace anew each time, and write no files.")
    ] = False,
) -> None:
    """Show the report of a folder in a browser while a sweep writes into it; Ctrl-C ends.

    [bold]dds-analyze watch runs/[/bold]
    """
    watcher = Watcher(WatchOptions(folder, out, cache=not no_cache), host, port)
    with _CtrlC() as ctrl_c, watcher.serving():
        print(f"Serving {watcher.address}", flush=True)
        while not ctrl_c.pressed:
            watcher.refresh()
            ctrl_c.wait(every)
    print("Stopped")


class _CtrlC:
    """Ctrl-C ends a wait at once, and an analysis after its end, or at once where it is pressed twice.

    Raised in the middle of an analysis it might meet an import or a callback that makes something else of it.
    """

    def __init__(self) -> None:
        self.pressed = False
        self._waiting = False

    def __enter__(self) -> "_CtrlC":  # noqa: PYI034 - `Self` is Python 3.11's
        self._before = signal.signal(signal.SIGINT, self._note)
        return self

    def wait(self, seconds: float) -> None:
        """Wait so long, or until Ctrl-C is pressed."""
        with suppress(KeyboardInterrupt):
            try:
                self._waiting = True
                if not self.pressed:
                    time.sleep(seconds)
            finally:
                self._waiting = False

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.pressed and not self._waiting:
            signal.default_int_handler(number, frame)
        self.pressed = True
        if self._waiting:
            raise KeyboardInterrupt

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        signal.signal(signal.SIGINT, self._before)
