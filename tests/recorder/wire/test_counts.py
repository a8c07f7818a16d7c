from __future__ import annotations

import json

import pytest

from dds_trace.recorder.payloads.stamp import Stamp
from dds_trace.recorder.records import from_json, to_json
from dds_trace.recorder.wire.counts import (
    ClassCount,
    InterfaceCount,
    IpCounts,
    WireCounts,
    read_interfaces,
    read_ip_counts,
)
from dds_trace.recorder.wire.messages import (
    RepeatCount,
    SentSample,
    count_repeats,
    message_row,
    message_rows,
    pack_rows,
)
from dds_trace.recorder.wire.tcp_info import TcpConnection
from dds_trace.tracefile.format.wire import Direction

COUNTS = WireCounts(
    run_id="00000000000000ab",
    interfaces=("lo", "eth0"),
    begin_ns=1_000_000_000,
    end_ns=31_000_000_000,
    classes=(
        ClassCount("data", "sent", 10, 6000, 10, 10, 4),
        ClassCount("data_again", "sent", 2, 1200, 2),
        ClassCount("spdp", "sent", 3, 700, 3),
        ClassCount("sedp", "received", 1, 100, 1),
    ),
    repeats=(RepeatCount(0, 8), RepeatCount(1, 2, 1.0, 2.0, 3.0, 4.0)),
    messages=10,
    sample_bytes=4000,
    first_spdp_ns=5,
    first_data_ns=20,
    first_reply_ns=30,
    ip=IpCounts(reassembly_failed=3),
    tcp=(TcpConnection(7500, 40000, 2),),
    interface_counts=(InterfaceCount("eth0", 1, 2, 3, 4),),
    packets=3000,
)


def test_what_is_derived():
    assert COUNTS.complete
    assert COUNTS.duration_s == 30
    assert COUNTS.total_bytes == 8000
    assert COUNTS.wire_bytes_per_sample_byte == 2
    assert COUNTS.discovery_bytes_per_minute == 1600
    assert COUNTS.again_bytes_share == 0.15
    assert COUNTS.match_ns == 25
    assert COUNTS.packets_per_s == 100


def test_json_and_back():
    written = json.loads(json.dumps(COUNTS.to_dict()))
    assert written["complete"] is True
    assert from_json(WireCounts, written) == COUNTS


def test_a_newer_and_an_older_traces_fields():
    written = COUNTS.to_dict() | {"of_a_later_version": 1}
    written["classes"][0]["colour"] = "red"
    assert from_json(WireCounts, written) == COUNTS
    assert from_json(WireCounts, {}) == WireCounts()


def test_drops_make_it_incomplete():
    assert not WireCounts(kernel_drops=1).complete


def test_nothing_is_divided_by_nothing():
    empty = WireCounts()
    assert empty.wire_bytes_per_sample_byte is None
    assert empty.discovery_bytes_per_minute is None
    assert empty.again_bytes_share is None
    assert empty.match_ns is None
    assert empty.packets_per_s is None


def rows_of(rows):
    return message_rows([pack_rows(list(rows))])


def sample(sequence, repeats=(), resent_after_ns=None, heartbeats=0):
    return SentSample(
        0, 9, 100, Stamp(1, sequence, 0), {(0, 1): 0}, dict(enumerate(repeats)), resent_after_ns, 0, heartbeats
    )


def test_messages_by_their_repeats_those_received_left_out():
    rows = rows_of(
        message_row(*pair)
        for pair in [
            (sample(1), Direction.SENT),
            (sample(2, [1], 100, 2), Direction.SENT),
            (sample(3, [1], 300, 4), Direction.LOCAL),
            (sample(4, [3, 1], 50), Direction.SENT),
            (sample(5, [1], 999), Direction.RECEIVED),
        ]
    )
    assert count_repeats(rows) == (
        RepeatCount(0, 1),
        RepeatCount(1, 2, 200.0, 280.0, 298.0, 300.0, 3.0),
        RepeatCount(3, 1, 50.0, 50.0, 50.0, 50.0, 0.0),
    )
    assert rows["fragments_again"].tolist() == [0, 1, 4, 1, 1]


def test_without_messages_there_is_nothing_to_count():
    assert count_repeats(rows_of([])) == ()


SNMP = """\
Ip: Forwarding ReasmTimeout ReasmReqds ReasmOKs ReasmFails FragOKs FragFails FragCreates
Ip: 1 2 300 40 5 6 7 80
Icmp: InMsgs
Icmp: 3
Udp: InDatagrams NoPorts InErrors OutDatagrams RcvbufErrors
Udp: 100 1 12 90 11
"""


@pytest.fixture
def proc(tmp_path):
    (tmp_path / "self/net").mkdir(parents=True)
    (tmp_path / "self/net/snmp").write_text(SNMP)
    (tmp_path / "self/net/dev").write_text(DEV)
    return tmp_path


def test_the_kernels_counters(proc, tmp_path):
    now = read_ip_counts(proc)
    assert now == IpCounts(300, 40, 5, 2, 6, 7, 80, 11, 12)
    assert now.since(IpCounts(100, 10, 5)) == IpCounts(200, 30, 0, 2, 6, 7, 80, 11, 12)
    assert read_ip_counts(tmp_path / "nothing") == IpCounts()
    assert from_json(IpCounts, to_json(now)) == now


DEV = """\
Inter-|   Receive                                                |  Transmit
 face |bytes    packets errs drop fifo frame compressed multicast|bytes    packets errs drop fifo colls carrier compressed
    lo:    5000      50    0    0    0     0          0         0     5000      50    0    0    0     0       0          0
  eth0: 7 6 0 0 0 0 0 0 9 8 0 0 0 0 0 0
"""


def test_the_interfaces_counters(proc):
    eth0, lo = read_interfaces(["eth0", "lo", "missing"], proc)
    assert (eth0, lo) == (InterfaceCount("eth0", 9, 8, 7, 6), InterfaceCount("lo", 5000, 50, 5000, 50))
    assert InterfaceCount("eth0", 19, 10, 8, 7).since(eth0) == InterfaceCount("eth0", 10, 2, 1, 1)
    assert InterfaceCount("new", 1, 1, 1, 1).since(None) == InterfaceCount("new", 1, 1, 1, 1)
