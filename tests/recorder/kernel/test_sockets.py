import os
import socket
import struct
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import astuple, replace
from pathlib import Path

import pytest

from dds_trace.recorder.kernel import sockets
from dds_trace.recorder.kernel.sockets import DiagError, TcpState, dump_sockets, read_sockets


def found(opened):
    (only,) = [each for each in read_sockets() if each.inode == os.fstat(opened.fileno()).st_ino]
    return only


@pytest.fixture
def udp():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1", 0))
        yield opened


def test_a_udp_socket_has_its_addresses_and_the_buffers_that_the_kernel_granted(udp):
    udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 50_000)
    udp.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 60_000)
    read = found(udp)
    assert (read.protocol, read.family) == ("udp", "ipv4")
    assert (read.local_address, read.local_port) == udp.getsockname()
    assert (read.remote_address, read.remote_port) == ("0.0.0.0", 0)
    assert (read.receive_buffer_bytes, read.send_buffer_bytes) == (100_000, 120_000)
    assert read.dropped == 0
    assert read.tcp is None


def test_more_than_the_kernel_allows_is_granted_up_to_its_limit(udp):
    udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, (1 << 31) - 1)
    limit_bytes = int(Path("/proc/sys/net/core/rmem_max").read_text())
    assert found(udp).receive_buffer_bytes == 2 * limit_bytes


def test_datagrams_that_do_not_fit_are_counted_at_their_socket(udp):
    udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for _ in range(20):
            sender.sendto(bytes(2000), udp.getsockname())
    udp.setblocking(False)
    kept = 0
    while True:
        try:
            udp.recv(4096)
        except BlockingIOError:
            break
        kept += 1
    assert 0 < kept < 20
    assert found(udp).dropped == 20 - kept


@contextmanager
def connection(sent_bytes):
    """A listening socket and both ends of a connection over which so many bytes went and one came back."""
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()) as client:
        accepted, _ = server.accept()
        with accepted:
            client.sendall(bytes(sent_bytes))
            received = 0
            while received < sent_bytes:
                received += len(accepted.recv(65536))
            accepted.sendall(b"x")  # carries the acknowledgement of all that came before
            client.recv(1)
            yield server, client, accepted


def test_a_tcp_connection_says_how_it_fares():
    with connection(10_000) as opened:
        listening, sending, receiving = map(found, opened)
        congestion_control = opened[1].getsockopt(socket.IPPROTO_TCP, socket.TCP_CONGESTION, 16)
    assert sending.tcp.congestion_control == congestion_control.rstrip(b"\0").decode()
    assert receiving.tcp.received_bytes == 10_000
    assert sending.tcp.congestion_window > 0
    assert sending.tcp.rtt_us > 0
    assert sending.tcp.retransmitted == 0
    assert sending.is_local
    assert not replace(sending, remote_address="192.0.2.1").is_local
    assert (sending.remote_address, sending.remote_port) == (listening.local_address, listening.local_port)
    assert listening.is_listening
    assert listening.tcp is None
    assert not listening.is_local


def test_acknowledged_bytes_are_those_that_the_kernel_tells_the_program():
    with connection(5000) as (_, client, _accepted):
        info = client.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 256)
        read = found(client).tcp
    assert read.acked_bytes == struct.unpack_from("=Q", info, 120)[0] >= 5000
    assert read.received_bytes == 1


def test_an_ipv6_socket_is_found_under_its_address():
    if not socket.has_ipv6:
        pytest.skip("no IPv6 here")
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as opened:
        try:
            opened.bind(("::1", 0))
        except OSError:
            pytest.skip("no IPv6 loopback here")
        read = found(opened)
        assert (read.family, read.local_address, read.local_port) == ("ipv6", "::1", opened.getsockname()[1])


def test_sockets_of_other_processes_are_theirs(udp):
    code = (
        "import socket, sys\n"
        "opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)\n"
        "opened.bind(('127.0.0.1', 0))\n"
        "print(opened.getsockname()[1], flush=True)\n"
        "sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        port = int(other.stdout.readline())
        theirs, ours = read_sockets(other.pid), read_sockets()
        other.communicate("")
    assert [each.local_port for each in theirs] == [port]
    assert port not in [each.local_port for each in ours if each.protocol == "udp"]
    assert udp.getsockname()[1] in [each.local_port for each in ours]


def test_where_the_kernel_does_not_answer_nothing_is_known(monkeypatch):
    def refuse(*_):
        raise DiagError(2, "no such module")

    monkeypatch.setattr(sockets, "dump_sockets", refuse)
    assert read_sockets() is None


@pytest.mark.parametrize(("told", "dropped"), [(0, None), (8, {0})], ids=["nothing", "no drops"])
def test_a_kernel_that_tells_no_buffer_sizes_tells_nothing(told, dropped, monkeypatch, udp):
    def with_less(*asked):
        return [replace(each, attributes={7: each.attributes.get(7, b"")[: 4 * told]}) for each in dump_sockets(*asked)]

    monkeypatch.setattr(sockets, "dump_sockets", with_less)
    read = read_sockets()
    assert (read and {each.dropped for each in read}) == dropped
    assert udp.fileno() >= 0


def test_an_attribute_may_be_empty_and_one_without_its_own_length_ends_them():
    body = bytes([socket.AF_INET]) + bytes(71) + struct.pack("=HHHHIHH", 4, 5, 8, 7, 9, 3, 1)
    assert sockets.parse_socket(body).attributes == {5: b"", 7: struct.pack("=I", 9)}


def test_a_protocol_that_the_kernel_does_not_know_is_an_error():
    with pytest.raises(DiagError):
        dump_sockets(socket.AF_INET, 253)  # reserved for experiments, RFC 3692


def test_of_a_process_that_is_gone_nothing_is_known():
    assert {*astuple(TcpState())} == {"", 0}
    assert read_sockets(1 << 22) is None
