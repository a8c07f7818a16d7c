import hashlib
import struct

import numpy as np
import pytest
from event_cdr import unpack_event
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from trace_files import ping_session

from dds_trace.extensions.bags.recover_trace import recover
from dds_trace.tracefile.format.bag_metadata import RecordedTopic
from dds_trace.tracefile.format.events import PUBLISHER_TOPIC, Stage, TapColumns, hash_content
from dds_trace.tracefile.reading.reader import read_trace
from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.event_chunks import MOST_WAITING_BYTES
from dds_trace.tracefile.writing.sink import TraceSink

TAP = 5
EVENTS = [(2**64 - 1 - n, n + 1, 1000 * n, 5 * n, 7 * n, 9 * n, 100 + n, 1) for n in range(50)]
DESCRIPTION = {"session_id": "00000000000000a1", "publisher_id": 1, "topic": "/camera", "state": "heard"}


def open_tap(path):
    session = ping_session(role="tap", state="open")
    return TraceSink(TraceDestination(path, chunk_seconds=3600.0), session, clock_ns=lambda: 0)


def fill(sink):
    for event in EVENTS:
        sink.record(TAP, *event)
    sink.write_json(PUBLISHER_TOPIC, DESCRIPTION)
    sink.write_json(PUBLISHER_TOPIC, {**DESCRIPTION, "state": "closed"})


def test_events_of_a_tap_are_read_back_by_their_names(tmp_path):
    sink = open_tap(tmp_path / "tap.mcap")
    fill(sink)
    sink.close()
    trace = read_trace(tmp_path / "tap.mcap")
    taps = TapColumns.from_events(trace.events[Stage.TAP])
    assert taps.content_hash.tolist() == [event[0] for event in EVENTS]
    assert taps.publication_sequence.tolist() == [event[1] for event in EVENTS]
    assert taps.header_ns.tolist() == [event[3] for event in EVENTS]
    assert taps.publisher_id.tolist() == [1] * len(EVENTS)
    assert trace.publishers == ({**DESCRIPTION, "state": "closed"},)
    assert not sum(len(events) for stage, events in trace.events.items() if stage is not Stage.TAP)


def test_the_official_reader_and_rosbags_know_the_schema(tmp_path):
    sink = open_tap(tmp_path / "bag")
    fill(sink)
    sink.close()
    with (tmp_path / "bag/bag_0.mcap").open("rb") as stream:
        messages = [
            (schema.name, unpack_event(message.data))
            for schema, channel, message in make_reader(stream).iter_messages()
            if channel.topic == "/dds_trace/tap"
        ]
    assert messages == [("dds_trace_msgs/msg/TapEvent", event) for event in EVENTS]
    with AnyReader([tmp_path / "bag"]) as reader:
        connection = next(one for one in reader.connections if one.topic == "/dds_trace/tap")
        first = next(reader.deserialize(data, one.msgtype) for one, _, data in reader.messages([connection]))
    assert (first.content_hash, first.payload_bytes, first.publisher_id) == (2**64 - 1, 100, 1)


def messages_of_others(path):
    with path.open("rb") as stream:
        return [
            (channel.topic, schema.name, schema.data, channel.message_encoding, message.data, message.log_time)
            for schema, channel, message in make_reader(stream).iter_messages()
            if not channel.topic.startswith("/dds_trace/")
        ]


@pytest.mark.parametrize("is_cut", [False, True])
def test_payloads_are_read_by_others_and_survive_a_kill(tmp_path, is_cut):
    image = RecordedTopic("/camera", "my_msgs/msg/Camera", "cdr", "uint8[] data\n")
    unknown = RecordedTopic("robot/speed", "", "")
    contents = [(image, b"\0\1\0\0" + bytes([number]) * 56) for number in range(40)]  # as long as an event
    contents += [(image, b"\0\1\0\0" + bytes(3 << 20)), (image, bytes(5 << 20)), (unknown, b"12 m/s")]
    file = tmp_path / "tap.mcap"
    sink = open_tap(file)
    fill(sink)
    for number, (topic, data) in enumerate(contents):
        sink.keep_payload(topic, data, number)
    sink.write_json(PUBLISHER_TOPIC, DESCRIPTION)
    if is_cut:
        (tmp_path / "cut.mcap").write_bytes(file.read_bytes())
        file = tmp_path / "cut.mcap"
    assert sink.close().error is None
    if is_cut:
        assert recover(file).file_events == len(EVENTS)
    read = messages_of_others(file)
    assert [one[:5] for one in read] == [
        (topic.name, topic.message_type, topic.definition.encode(), topic.encoding, data) for topic, data in contents
    ]
    assert np.diff([one[5] for one in read]).tolist() == [1] * (len(contents) - 1)
    trace = read_trace(file)
    assert (len(trace.events[Stage.TAP]), trace.truncated, trace.notes) == (len(EVENTS), None, ())
    assert trace.publishers[-1]["topic"] == "/camera"


def test_what_waits_for_the_disk_is_bounded(tmp_path):
    sink, topic = open_tap(tmp_path / "tap.mcap"), RecordedTopic("/camera", "my_msgs/msg/Camera", "cdr")
    sink.pause()
    for number in range(5):
        sink.keep_payload(topic, bytes(MOST_WAITING_BYTES // 4), number)
    assert (sink.payloads.left_out, sink.payloads.waiting_bytes) == (1, MOST_WAITING_BYTES)
    sink.resume()
    assert sink.payloads.waiting_bytes == 0
    sink.close()
    assert len(messages_of_others(tmp_path / "tap.mcap")) == 4


def test_a_killed_tap_loses_no_event(tmp_path):
    sink = open_tap(tmp_path / "tap.mcap")
    for event in EVENTS:
        sink.record(TAP, *event)
    for file in (tmp_path / "tap.mcap", tmp_path / "tap.mcap.ring"):  # as a kill leaves them: nothing is in the file
        (tmp_path / "killed").mkdir(exist_ok=True)
        (tmp_path / "killed" / file.name).write_bytes(file.read_bytes())
    sink.close()
    assert len(read_trace(tmp_path / "killed/tap.mcap").events[Stage.TAP]) == len(EVENTS)
    assert recover(tmp_path / "killed/tap.mcap").ring_events == len(EVENTS)
    assert len(read_trace(tmp_path / "killed/tap.mcap").events[Stage.TAP]) == len(EVENTS)


@pytest.mark.parametrize("size", [4, 5, 7, 8, 1000, 1001])
def test_padding_and_encapsulation_are_no_part_of_a_message(size):
    message = bytes(range(256)) * 4
    message = b"\0\1\0\0" + message[: size - 4]
    padded = b"\0\1\0\3" + message[4:].ljust(-(-len(message) // 4) * 4 - 4, b"\0")
    assert hash_content(message) == hash_content(padded) == hash_content(bytearray(message))
    content = message[4:].ljust(-(-len(message[4:]) // 4) * 4, b"\0")
    assert hash_content(message) == struct.unpack("<Q", hashlib.blake2b(content, digest_size=8).digest())[0]


def test_other_content_has_another_identity():
    messages = [b"\0\1\0\0" + number.to_bytes(4, "little") for number in range(1000)]
    assert len(np.unique([hash_content(message) for message in messages])) == 1000
