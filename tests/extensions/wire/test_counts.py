import json
from dataclasses import astuple

from dds_trace.base.records import from_json
from dds_trace.extensions.wire import messages
from dds_trace.extensions.wire.counts import ClassCount, InterfaceCount, TcpConnection, WireCounts, ip_counts
from dds_trace.extensions.wire.format import Direction
from dds_trace.recorder.payloads.stamp import Stamp

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
    repeats=(messages.RepeatCount(0, 8), messages.RepeatCount(1, 2, 1.0, 2.0, 3.0, 4.0)),
    messages=10,
    sample_bytes=4000,
    first_spdp_ns=5,
    first_data_ns=20,
    first_reply_ns=30,
    ip={**ip_counts({}, {}), "reassembly_failed": 3},
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


def test_nothing_is_divided_by_nothing():
    empty = WireCounts()
    assert {each for each in astuple(empty) if isinstance(each, float | int)} == {0}
    assert empty.wire_bytes_per_sample_byte is None
    assert empty.discovery_bytes_per_minute is None
    assert empty.again_bytes_share is None
    assert empty.match_ns is None
    assert empty.packets_per_s is None
    assert not WireCounts(kernel_drops=1).complete


def rows_of(rows):
    return messages.message_rows([messages.pack_rows(list(rows))])


def sample(sequence, repeats=(), resent_after_ns=None, heartbeats=0):
    return messages.SentSample(
        0, 9, 100, Stamp(1, sequence, 0), {(0, 1): 0}, dict(enumerate(repeats)), resent_after_ns, 0, heartbeats
    )


def test_messages_by_their_repeats_those_received_left_out():
    rows = rows_of(
        messages.message_row(*pair)
        for pair in [
            (sample(1), Direction.SENT),
            (sample(2, [1], 100, 2), Direction.SENT),
            (sample(3, [1], 300, 4), Direction.LOCAL),
            (sample(4, [3, 1], 50), Direction.SENT),
            (sample(5, [1], 999), Direction.RECEIVED),
        ]
    )
    assert messages.count_repeats(rows) == (
        messages.RepeatCount(0, 1),
        messages.RepeatCount(1, 2, 200.0, 280.0, 298.0, 300.0, 3.0),
        messages.RepeatCount(3, 1, 50.0, 50.0, 50.0, 50.0, 0.0),
    )
    assert rows["fragments_again"].tolist() == [0, 1, 4, 1, 1]


def test_without_messages_there_is_nothing_to_count():
    assert messages.count_repeats(rows_of([])) == ()


def test_the_kernels_counters():
    before = {"ReasmReqds": 100, "ReasmOKs": 10, "ReasmFails": 5}
    now = before | {"ReasmReqds": 300, "ReasmOKs": 40, "RcvbufErrors": 11}
    counts = ip_counts(now, before)
    rises = {"reassembly_requested": 200, "reassembly_ok": 30, "udp_receive_buffer_full": 11}
    assert counts == {**dict.fromkeys(ip_counts({}, {}), 0), **rises}
