import contextlib
import socket
import ssl
import threading

import pytest

from dds_trace.recorder.choices import Security
from dds_trace.recorder.security.keys import make_keys
from dds_trace.recorder.security.tls import TlsSocket, speaks_tls, tls_context, unlike_tls

pytest.importorskip("cryptography")

MEGABYTE = bytes(range(256)) * 4096


@pytest.fixture(scope="module")
def keys(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tls") / "keys"
    make_keys(folder, Security.ENCRYPT_RTPS)
    return str(folder)


def connected(keys_of_ping, keys_of_relay):
    ends = socket.socketpair()
    made = [None, None]

    def shake(side, keys):
        try:
            made[side] = TlsSocket(ends[side], tls_context(keys, listens=bool(side)), listens=bool(side))
        except OSError as error:
            made[side] = error
            ends[side].close()

    threads = [threading.Thread(target=shake, args=pair) for pair in enumerate((keys_of_ping, keys_of_relay))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return made


def received(end, count):
    data = bytearray()
    while len(data) < count:
        piece = bytearray(65536)
        size = end.recv_into(piece)
        assert size
        data += piece[:size]
    return bytes(data)


def test_megabytes_cross_in_both_directions_at_once(keys):
    ping, relay = connected(keys, keys)
    got = {}
    threads = [
        threading.Thread(target=lambda: got.update(relay=received(relay, len(MEGABYTE)))),
        threading.Thread(target=lambda: got.update(ping=received(ping, len(MEGABYTE)))),
        threading.Thread(target=lambda: ping.sendmsg((MEGABYTE[:10], MEGABYTE[10:]))),
    ]
    for thread in threads:
        thread.start()
    assert relay.send(MEGABYTE) == len(MEGABYTE)
    for thread in threads:
        thread.join()
    assert got == {"relay": MEGABYTE, "ping": MEGABYTE}
    ping.shutdown(socket.SHUT_RDWR)
    assert relay.recv_into(bytearray(10)) == 0
    ping.close()
    relay.close()


def test_version_cipher_and_peer_are_read_back(keys):
    ping, relay = connected(keys, keys)
    assert ping.describe().startswith("TLSv1.3 TLS_")
    assert ping.describe().endswith("peer dds_trace_relay")
    assert relay.describe().endswith("peer dds_trace_ping")
    ping.close()
    relay.close()


def test_a_certificate_of_another_authority_is_refused(keys, tmp_path):
    make_keys(tmp_path / "other", Security.ENCRYPT_RTPS)
    ping, relay = connected(str(tmp_path / "other"), keys)
    assert isinstance(ping, ssl.SSLError)
    assert isinstance(relay, OSError)


@contextlib.contextmanager
def served(answer):
    """The address at which one program accepts connections and answers each in its own way."""
    listener = socket.create_server(("127.0.0.1", 0))

    def serve():
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            answer(connection)

    serving = threading.Thread(target=serve)
    serving.start()
    try:
        yield listener.getsockname()
    finally:
        listener.shutdown(socket.SHUT_RDWR)  # closed only, it would take one more connection where `accept` waits
        listener.close()
        serving.join()


def test_a_program_at_an_address_with_and_without_tls(keys):
    def shake(connection):
        try:
            TlsSocket(connection, tls_context(keys, listens=True), listens=True)
        except OSError:
            connection.close()

    with served(shake) as secured, served(socket.socket.close) as plain:
        addresses = secured, plain
        assert [speaks_tls(*address) for address in addresses] == [True, False]
        assert "with TLS" in unlike_tls([addresses[0]], is_secured=False)
        assert "without TLS" in unlike_tls([addresses[1]], is_secured=True)
        assert unlike_tls([addresses[0]], is_secured=True) == ""
    assert speaks_tls(*addresses[0]) is None
