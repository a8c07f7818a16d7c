"""Files made to keep a reader busy: they end at a bound of work, not of time, and what was read before is kept."""

import os
import sqlite3
import struct
import sys
from contextlib import closing

import pytest
import zstandard
from trace_files import TWELVE, write_pair

from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.errors import TraceFormatError
from dds_trace.base.files import open_regular
from dds_trace.extensions.bags import sqlite_rows
from dds_trace.tracefile.mcapfile.file import RecordFile
from dds_trace.tracefile.reading import mcap_source, source
from dds_trace.tracefile.reading.reader import read_trace


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
    return write_pair(tmp_path / "whole", TWELVE)[0]


@pytest.fixture
def hostile(whole, tmp_path):
    def make(data):
        path = tmp_path / "hostile.mcap"
        content = whole.read_bytes()
        path.write_bytes(content[: content.rindex(record(15, bytes(4))[:9])] + data)  # DATA_END
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
    analysis = analyze(whole.parent)
    assert analysis.summary["published"].to_list() == [12]
    if path.suffix == ".ring":
        assert any("its ring is not used" in note for note in read_trace(whole).notes)
    else:
        with pytest.raises(TraceFormatError, match="not a regular file"):
            read_trace(path)


@pytest.mark.parametrize("path", ["/dev/zero", "/dev/null"])
def test_a_device_is_no_regular_file(path, tmp_path):
    (tmp_path / "x").symlink_to(path)
    with pytest.raises(OSError, match="not a regular file"):
        open_regular(tmp_path / "x")
    with pytest.raises(OSError):  # noqa: PT011 - ELOOP, in whatever words
        open_regular(tmp_path / "x", follow_links=False)


EVENT_TOPIC = "(1, '/dds_trace/t1', 'dds_trace_msgs/msg/TraceEvent', 'cdr')"
TOPICS = "CREATE TABLE topics (id INTEGER PRIMARY KEY, name, type, serialization_format)"
MESSAGES = "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, data BLOB)"


@pytest.fixture
def database(tmp_path):
    def make(*statements):
        (tmp_path / "metadata.yaml").write_text("")
        with closing(sqlite3.connect(tmp_path / "bag_0.db3")) as connection, connection:
            for statement in statements:
                connection.execute(statement)
        return tmp_path

    return make


def rows(count):
    event = "00010000" + 56 * "00"
    return (
        f"WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < {count}) "
        f"INSERT INTO messages (topic_id, timestamp, data) SELECT 1, i, x'{event}' FROM n"
    )


@pytest.mark.parametrize(
    ("module", "name", "value"),
    [
        (source, "_UNSUSPECTED_MESSAGES", -(10**9)),
        (sqlite_rows, "_UNSUSPECTED_STEPS", -(10**9)),
        (sqlite_rows, "MOST_TOPICS", 0),
    ],
)
def test_work_on_a_database_is_bounded(database, monkeypatch, module, name, value):
    path = database(TOPICS, MESSAGES, f"INSERT INTO topics VALUES {EVENT_TOPIC}", rows(1000))
    assert read_trace(path).event_count == 1000
    monkeypatch.setattr(module, name, value)
    monkeypatch.setattr(sqlite_rows, "_STEPS_A_CHECK", 100)
    try:
        trace = read_trace(path)
    except TraceFormatError as err:
        assert "not a rosbag2 database" in str(err)  # noqa: PT017 - its first queries are over the bound already
    else:
        assert "ends early" in trace.truncated
        assert trace.event_count < 100 or "from single pages" in trace.truncated


@pytest.mark.parametrize(
    "computed",
    [
        "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, data AS (hex(zeroblob(400000000))))",
        "CREATE VIEW messages AS SELECT 1 AS id, 1 AS topic_id, 1 AS timestamp, zeroblob(900000000) AS data",
    ],
    ids=["column", "view"],
)
def test_what_a_database_computes_is_not_read(database, computed):
    path = database(TOPICS, f"INSERT INTO topics VALUES {EVENT_TOPIC}", computed)
    with pytest.raises(TraceFormatError, match="as it makes them"):
        read_trace(path)


@pytest.mark.skipif(sys.version_info < (3, 11), reason="Python 3.10 cannot bound the length of SQLite's values")
def test_a_name_of_many_megabytes_is_not_held(database):
    path = database(TOPICS, MESSAGES, f"INSERT INTO topics VALUES {EVENT_TOPIC}", rows(10))
    with closing(sqlite3.connect(path / "bag_0.db3")) as connection, connection:
        connection.execute("INSERT INTO topics VALUES (2, CAST(zeroblob(20000000) AS TEXT), 'x', 'cdr')")
    trace = read_trace(path)
    assert "too big" in trace.truncated
    assert trace.event_count == 10  # of the topic on its page
