"""Fuzz target `watch`: any bytes that a program sends to the page's port get an answer of HTTP or none; nothing is raised."""

import socket
from http import HTTPStatus
from pathlib import Path

from fuzz_shapes import shaped, shaped_seeds

from dds_trace.extensions.live.live import Watcher, WatchOptions

SECRET = b"not for visitors"
REQUEST = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
ANSWERS = {status.value for status in HTTPStatus}


class Target:
    def __init__(self, folder: Path) -> None:
        (folder / "secret.txt").write_bytes(SECRET)
        watcher = Watcher(WatchOptions(folder))
        self._server = watcher._server  # asked without its threads and its port, one request after the other
        self._server.server_close()
        self._shapes = (self._bytes, self._target, self._header)

    def try_input(self, data: bytes) -> None:
        request = shaped(self._shapes, data)
        ours, theirs = socket.socketpair()
        with ours, theirs:
            ours.sendall(request)
            ours.shutdown(socket.SHUT_WR)
            self._server.RequestHandlerClass(theirs, ("127.0.0.1", 1), self._server)
            theirs.close()
            answer = bytearray()
            while part := ours.recv(65536):
                answer += part
        if SECRET in answer:
            raise AssertionError("a file was served")
        first, *_ = bytes(answer).partition(b"\r\n")
        if first.startswith(b"HTTP/") and int(first.split()[1]) not in ANSWERS:
            raise AssertionError(f"an answer of no meaning: {first!r}")

    def seeds(self) -> dict[str, bytes]:
        return shaped_seeds(
            self._shapes, {self._bytes: REQUEST, self._target: b"/version", self._header: b'If-None-Match: "0"'}
        )

    def _bytes(self, data: bytes) -> bytes:
        return data

    def _target(self, data: bytes) -> bytes:
        return REQUEST.replace(b"/ ", data + b" ", 1)

    def _header(self, data: bytes) -> bytes:
        return REQUEST[:-2] + data + b"\r\n\r\n"
