import json
import struct
import tarfile
from operator import itemgetter
from pathlib import Path

import pytest
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Schema, Statistics

import dds_trace.tracefile.mcapfile.records
from dds_trace.base.errors import TraceFormatError
from dds_trace.tracefile.format.encoding import MESSAGE_HEADER
from dds_trace.tracefile.format.events import EVENT_SCHEMA_NAME, Stage, event_fault
from dds_trace.tracefile.mcapfile.file import RecordFile, read_summary
from dds_trace.tracefile.mcapfile.records import ChannelTable, parse_record, record_name
from dds_trace.tracefile.mcapfile.scan import MESSAGES_AND_CHANNELS, lengths_at
from dds_trace.tracefile.reading.mcap_walk import McapWalk

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


@pytest.mark.parametrize("kind", [Channel, Statistics])
def test_a_map_that_no_file_needs_is_an_error(kind):
    with pytest.raises(ValueError, match="it has 2,097,153 bytes"):
        parse_record(kind, bytes((2 << 20) + 1))


def test_a_length_of_four_gigabytes_takes_no_memory():
    with pytest.raises(ValueError, match="4,294,967,295 bytes reaches beyond"):
        parse_record(Header, struct.pack("<I", 2**32 - 1))


def test_names_are_those_of_the_specification():
    assert [record_name(opcode) for opcode in KINDS] == [kind.__name__ for kind in KINDS.values()]
    assert record_name(Opcode.MESSAGE_INDEX) == "MessageIndex"
    assert record_name(0x80) == "unknown (opcode 0x80)"


def channel(topic="/dds_trace/t1", schema_id=7):
    return content_of(Channel(3, topic, "cdr", {}, schema_id))


def schema(name=EVENT_SCHEMA_NAME):
    return content_of(Schema(7, b"", "ros2msg", name))


@pytest.fixture
def parsed(monkeypatch):
    contents = []

    def parse(kind, content):
        contents.append(bytes(content))
        return parse_record(kind, content)

    monkeypatch.setattr(dds_trace.tracefile.mcapfile.records, "parse_record", parse)
    dds_trace.tracefile.mcapfile.records._parsed_once.cache_clear()
    return contents


def declared(*records):
    table = ChannelTable(Path("ping.mcap"))
    for opcode, content in records:
        table.declare(opcode, memoryview(content), 0)
    return table


def test_what_files_declare_alike_is_parsed_once(parsed):
    for _ in range(3):
        table = declared((Opcode.SCHEMA, schema()), (Opcode.CHANNEL, channel()), (Opcode.CHANNEL, channel()))
        assert table.get(3).stage is Stage.T1
        assert table.get(3).fault is None
    assert parsed == [schema(), channel()]


def test_files_that_declare_an_id_differently_have_each_their_own(parsed):
    ours = declared((Opcode.SCHEMA, schema()), (Opcode.CHANNEL, channel()))
    other = declared((Opcode.SCHEMA, schema("x/Y")), (Opcode.CHANNEL, channel()))
    assert ours.get(3).fault is None
    assert other.get(3).fault == f"its schema is 'x/Y', not {EVENT_SCHEMA_NAME!r}"
    assert len(parsed) == 3


@pytest.mark.parametrize("stage", Stage)
def test_events_have_the_schema_of_their_stage_or_a_lost_one(stage):
    assert event_fault(stage, "cdr", stage.schema_name) is event_fault(stage, "cdr", None) is None
    others = {other.schema_name for other in Stage} - {stage.schema_name}
    assert [name in event_fault(stage, "cdr", name) for name in sorted(others)] == [True] * len(others) == [True]


def test_a_damaged_record_is_an_error_in_every_file(parsed):
    for _ in range(2):
        with pytest.raises(TraceFormatError, match="a Channel record is damaged"):
            declared((Opcode.CHANNEL, channel()[:-1]))
    assert len(parsed) == 2


