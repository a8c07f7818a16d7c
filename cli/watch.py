"""`dds-analyze watch FOLDER`: the HTML report on a local address, made anew whenever a trace below the folder changes."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Annotated

import typer

from tracefile import OutputError, TraceError

Stamp = tuple[tuple[str, int, int], ...]
"""Path, size and time of change of every file below a folder."""

RELOAD_SECONDS = 3.0
TRACE_ENDINGS = (".mcap", ".db3", ".yaml", ".ring")

_WAITING = (
    "<!doctype html><html lang=en><meta charset=utf-8>"
    "<title>Waiting for traces</title><p>No trace can be analyzed yet. This page looks again by itself."
    "<script>setTimeout(() => location.reload(), 3000)</script>"
)

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode="rich")


class Watcher:
    """The latest page of a folder, and the server that hands it out."""

    def __init__(self, folder: Path, host: str = "127.0.0.1", port: int = 0) -> None:
        """Binds the address at once; nothing is analyzed before `refresh`.

        Raises:
            OutputError: the address cannot be bound.
        """
        self._folder = folder
        self._stamp: Stamp | None = None
        self._page = _WAITING.encode()
        try:
            self._server = ThreadingHTTPServer((host, port), _handler(self))
        except OSError as err:
            raise OutputError(
                f"{host}:{port}: cannot serve there ({err.strerror}); choose another --port"
            ) from err
        self._server.daemon_threads = True

    @property
    def address(self) -> str:
        """Where a browser finds the page."""
        host, port = self._server.server_address[:2]
        return f"http://{host if isinstance(host, str) else host.decode()}:{port}/"

    @property
    def page(self) -> bytes:
        """The page as it is now."""
        return self._page

    @property
    def version(self) -> str:
        """The page's name for itself: changes exactly when the page does (an HTTP entity tag)."""
        return f'"{sha256(self._page).hexdigest()[:16]}"'

    def refresh(self) -> bool:
        """Analyzes anew if a file changed since the last time; whether it did so.

        A folder that cannot be analyzed yet (no trace, or one that has just begun) keeps the page it had.
        """
        from analyzer import analyze
        from reports import render_live

        stamp = _stamp_of(self._folder)
        if stamp == self._stamp:
            return False
        self._stamp = stamp
        try:
            page = render_live(analyze(self._folder), RELOAD_SECONDS * 5)
        except TraceError:
            return False
        self._page = page.encode("utf-8")
        return True

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


def _handler(watcher: Watcher) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if self.path != "/":
                self.send_error(404)
                return
            page, version = watcher.page, watcher.version
            if self.headers.get("If-None-Match") == version:
                self.send_response(304)
                self.end_headers()
                return
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(page)))
            self.send_header("ETag", version)
            self.send_header("Cache-Control", "no-cache")
            self.end_headers()
            self.wfile.write(page)

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - signature of the base class
            """Says nothing: stderr is for the analysis."""

    return Handler


def _stamp_of(folder: Path) -> Stamp:
    found = []
    for path in sorted(folder.rglob("*")):
        if path.suffix in TRACE_ENDINGS or not path.suffix:
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
    port: Annotated[int, typer.Option(metavar="PORT", help="0 takes a free one.")] = 8765,
    every: Annotated[
        float, typer.Option(metavar="SECONDS", help="Between two looks at the files.", min=0.1)
    ] = RELOAD_SECONDS,
) -> None:
    """Show the report of a folder in a browser while a sweep writes into it; Ctrl-C ends.

    [bold]dds-analyze watch runs/[/bold]
    """
    watcher = Watcher(folder, host, port)
    stop = threading.Event()
    with watcher.serving():
        print(f"Serving {watcher.address}", flush=True)
        try:
            while True:
                watcher.refresh()
                stop.wait(every)
        except KeyboardInterrupt:
            print("Stopped")
