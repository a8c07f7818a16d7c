"""MCAP's own conformance suite: 416 files, each with the records that a reader must find in it.

`tests/data/mcap-conformance.tar.xz` is the suite's data (MIT licence; its origin is noted inside). What the reader takes
from a file is compared: schemas, channels and messages of the data section, and the summary's records that it uses.
"""

import json
import tarfile
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Schema, Statistics

from dds_trace.tracefile.format.encoding import MESSAGE_HEADER
from dds_trace.tracefile.mcapfile.blocks import BlockJobs
from dds_trace.tracefile.mcapfile.file import RecordFile, read_summary
from dds_trace.tracefile.mcapfile.records import OPCODES, parse_record

SUITE = Path(__file__).parents[2] / "data" / "mcap-conformance.tar.xz"
KINDS = {OPCODES[kind]: kind for kind in (Schema, Channel, Statistics, ChunkIndex)}
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
        jobs = BlockJobs(file, read_summary(file))
        records = [record for _, job in jobs for record in records_of(job())]
    assert (jobs.notes, jobs.truncated) == ([], None)
    return records


def records_of(block):
    for opcode, start, length in block.scan.others:
        content = bytes(block.data[start : start + length])
        if opcode == Opcode.MESSAGE:
            names = ("channel_id", "sequence", "log_time", "publish_time")
            fields = dict(zip(names, MESSAGE_HEADER.unpack_from(content), strict=True))
            yield "Message", as_listed({**fields, "data": content[MESSAGE_HEADER.size :]})
        else:
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