def test_a_long_record_is_not_kept(parsed):
    long = channel("/camera" + 4096 * "a")
    for _ in range(2):
        assert declared((Opcode.CHANNEL, long)).get(3).stage is None
    assert parsed == [long, long]


def test_topics_of_others_may_share_an_id_and_ours_may_not():
    table = declared((Opcode.CHANNEL, channel("/a")), (Opcode.CHANNEL, channel("/b")))
    assert table.get(3).topic == "/a"
    with pytest.raises(TraceFormatError, match="distinguished"):
        declared((Opcode.CHANNEL, channel("/a")), (Opcode.CHANNEL, channel()))


SUITE = Path(__file__).parents[2] / "data" / "mcap-conformance.tar.xz"
KINDS = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel, Opcode.STATISTICS: Statistics}
IN_DATA = {"Schema", "Channel", "Message"}
IN_SUMMARY = {kind.__name__ for kind in KINDS.values()}

Listed = tuple[str, dict[str, object]]


@pytest.fixture(scope="module")
def suite(tmp_path_factory):
    folder = tmp_path_factory.mktemp("conformance")
    with tarfile.open(SUITE) as archive:
        for member in archive.getmembers():
            if member.isfile():
                (folder / Path(member.name).name).write_bytes(archive.extractfile(member).read())
    return folder


def test_every_file_of_the_suite_holds_the_records_it_must(suite):
    files = sorted(suite.glob("*.mcap"))
    assert len(files) == 416
    wrong = [file.name for file in files if (in_data(file), in_summary(file)) != expected_of(file)]
    assert wrong == []


def test_the_suite_has_every_kind_of_record_that_the_reader_uses(suite):
    data, summary = zip(*(expected_of(file) for file in suite.glob("*.mcap")), strict=True)
    assert {kind for listed in data for kind, _ in listed} == IN_DATA
    assert {kind for listed in summary for kind, _ in listed} == IN_SUMMARY


def expected_of(file):
    records = json.loads(file.with_suffix(".json").read_text())["records"]
    listed = [(record["type"], dict(record["fields"])) for record in records]
    end = [kind for kind, _ in listed].index("DataEnd")
    return (
        [record for record in listed[:end] if record[0] in IN_DATA],
        [record for record in listed[end:] if record[0] in IN_SUMMARY],
    )


def in_data(path):
    with RecordFile(path) as file:
        walk, summary = McapWalk(file), read_summary(file)
        records = [record for block in walk for record in records_of(block, summary.data_end)]
    assert (walk.notes, walk.damages) == ([], [])
    return records


def records_of(block, end):
    starts = block.scan.message_starts()
    lengths = lengths_at(block.data, starts).tolist()
    messages = [(Opcode.MESSAGE, start + 9, length) for start, length in zip(starts.tolist(), lengths, strict=True)]
    for opcode, start, length in sorted(messages + block.scan.others, key=itemgetter(1)):
        content = bytes(block.data[start : start + length])
        if opcode == Opcode.MESSAGE:
            names = ("channel_id", "sequence", "log_time", "publish_time")
            fields = dict(zip(names, MESSAGE_HEADER.unpack_from(content), strict=True))
            yield "Message", as_listed({**fields, "data": content[MESSAGE_HEADER.size :]})
        elif opcode in MESSAGES_AND_CHANNELS and block.offset(start) < end:
            yield KINDS[opcode].__name__, as_listed(vars(parse_record(KINDS[opcode], content)))


def in_summary(path):
    with RecordFile(path) as file:
        summary = read_summary(file)
    return [
        (KINDS[opcode].__name__, as_listed(vars(parse_record(KINDS[opcode], summary.data[start : start + length]))))
        for opcode, start, length in summary.records
    ]


def as_listed(value):
    """A field as the suite writes it: numbers and bytes as text, so that no JSON parser rounds them."""
    if isinstance(value, int):
        return str(value)
    if isinstance(value, bytes):
        return [str(byte) for byte in value]
    if isinstance(value, dict):
        return {str(key): as_listed(held) for key, held in value.items()}
    return value
