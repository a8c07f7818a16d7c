import socket
from contextlib import ExitStack
from urllib.request import urlopen

import pytest

from dds_trace.extensions.live import local_server
from dds_trace.extensions.live.local_server import MOST_CONNECTIONS, LocalServer


@pytest.fixture
def server():
    served = LocalServer("127.0.0.1", 0, {"/": lambda: ("text/plain", b"here", "")})
    with served.serving():
        yield served


def silent(stack, server):
    return stack.enter_context(socket.create_connection(server.server_address, timeout=60))


def test_what_exceeds_the_bound_is_closed_at_once(server):
    with ExitStack() as stack:
        connections = [silent(stack, server) for _ in range(MOST_CONNECTIONS + 1)]
        assert connections[-1].recv(1) == b""
        connections[0].sendall(b"GET / HTTP/1.0\r\nHost: localhost\r\n\r\n")
        assert connections[0].makefile("rb").read().endswith(b"here")


def test_a_silent_connection_ends(server, monkeypatch, capfd):
    monkeypatch.setattr(local_server, "CONNECTION_S", 0.2)
    with ExitStack() as stack:
        connections = [silent(stack, server)]
        connections[0].sendall(b"G")
        connections += [silent(stack, server) for _ in range(MOST_CONNECTIONS - 1)]
        assert {connection.recv(1) for connection in connections} == {b""}
        for step in [server._free.acquire] * MOST_CONNECTIONS + [server._free.release] * MOST_CONNECTIONS:
            step()  # until the last handler has ended
        assert capfd.readouterr().err == ""
        host, port = server.server_address
        with urlopen(f"http://{host}:{port}/", timeout=60) as answer:
            assert answer.read() == b"here"
