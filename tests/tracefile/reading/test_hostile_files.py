"""Files made to keep a reader busy: they end at a bound of work, not of time, and what was read before is kept."""

from __future__ import annotations

import os
import struct

import pytest
import zstandard
from trace_files import Message, write_pair

from dds_trace.analyzer import analyze
from dds_trace.tracefile import TraceFormatError, read_trace
from dds_trace.tracefile.files import open_regular
from dds_trace.tracefile.mcapfile import blocks
from dds_trace.tracefile.mcapfile.file import RecordFile
from dds_trace.tracefile.reading import mcap_source

MAGIC = b"\x89MCAP0\r\n"
TIMELINE = [Message(s, t0=1000 * s, t1=1000 * s + 5, t3=900, t4=930, t2=1000 * s + 205) for s in range(12)]


def record(opcode, content=b""):
    return struct.pack("<BQ", opcode, len(content)) + content


def chunk(data, compression=b""):
    packed = zstandard.ZstdCompressor().compress(data) if compression else data
    head = struct.pack("<QQQII", 0, 0, len(data), 0, len(compression)) + compression
    return record(6, head + struct.pack("<Q", len(packed)) + packed)


UNKNOWN = record(0x80)
MESSAGE = record(5, struct.pack("<HIQQ", 9, 0, 0, 0))


@pytest.fixture
def whole(tmp_path):
    """A trace of ours; hostile records are put between its last one and its end."""
    return write_pair(tmp_path / "whole", TIMELINE)[0]


@pytest.fixture
def hostile(whole, tmp_path):
    def make(data):
        path = tmp_path / "hostile.mcap"
        content = whole.read_bytes()
        with RecordFile(whole) as file:
            end = file.header_at(len(MAGIC), {15}).offset  # DATA_END
        path.write_bytes(content[:end] + data)
        return path

    return make


@pytest.mark.parametrize(
    "data",
    [
        pytest.param(chunk(b"") * 30_000, id="empty chunks"),
        pytest.param(chunk(UNKNOWN) * 3_000, id="chunks of one record"),
        pytest.param(chunk(MESSAGE, b"zstd") * 1_000, id="packed chunks of one message"),
        pytest.param(UNKNOWN * 50_000, id="unknown records"),
        pytest.param(MESSAGE * 3_000, id="messages outside of chunks"),
        pytest.param((MESSAGE + UNKNOWN) * 1_000, id="messages and unknown records in turn"),
        pytest.param((MESSAGE + chunk(UNKNOWN)) * 1_000, id="messages and chunks in turn"),
        pytest.param(chunk(UNKNOWN * 50_000, b"zstd"), id="bomb of small records"),
    ],
)
def test_work_is_bounded_and_what_came_before_is_kept(whole, hostile, data, monkeypatch):
    path = hostile(data)
    everything = read_trace(path)
    assert everything.truncated.startswith("ends early")
    monkeypatch.setattr(mcap_source, "_UNSUSPECTED_STEPS", 1000)
    monkeypatch.setattr(mcap_source, "_STEP_BYTES", 1 << 40)
    found = read_trace(path)
    expected = read_trace(whole)
    for stage, columns in expected.events.items():
        assert found.events[stage].sequence.tolist() == columns.sequence.tolist()
        assert everything.events[stage].sequence.tolist() == columns.sequence.tolist()
    stepped_over = data in (chunk(b"") * 30_000, UNKNOWN * 50_000)  # in the walk over the file's own bytes
    assert ("small records" in found.truncated) is not stepped_over


def test_a_file_of_small_bombs_is_not_unpacked_whole(hostile, monkeypatch):
    monkeypatch.setattr(blocks, "_UNSUSPECTED_FILE_BYTES", 0)
    bomb = chunk(record(5, struct.pack("<HIQQ", 9, 0, 0, 0) + bytes(1_000_000)), b"zstd")
    found = read_trace(hostile(bomb * 200))
    left_out = [note for note in found.notes if "unpacks to more than 200 times" in note]
    assert left_out
    assert any("more notes like these" in note for note in found.notes)


def test_few_bytes_are_read_for_records_outside_of_chunks(hostile, monkeypatch):
    """Reading two megabytes for each of them took time with the square of their number."""
    path, read = hostile((MESSAGE + UNKNOWN) * 1_000), []
    plain = RecordFile.read
    monkeypatch.setattr(RecordFile, "read", lambda file, at, size: read.append(size) or plain(file, at, size))
    read_trace(path)
    assert sum(read) < 200 * path.stat().st_size


@pytest.mark.parametrize("name", ["ping.mcap.ring", "x.mcap"])
def test_a_pipe_is_not_waited_for(whole, name):
    path = whole.parent / name
    if name.startswith("ping"):
        path = whole.with_name(whole.name + ".ring")
    os.mkfifo(path)
    analysis = analyze(whole.parent, cache=True)
    assert analysis.summary["published"].to_list() == [12]
    if path.suffix == ".ring":
        assert any("ring beside it is not used" in note for note in read_trace(whole).notes)
    else:
        with pytest.raises(TraceFormatError, match="no regular file"):
            read_trace(path)


@pytest.mark.parametrize("path", ["/dev/zero", "/dev/null"])
def test_a_device_is_no_regular_file(path, tmp_path):
    (tmp_path / "x").symlink_to(path)
    with pytest.raises(OSError, match="no regular file"):
        open_regular(tmp_path / "x")
    with pytest.raises(OSError):  # noqa: PT011 - ELOOP, in whatever words
        open_regular(tmp_path / "x", follow_links=False)
