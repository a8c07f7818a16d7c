import select
import socket
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dds_trace.extensions.wire.classes import TcpFlows, WireClass
from dds_trace.extensions.wire.counts import (
    TCP_COUNTERS,
    ClosedConnections,
    TcpConnection,
    parse_tcp_info,
    read_connections,
)
from dds_trace.extensions.wire.packet_filter import PortRange
from dds_trace.recorder.kernel.counters import since

ACK, SYN, FIN = 0x10, 0x02, 0x01


@pytest.mark.parametrize(
    "segments",
    [
        [(1050, 100, ACK, WireClass.TCP_DATA_AGAIN, 50), (1150, 10, ACK, WireClass.TCP_DATA, 0)],
        [(1001, 100, ACK, WireClass.TCP_DATA_AGAIN, 99), (1100, 1, ACK, WireClass.TCP_DATA_AGAIN, 1)],
        [(5000, 100, ACK, WireClass.TCP_DATA, 0), (1100, 100, ACK, WireClass.TCP_DATA_AGAIN, 100)],
        [(500, 0, SYN, WireClass.TCP_CONTROL, 0), (501, 100, ACK, WireClass.TCP_DATA, 0)],
        [(1100, 9, FIN | ACK, WireClass.TCP_DATA, 0), (1100, 9, FIN | ACK, WireClass.TCP_DATA_AGAIN, 9)],
    ],
    ids=["half is new", "one byte is new", "a gap is new data", "a new connection with the same ports", "the last"],
)
def test_segments_after_the_first_are_new_or_sent_again(segments):
    flows = TcpFlows()
    assert flows.note("f", 1000, 100, ACK) == (WireClass.TCP_DATA, 0)
    for sequence, size, flags, *expected in segments:
        assert flows.note("f", sequence, size, flags) == tuple(expected)


@given(st.integers(2**32 - 300, 2**32 - 1), st.lists(st.booleans(), max_size=30))
def test_sequence_numbers_wrap(start, steps):
    flows, sent = TcpFlows(), 0
    for number, again in enumerate(steps):
        position = 0 if again and number else sent
        _, again_bytes = flows.note("f", (start + position) % 2**32, 10, ACK)
        assert again_bytes == (10 if again and number else 0)
        sent = max(sent, position + 10)


def test_fields_of_a_tcp_info_drawn_by_hand():
    info = bytearray(232)
    for offset, value in {16: 1448, 68: 23_000, 72: 1_500, 80: 10, 100: 7, 136: 90, 140: 80, 148: 20_000}.items():
        struct.pack_into("=I", info, offset, value)
    struct.pack_into("=QQ", info, 200, 1_000_000, 9_000)
    assert parse_tcp_info(bytes(info), 7500, 40000) == TcpConnection(
        7500, 40000, 7, 9_000, 1_000_000, 90, 80, 1448, 23_000, 1_500, 20_000, 10
    )


def test_a_least_round_trip_that_was_never_measured_is_zero():
    info = bytearray(232)
    for value, least_us in ((0xFFFFFFFF, 0), (7, 7)):
        struct.pack_into("=I", info, 148, value)
        assert parse_tcp_info(bytes(info), 1, 2).rtt_min_us == least_us


def test_an_older_kernels_shorter_tcp_info_leaves_zeros():
    assert parse_tcp_info(bytes(104), 1, 2) == TcpConnection(1, 2)


def test_the_kernel_says_the_same_of_a_connection_by_either_door():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with socket.create_connection(("127.0.0.1", port)) as client, server.accept()[0] as served:
            client.sendall(bytes(5000))
            left = 5000
            while left:
                left -= len(served.recv(left))
            info = client.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 256)
            own = parse_tcp_info(info, client.getsockname()[1], port)
            found = {
                (one.local_port, one.remote_port): one for one in read_connections([PortRange(port, port)]).values()
            }
            here, there = client.getsockname()[1], port
            assert set(found) == {(here, there), (there, here)}
            assert own.bytes_sent == found[here, there].bytes_sent == 5000
            assert own.retransmitted_segments == 0
            assert own.rtt_us > 0
            assert read_connections([PortRange(port + 1, port + 1)] if port < 65535 else []) == {}


def test_counters_are_those_since_and_the_rest_is_of_now():
    before = TcpConnection(1, 2, 3, 300, 1000, 10, 9, 1448, 50, 5, 40, 10)
    now = TcpConnection(1, 2, 5, 500, 3000, 30, 19, 1448, 60, 6, 30, 20)
    assert since(now, before, *TCP_COUNTERS) == TcpConnection(1, 2, 2, 200, 2000, 20, 10, 1448, 60, 6, 30, 20)


def test_a_connection_that_ends_says_its_last_word():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        closed = ClosedConnections([PortRange(port, port)])
        client = socket.create_connection(("127.0.0.1", port))
        served, _ = server.accept()
        assert closed.read() == {}
        client.sendall(bytes(777))
        assert len(served.recv(777, socket.MSG_WAITALL)) == 777
        here = client.getsockname()[1]
        client.close()
        served.close()
        found = {}
        while not any(one.local_port == here for one in found.values()):
            assert select.select([closed], [], [], 20)[0]
            found |= closed.read()
        assert here not in [one.local_port for one in read_connections([PortRange(port, port)]).values()]  # TIME_WAIT
        server.close()
        found |= closed.read()
        closed.close()
    (last,) = (one for one in found.values() if one.local_port == here)
    assert (last.remote_port, last.bytes_sent) == (port, 777)
    assert not any(one.remote_port == 0 for one in found.values())  # the listening socket has ended, too
