"""TLS with the keys of a measurement: each side checks the other's certificate."""

from __future__ import annotations

import socket
import ssl
import threading
from collections.abc import Iterable, Sequence

from .keys import enclave

HANDSHAKE_S = 2.0
PIECE_BYTES = 1 << 18


def tls_context(keys: str, *, listens: bool) -> ssl.SSLContext:
    """Return the context of one side; the other one's address is in no certificate."""
    folder = enclave(keys, listens=listens)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER if listens else ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.check_hostname = False
    context.verify_mode = ssl.CERT_REQUIRED
    context.load_verify_locations(folder / "identity_ca.cert.pem")
    context.load_cert_chain(folder / "cert.pem", folder / "key.pem")
    return context


class TlsSocket:
    """A TLS socket that one thread reads while others write: `ssl.SSLSocket` would block them, or break its state."""

    def __init__(self, connection: socket.socket, context: ssl.SSLContext, *, listens: bool) -> None:
        """Shake hands; an `OSError` means that the peer has no TLS, or no certificate of this authority."""
        self._connection = connection
        self._incoming, self._outgoing, self._using = ssl.MemoryBIO(), ssl.MemoryBIO(), threading.Lock()
        self._tls = context.wrap_bio(self._incoming, self._outgoing, server_side=listens)
        connection.settimeout(HANDSHAKE_S)
        while True:
            try:
                self._tls.do_handshake()
                break
            except ssl.SSLWantReadError:
                connection.sendall(self._outgoing.read())
                self._take_in()
        connection.sendall(self._outgoing.read())
        connection.settimeout(None)
        self.fileno, self.setsockopt = connection.fileno, connection.setsockopt
        self.shutdown, self.close, self.getsockname = connection.shutdown, connection.close, connection.getsockname

    def describe(self) -> str:
        cipher, certificate = self._tls.cipher(), self._tls.getpeercert() or {}
        names = [pair[1] for part in certificate.get("subject", ()) for pair in part]
        return f"{self._tls.version()} {cipher[0] if cipher else ''}, peer {', '.join(map(str, names))}"

    def _take_in(self) -> bool:
        data = self._connection.recv(PIECE_BYTES)
        if not data:
            return False
        with self._using:
            self._incoming.write(data)
        return True

    def recv_into(self, buffer: bytearray | memoryview) -> int:
        while True:
            with self._using:
                try:
                    return int(self._tls.read(len(buffer), buffer))
                except ssl.SSLWantReadError:
                    pass
                except ssl.SSLZeroReturnError:
                    return 0
            if not self._take_in():
                return 0

    def sendmsg(self, parts: Sequence[bytes | bytearray | memoryview]) -> int:
        sent = 0
        with self._using:
            for part in parts:
                remainder = memoryview(part)
                while remainder:
                    count = self._tls.write(remainder)
                    remainder, sent = remainder[count:], sent + count
            data = self._outgoing.read()
        self._connection.sendall(data)
        return sent

    def send(self, data: bytes | memoryview) -> int:
        return self.sendmsg((data,))


def zenoh_tls(keys: str, *, listens: bool) -> dict[str, object]:
    folder = enclave(keys, listens=listens)
    certificate, key = str(folder / "cert.pem"), str(folder / "key.pem")
    return {
        "root_ca_certificate": str(folder / "identity_ca.cert.pem"),
        "enable_mtls": True,
        "verify_name_on_connect": False,
        "listen_certificate": certificate,
        "listen_private_key": key,
        "connect_certificate": certificate,
        "connect_private_key": key,
    }


def speaks_tls(host: str, port: int) -> bool | None:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    try:
        with socket.create_connection((host, port), HANDSHAKE_S) as plain:
            try:
                with context.wrap_socket(plain):
                    return True
            except (OSError, ValueError):  # it is silent, or answers something else
                return False
    except OSError:
        return None


def unlike_tls(addresses: Iterable[tuple[str, int]], *, is_secured: bool) -> str:
    for host, port in addresses:
        if speaks_tls(host, port) is (not is_secured):
            other = "without TLS" if is_secured else "with TLS (-o security)"
            return f"a program at {host}:{port} {other}, and this ping is {'with' if is_secured else 'without'}"
    return ""
