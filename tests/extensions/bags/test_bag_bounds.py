import bz2
import random
import re
import struct
from contextlib import suppress

import pytest
from bags import ROS1, ROS2, chunk, record, text, write_bag1, write_bag2
from rosbags.rosbag1 import Writer
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from dds_trace.base.errors import MissingEventsError, OptionError, TraceFormatError
from dds_trace.extensions.bags import analyze as topics
from dds_trace.extensions.bags import bag1, read, sqlite_rows
from dds_trace.extensions.bags import payload as bag
from dds_trace.extensions.bags.analyze import analyze_topics
from dds_trace.extensions.bags.payload import load_payload
from dds_trace.extensions.bags.read import read_messages
from dds_trace.extensions.bags.recorded import Condition
from dds_trace.recorder.payloads import STRING
from dds_trace.tracefile.mcapfile import blocks, chunks
from dds_trace.tracefile.mcapfile.file import RecordFile
from dds_trace.tracefile.reading.source import UnreadableError

KB = 1000
TYPE = "std_msgs/msg/String"


BAGS = {
    "ros1-bz2.bag": (write_bag1, ROS1, {"compression": Writer.CompressionFormat.BZ2}),
    "ros1-lz4.bag": (write_bag1, ROS1, {"compression": Writer.CompressionFormat.LZ4}),
    "ros2-files": (write_bag2, ROS2, {"plugin": StoragePlugin.SQLITE3, "mode": CompressionMode.FILE}),
    "ros2-messages": (write_bag2, ROS2, {"plugin": StoragePlugin.SQLITE3, "mode": CompressionMode.MESSAGE}),
}


@pytest.fixture(params=BAGS)
def write_bag(request, tmp_path):
    write, store, packed = BAGS[request.param]

    def written(*sizes_bytes):
        return write(tmp_path / request.param, {"/zeros": [text("0" * size, store) for size in sizes_bytes]}, **packed)

    return written


def test_an_honest_packed_bag_is_read_as_before(write_bag):
    path = write_bag(10 * KB, 200 * KB, 0)
    longest, *_, shortest = sorted((len(message.data) for message in read_messages(path, Condition())), reverse=True)
    assert 200 * KB <= longest < 201 * KB
    assert shortest < KB
    payload = load_payload(f"{path}#/zeros", {TYPE: STRING})
    assert len(payload.messages) == 3


def test_a_bag_that_unpacks_to_more_than_the_bound_ends_in_one_line(write_bag, monkeypatch):
    path = write_bag(*[900 * KB] * 8)
    monkeypatch.setattr(blocks, "_UNSUSPECTED_FILE_BYTES", 5000 * KB)
    words = f"unpacks to more than {50 if 'bz2' in path.name else 200} times its size"
    with pytest.raises(TraceFormatError, match=words):
        list(read_messages(path, Condition()))
    with pytest.raises(OptionError, match=words):
        load_payload(f"{path}#/zeros", {TYPE: STRING})


@pytest.mark.parametrize(
    "write_bag", sorted(BAGS.keys() - {"ros2-files"}), indirect=True
)  # unpacked by stretches, onto the disk
def test_no_piece_is_unpacked_beyond_a_record(write_bag, monkeypatch):
    path = write_bag(900 * KB)
    for module in (bag1, chunks, read):
        monkeypatch.setattr(module, "MAX_RECORD_BYTES", 800 * KB)
    condition = Condition()
    with suppress(TraceFormatError):
        assert not list(read_messages(path, condition))
    assert re.search(r"unpacks to more than|it claims", f"{condition.damages}") or path.name == "ros2-messages"


CONNECTION = record(
    record(topic=b"/t", type=b"std_msgs/String")[4:-4], op=b"\7", conn=bytes(4), topic=b"/t"
)  # its data are fields as in a header
MESSAGE = record(b"\0\0\0\0", op=b"\2", conn=bytes(4), time=bytes(8))


@pytest.mark.parametrize("depth", [1, 2, 1000])
def test_a_chunk_in_a_chunk_is_damage(tmp_path, depth):
    inner, condition = MESSAGE, Condition()
    for _ in range(depth):
        inner = chunk(inner)
    (tmp_path / "x.bag").write_bytes(bag1.BAG1_MAGIC + CONNECTION + chunk(MESSAGE) + inner + chunk(MESSAGE))
    assert len(list(read_messages(tmp_path / "x.bag", condition))) == 3
    assert [("in a chunk" in damage) for damage in condition.damages] == [True] * (depth > 1)


PIECES = [
    *(struct.pack("<I", value) for value in (0, 4, 8, 13, 16, 44, 60, 255, 40_000)),
    *(b"op=\2", b"op=\5", b"op=\7", b"conn=abcd", b"time=abcdefgh", b"compression=none", b"compression=zstd"),
    *(b"size=\20\0\0\0", b"a=", b"\0", b"\4\0\0\0op=\2", b"\4\0\0\0op=\5\20\0\0\0compression=zstd"),
    *(MESSAGE[:-4], MESSAGE, CONNECTION, chunk(MESSAGE), chunk(MESSAGE)[:-10]),
]


