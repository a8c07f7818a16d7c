import struct

import numpy as np
import pytest
from event_cdr import pack_event
from mcap.data_stream import RecordBuilder
from mcap.records import Message

from dds_trace.extensions.wire.format import MESSAGE_ROW, row_texts, rows_of_text
from dds_trace.tracefile.format.encoding import decode_string, encode_string
from dds_trace.tracefile.format.events import EVENT_RECORD_BYTES, EVENT_RECORD_DTYPE, fill_constants


def test_an_event_is_the_message_that_mcap_writes():
    event = pack_event(1, 2, 3, 4, 5, 6, 7, 8)
    (record,) = records = np.zeros(1, EVENT_RECORD_DTYPE)
    fill_constants(records)
    record["channel_id"], record["number"], record["times_ns"] = 9, 10, (11, 12)
    record["event"] = np.void(event[4:])
    builder = RecordBuilder()
    Message(channel_id=9, sequence=10, log_time=11, publish_time=12, data=event).write(builder)
    assert records.tobytes() == builder.end()
    assert len(records.tobytes()) == EVENT_RECORD_BYTES == 91
    assert struct.unpack_from("<BQ", records.tobytes()) == (5, 82)


def test_a_text_is_little_endian_with_a_nul():
    assert encode_string("ab") == b"\x00\x01\x00\x00\x03\x00\x00\x00ab\x00"
    assert decode_string(encode_string("Zürich")) == "Zürich"
    assert decode_string(encode_string("")) == ""


def test_either_byte_order_is_read_and_padding_ignored():
    assert decode_string(b"\x00\x00\x00\x00\x00\x00\x00\x03ab\x00") == "ab"
    assert decode_string(memoryview(encode_string("ab") + b"\0\0")) == "ab"


@pytest.mark.parametrize(
    "data", [b"", b"\x00\x01\x00\x00\x01", encode_string("")[:-1], b"\x00\x07" + encode_string("a")[2:], bytes(9)]
)
def test_what_is_no_string_is_an_error(data):
    with pytest.raises(ValueError, match="no serialized std_msgs/msg/String"):
        decode_string(data)


def test_what_is_no_utf8_is_an_error():
    with pytest.raises(ValueError, match="no UTF-8 text"):
        decode_string(encode_string("ab").replace(b"a", b"\xff"))


def rows_of(run_id, count):
    rows = np.zeros(count, MESSAGE_ROW)
    rows["run_id"], rows["sequence"], rows["repeats"] = run_id, np.arange(count), 3
    return rows


def test_a_record_has_61_bytes_without_padding():
    assert MESSAGE_ROW.itemsize == 61
    run_and_sequence = "0100000000000000" * 2
    assert rows_of(1, 2)[1].tobytes().hex() == run_and_sequence + "00" * 13 + "0300" + "00" * 30


def test_texts_hold_one_run_each_and_give_every_record_back():
    rows = np.concatenate([rows_of(0x11, 8193), rows_of(0x22, 1)])
    texts = list(row_texts(rows))
    assert [(text["run_id"], text["messages"]) for text in texts] == [
        ("0000000000000011", 8192),
        ("0000000000000011", 1),
        ("0000000000000022", 1),
    ]
    assert np.concatenate([rows_of_text(text) for text in texts]).tobytes() == rows.tobytes()


@pytest.mark.parametrize("rows", [None, 7, "", "no base64!", "AAAA", "ä"])
def test_a_text_with_counts_alone_or_damaged_records_has_no_record(rows):
    assert len(rows_of_text({"run_id": "0000000000000011", "rows": rows})) == 0
