from __future__ import annotations

import struct

import pytest
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Header, Schema, Statistics

from dds_trace.tracefile.mcapfile.records import OPCODES, parse_record, record_name

CHANNEL = Channel(id=3, topic="/t", message_encoding="cdr", metadata={"a": "b"}, schema_id=1)


def content_of(record):
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()[9:]


def test_a_record_is_parsed_and_what_lies_behind_it_ignored():
    assert parse_record(Channel, content_of(CHANNEL)) == CHANNEL
    assert parse_record(Channel, memoryview(content_of(CHANNEL) + b"later")) == CHANNEL


def test_a_record_that_is_cut_off_anywhere_is_an_error():
    content = content_of(CHANNEL)
    for size in range(len(content)):
        with pytest.raises(ValueError, match="reaches beyond its record"):
            parse_record(Channel, content[:size])


def test_a_text_that_is_no_utf8_is_an_error():
    content = content_of(Schema(id=1, name="ab", encoding="", data=b""))
    with pytest.raises(ValueError, match="utf-8"):
        parse_record(Schema, content.replace(b"ab", b"a\xff"))


@pytest.mark.parametrize("kind", [Channel, ChunkIndex, Statistics])
def test_a_map_that_no_file_needs_is_an_error(kind):
    with pytest.raises(ValueError, match="it has 2097153 bytes"):
        parse_record(kind, bytes((2 << 20) + 1))


def test_a_length_of_four_gigabytes_takes_no_memory():
    with pytest.raises(ValueError, match="4294967295 bytes reaches beyond"):
        parse_record(Header, struct.pack("<I", 2**32 - 1))


def test_names_are_those_of_the_specification():
    assert {record_name(opcode) for opcode in OPCODES.values()} == {kind.__name__ for kind in OPCODES}
    assert record_name(Opcode.MESSAGE_INDEX) == "MessageIndex"
    assert record_name(0x80) == "unknown (opcode 0x80)"