@pytest.mark.parametrize("seed", range(40))
def test_reading_on_after_damage_is_linear(tmp_path, seed, monkeypatch):
    """Of any pattern: twice the bytes cost twice the tries and twice the bytes read, and few of both for each byte."""
    draw = random.Random(seed)
    pattern = b"".join(draw.choices(PIECES, k=draw.randrange(1, 7)))
    tries, read_bytes = [], []
    record_at, read_file = bag1._Bag1Walk._record_at, RecordFile.read
    monkeypatch.setattr(bag1._Bag1Walk, "_record_at", lambda *a: tries.append(1) or record_at(*a))
    monkeypatch.setattr(RecordFile, "read", lambda file, at, size: read_bytes.append(size) or read_file(file, at, size))
    costs = []
    for size in (20 * KB, 40 * KB):
        (tmp_path / "x.bag").write_bytes(bag1.BAG1_MAGIC + MESSAGE + pattern * (size // len(pattern)))
        with suppress(TraceFormatError):
            list(read_messages(tmp_path / "x.bag", Condition()))
        costs.append((len(tries), sum(read_bytes)))
        tries.clear(), read_bytes.clear()
    assert costs[1][0] < 2.5 * costs[0][0] + 100
    assert costs[1][1] < 2.5 * costs[0][1] + 100 * KB
    assert costs[1][0] < 40 * KB
    assert costs[1][1] < 400 * 40 * KB  # a few pieces of 4 KB for each record


def drawn_bag(draw):
    """Messages with fields in any order, contents that look like records, packed or not, with damages, perhaps cut off."""
    data = bytearray(bag1.BAG1_MAGIC + CONNECTION * draw.randrange(2))
    for _ in range(draw.randrange(1, 6)):
        order = draw.choice([["op", "conn", "time"], draw.sample(["op", "conn", "time", "seq"], draw.randrange(3, 5))])
        records = [CONNECTION] * draw.randrange(2)
        for number in range(draw.randrange(30)):
            conn, time = bytes([draw.choice([0, 0, 1]), 0, 0, 0]), struct.pack("<II", number, draw.randrange(9))
            fields = {"op": b"\2", "conn": conn, "time": time, "seq": b"\1\2"}
            content = draw.choice([bytes(draw.randrange(99)), MESSAGE, MESSAGE[:-4], chunk(MESSAGE)])
            records += [draw.choice(PIECES)] * (draw.random() < 0.05)
            records.append(record(content, **{name: fields[name] for name in order}))
        inner = b"".join(records)
        packed = {"op": b"\5", "compression": b"bz2", "size": struct.pack("<I", len(inner))}
        data += draw.choice([chunk(inner), record(bz2.compress(inner), **packed), inner])
    for _ in range(draw.choice([0, 0, 1, 5])):
        data[draw.randrange(13, len(data))] = draw.randrange(256)
    return bytes(data[: draw.choice([len(data), draw.randrange(14, len(data) + 1)])])


@pytest.mark.parametrize("seed", range(150))
def test_messages_read_together_are_those_of_a_walk_one_by_one(tmp_path, seed, monkeypatch):
    (tmp_path / "x.bag").write_bytes(drawn_bag(random.Random(seed)))
    found = []
    for with_alike in (bag1._with_alike, lambda _data, alone: alone):
        monkeypatch.setattr(bag1, "_with_alike", with_alike)
        found.append(([], Condition()))
        with suppress(UnreadableError):
            found[-1][0].extend(bag1.bag1_messages(tmp_path / "x.bag", found[-1][1]))
    assert found[0] == found[1]


@pytest.mark.parametrize("kind", ["mcap", "db3", "bag"])
def test_more_topics_than_any_robot_has_are_refused_in_one_line(tmp_path, kind, monkeypatch):
    write, store = (write_bag1, ROS1) if kind == "bag" else (write_bag2, ROS2)
    plugin = {"db3": {"plugin": StoragePlugin.SQLITE3}, "mcap": {"plugin": StoragePlugin.MCAP}}.get(kind, {})
    path = write(tmp_path / f"x.{kind}", {f"/t{number}": [text("x", store)] for number in range(4)}, **plugin)
    assert len(analyze_topics(path).topics) == 4
    for module in (topics, sqlite_rows):
        monkeypatch.setattr(module, "MOST_TOPICS", 3)
    with pytest.raises(MissingEventsError, match="topics") as caught:
        analyze_topics(path)
    assert "\n" not in str(caught.value)


def test_a_misspelled_topic_among_many_long_ones_is_answered(tmp_path, monkeypatch):
    """Comparing takes time with the square of a name's length: few names are compared, and of each the beginning."""
    names = [f"/t{number}_{'x' * 2000}" for number in range(300)] + ["/chatter"]
    path = write_bag2(tmp_path / "x", {name: [text("x")] for name in names})
    compared = []
    monkeypatch.setattr(
        bag, "get_close_matches", lambda word, names, *_: compared.extend([word, *names]) or [*names][:1]
    )
    with pytest.raises(OptionError, match="/chatter"):
        load_payload(f"{path}#/chater", {TYPE: STRING})
    assert len(compared) <= 101
    assert max(map(len, compared)) <= 200
