"""An HTTP server of pages for this machine, on which a stranger takes at most 16 threads, for ten seconds each."""

from __future__ import annotations

import hmac
import ipaddress
import socket
import sys
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, TypeAlias

from dds_trace.base.streams import say

MOST_CONNECTIONS, CONNECTION_S = 16, 10.0
"""Each connection takes a thread and an open file of the program; a page asks once a second."""


MOST_POSTED_BYTES = 16 << 10
"""Most of what a page may send: a form."""

Answer: TypeAlias = "tuple[str, bytes, str]"
"""Type of the content, the content, and its version or nothing."""


class LocalServer(ThreadingHTTPServer):
    """Serves `answers` by path, to requests that name this machine, or it by one of further `names`.

    Args:
        posts: what takes a body of a page of this server, by path.
        key: of the first address, `/?key=...`, from which a browser has it as a cookie; without it nothing is answered. Empty: none.
    """

    def __init__(
        self,
        host: str,
        port: int,
        answers: Mapping[str, Callable[[], Answer]],
        names: Iterable[str] = (),
        *,
        posts: Mapping[str, Callable[[bytes], Answer]] | None = None,
        key: str = "",
    ) -> None:
        self._free = threading.BoundedSemaphore(MOST_CONNECTIONS)
        self.answers, self.posts, self.host, self.key = answers, posts or {}, host, key
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
        if not self._names_this_machine():
            return
        if self.server.key and hmac.compare_digest(self.path.encode(), f"/?key={self.server.key}".encode()):
            self.send_response(HTTPStatus.SEE_OTHER)  # the key leaves the address, which others may see
            self.send_header("Set-Cookie", f"{self._cookie}={self.server.key}; HttpOnly; SameSite=Strict; Path=/")
            self.send_header("Location", "/")
            self.send_header("Content-Length", "0")
            self.end_headers()
        elif not self._has_key():
            self.send_error(HTTPStatus.FORBIDDEN, explain="open the address that the command printed")
        elif answer is None:
            self.send_error(HTTPStatus.NOT_FOUND)
        else:
            self._send(*answer())

    def do_POST(self) -> None:
        post, length = self.server.posts.get(self.path), self.headers.get("Content-Length", "")
        if not self._names_this_machine():
            return
        if not self._has_key() or self.headers.get("Origin") != f"http://{self.headers.get('Host')}":
            self.send_error(HTTPStatus.FORBIDDEN, explain="only this server's own page may start or stop anything")
        elif post is None:
            self.send_error(HTTPStatus.NOT_FOUND)
        elif not (length.isascii() and length.isdigit() and int(length) <= MOST_POSTED_BYTES):
            self.send_error(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
        else:
            self._send(*post(self.rfile.read(int(length))))

    def _names_this_machine(self) -> bool:
        is_named = is_own_name(self.headers.get("Host", ""), self.server.host, self.server.names)
        if not is_named:
            self.send_error(
                HTTPStatus.MISDIRECTED_REQUEST, explain="watch --name HOST allows a further name of this machine"
            )
        return is_named

    @property
    def _cookie(self) -> str:
        return f"dds-trace-{self.server.server_address[1]}"

    def _has_key(self) -> bool:
        try:
            given = SimpleCookie(self.headers.get("Cookie", "")).get(self._cookie)
        except CookieError:
            given = None
        return hmac.compare_digest("" if given is None else given.value, self.server.key)

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
