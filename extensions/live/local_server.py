"""An HTTP server of pages for this machine, on which a stranger takes at most 16 threads, for ten seconds each."""

from __future__ import annotations

import ipaddress
import socket
import sys
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, TypeAlias

from dds_trace.base.streams import say

MOST_CONNECTIONS, CONNECTION_S = 16, 10.0
"""Each connection takes a thread and an open file of the program; a page asks once a second."""


Answer: TypeAlias = "tuple[str, bytes, str]"
"""Type of the content, the content, and its version or nothing."""


class LocalServer(ThreadingHTTPServer):
    """Serves `answers` by path, to requests that name this machine, or it by one of further `names`."""

    def __init__(
        self, host: str, port: int, answers: Mapping[str, Callable[[], Answer]], names: Iterable[str] = ()
    ) -> None:
        self._free = threading.BoundedSemaphore(MOST_CONNECTIONS)
        self.answers, self.host = answers, host
        self.names = {name.lower().rstrip(".") for name in (host, *own_names(), *names)}
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        super().__init__((host, port), _Handler)

    @contextmanager
    def serving(self) -> Iterator[None]:
        thread = threading.Thread(target=self.serve_forever, name="local-server", daemon=True)
        thread.start()
        try:
            yield
        finally:
            self.shutdown()
            thread.join()
            self.server_close()

    def process_request(self, request: Any, client_address: Any) -> None:
        if not self._free.acquire(blocking=False):
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except RuntimeError:  # no further thread
            self._free.release()
            raise

    def handle_error(self, _request: object, client_address: object) -> None:
        error = sys.exc_info()[1]
        if not isinstance(error, ConnectionError | TimeoutError):
            say(f"{client_address}: {type(error).__name__}: {error}")

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        def end() -> None:
            with suppress(OSError):
                request.shutdown(socket.SHUT_RDWR)

        timer = threading.Timer(CONNECTION_S, end)
        timer.daemon = True
        try:
            timer.start()
            super().process_request_thread(request, client_address)
        finally:
            timer.cancel()
            self._free.release()


def own_names() -> set[str]:
    """Return the names of this machine, also as mDNS has it; whoever rebinds a name in the DNS has none of these."""
    name = socket.gethostname()
    return {"localhost", name, name.partition(".")[0], f"{name.partition('.')[0]}.local"}


def is_own_name(host: str, bound: str, names: Collection[str] = ("localhost",)) -> bool:
    """Return whether a request's `Host` is this server's: any other name may come from DNS rebinding, and read the page."""
    name = host.strip().lower()
    name = name[1:].partition("]")[0] if name.startswith("[") else name.partition(":")[0]
    if name == bound.lower() or name.rstrip(".") in names:
        return True
    try:
        address = ipaddress.ip_address(name)
        return address.is_loopback or ipaddress.ip_address(bound).is_unspecified
    except ValueError:
        return False


class _Handler(BaseHTTPRequestHandler):
    server: LocalServer

    def do_GET(self) -> None:
        answer = self.server.answers.get(self.path)
        if not is_own_name(self.headers.get("Host", ""), self.server.host, self.server.names):
            self.send_error(
                HTTPStatus.MISDIRECTED_REQUEST, explain="watch --name HOST allows a further name of this machine"
            )
        elif answer is None:
            self.send_error(HTTPStatus.NOT_FOUND)
        else:
            self._send(*answer())

    def _send(self, kind: str, body: bytes, version: str) -> None:
        if version and self.headers.get("If-None-Match") == f'"{version}"':
            self.send_response(HTTPStatus.NOT_MODIFIED)
            self.end_headers()
            return
        self.send_response(HTTPStatus.OK)
        headers = {
            "Content-Type": f"{kind}; charset=utf-8",
            "Content-Length": str(len(body)),
            "Cache-Control": "no-cache",
        }
        for name, value in {**headers, **({"ETag": f'"{version}"'} if version else {})}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None: ...  # stderr is for the program's own lines
