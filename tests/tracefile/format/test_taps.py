"""Events of a tap: written, read back, recovered, and their identity."""

from __future__ import annotations

import hashlib
import struct

import numpy as np
import pytest
from event_cdr import unpack_event
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from trace_files import ping_session

from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.format.taps import PUBLISHER_TOPIC, TapColumns, hash_content
from dds_trace.tracefile.reading.reader import read_trace
from dds_trace.tracefile.recovery.recover import recover
from dds_trace.tracefile.writing.destination import TraceDestination
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
