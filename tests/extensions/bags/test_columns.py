"""Columns of a recording against the messages that python mcap reads one by one."""

import random
import struct
import tracemalloc
from cProfile import Profile
from io import BytesIO
from pathlib import Path
from pstats import Stats
from tempfile import TemporaryDirectory

import pytest
from bags import imu, text, write_bag1, write_bag2
from hypothesis import given
from hypothesis import strategies as st
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import StoragePlugin

from dds_trace.extensions.bags.message_stamps import stamps_of
from dds_trace.extensions.bags.messages import MessageColumns, count_copies
from dds_trace.extensions.bags.read import read_batches, read_messages
from dds_trace.extensions.bags.recorded import NONE, Condition
from dds_trace.tracefile.mcapfile.records import topic_of

START_NS = 1_790_000_000 * 10**9
SCHEMAS = {
    "cdr": ("a/msg/Stamped", "ros2msg", b"std_msgs/Header header\nuint8[] data\n"),
    "cdr later": ("a/msg/Later", "ros2msg", b"float64 x\nstd_msgs/Header[] headers\n"),
    "cdr none": ("a/msg/None", "ros2msg", b"float64 x\n"),
    "cdr variable": ("a/msg/Variable", "ros2msg", b"string name\nstd_msgs/Header header\n"),
    "ros1": ("a/Stamped", "ros1msg", b"Header header\nuint8[] data\n"),
    "json": ("X", "jsonschema", b"{}"),
}


def content(kind, rng):
    seconds, frame = (
        rng.choice([0, 1_790_000_000, 2**31 - 1]),
        rng.choice([b"", b"cam\0", b"a_long_frame\0", b"x" * 300]),
    )
    stamp = struct.pack("<II", seconds, rng.randrange(10**9))
    header = stamp + struct.pack("<I", len(frame)) + frame
    data = {
        "cdr": b"\0\1\0\0" + header,
        "cdr later": b"\0\1\0\0" + bytes(8) + struct.pack("<I", rng.choice([0, 1, 2])) + header,
        "cdr none": b"\0\1\0\0" + bytes(8),
        "cdr variable": b"\0\1\0\0" + struct.pack("<I", 4) + b"abc\0" + header,
        "ros1": struct.pack("<I", rng.randrange(100)) + header,
        "json": b'{"stamp": {"sec": %d, "nanosec": 5}}' % seconds,
    }[kind]
    data += rng.choice([b"", bytes(range(40)), struct.pack("<BQ", 5, 30) + bytes(40)])
    return rng.choice([data, data, data, data[: rng.randrange(len(data) + 1)], b"\0\0" + data[2:]])


def write(path, rng, count, **options):
    writer = Writer(str(path), **options)
    writer.start("", "made")
    channels = []
    for kind, schema in SCHEMAS.items():
        schema_id = writer.register_schema(*schema)
        channels += [(kind, writer.register_channel(f"/{kind}/{n}", kind.split()[0], schema_id)) for n in range(2)]
    for number in range(count):
        kind, channel = rng.choice(channels)
        log_ns = START_NS + number * 1000 + rng.choice([0, 0, -5000])
        times = rng.choice([log_ns, 2**64 - 1]) if not rng.randrange(20) else log_ns, rng.choice([0, log_ns - 7])
        for _ in range(rng.choice([1, 1, 1, 1, 2])):
            writer.add_message(channel, times[0], content(kind, rng), times[1], number)
    writer.finish()


def by_message(path):
    schemas, channels, topics = {0: None}, {}, {}
    for record in StreamReader(BytesIO(path.read_bytes())).records:
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            topic = topic_of(channels[record.channel_id], schemas)
            stamps, data = stamps_of(topic), record.data
            has_header, is_ros1 = stamps is not None and stamps.has_header, topic.encoding == "ros1"
            frame_bytes = int.from_bytes(data[12:16], "little")
            number = int.from_bytes(data[:4], "little") if has_header and len(data) >= 4 else NONE
            row = {
                "log_ns": min(record.log_time, 2**63 - 1),
                "publish_ns": record.publish_time if record.publish_time < 2**63 else NONE,
                "stamp_ns": (stamps and stamps.read(data)) or NONE,
                "payload_bytes": len(data),
                "sequence": number if is_ros1 else record.sequence,
                "frame": data[16 : 16 + frame_bytes] if has_header and frame_bytes < 256 else b"",
                "content": data,
            }
            topics.setdefault(topic.name, []).append(row)
    return topics


def columns_of(path):
    messages = MessageColumns()
    for batch in read_batches(path, Condition()):
        messages.add(batch)
    columns = messages.by_topic()
    count_copies(columns, lambda: read_batches(path, Condition()))
    return {topic.topic.name: topic for topic in columns}


def assert_same_columns(path):
    expected, found = by_message(path), columns_of(path)
    assert {name: len(topic) for name, topic in found.items()} == {name: len(rows) for name, rows in expected.items()}
    for name, rows in expected.items():
        for column in ("log_ns", "publish_ns", "stamp_ns", "payload_bytes", "sequence"):
            assert found[name].column(column).tolist() == [row[column] for row in rows], (name, column)
        frames = {frame: {*()} for frame in found[name].column("frame").tolist()}
        for frame, row in zip(found[name].column("frame").tolist(), rows, strict=True):
            frames[frame].add(row["frame"])
        assert {len(texts) for texts in frames.values()} == {1}
        assert len(frames) == len({row["frame"] for row in rows})
        assert found[name].copies == len(rows) - len({(row["log_ns"], row["content"]) for row in rows})
    numbers = sorted(number for topic in found.values() for number in topic.column("number").tolist())
    assert numbers == list(range(len(numbers)))


@given(
    seed=st.integers(0, 10**6),
    count=st.integers(0, 300),
    chunk_size=st.sampled_from([1, 200, 5000, 1 << 20]),
    compression=st.sampled_from(CompressionType),
    index_types=st.sampled_from([IndexType.ALL, IndexType.NONE]),
    use_chunking=st.booleans(),
    enable_crcs=st.booleans(),
)
def test_columns_are_those_of_single_messages(seed, count, **options):
    with TemporaryDirectory() as folder:
        path = Path(folder) / "x.mcap"
        write(path, random.Random(seed), count, **options)
        assert_same_columns(path)
        messages = [(message.topic.name, message.data) for message in read_messages(path, Condition())]
        expected = by_message(path)
        for name, rows in expected.items():
            assert [data for topic, data in messages if topic == name] == [row["content"] for row in rows]


@given(seed=st.integers(0, 10**6), damages=st.integers(1, 5))
def test_a_wrong_index_costs_no_message(seed, damages):
    rng = random.Random(seed)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "x.mcap"
        write(path, rng, 200, chunk_size=3000)
        expected, data = by_message(path), bytearray(path.read_bytes())
        indexes, at = [], 8
        while at < len(data) - 8:
            opcode, length = struct.unpack_from("<BQ", data, at)
            indexes += [at + 15 + 16 * n + 8 for n in range((length - 6) // 16)] if opcode == 7 else []
            at += 9 + length
        for place in rng.sample(indexes, damages):
            struct.pack_into("<q", data, place, rng.choice([0, -1, 2**62, 3000, rng.randrange(4000)]))
        path.write_bytes(data)
        condition = Condition()
        found = [(message.topic.name, message.data) for message in read_messages(path, condition)]
        assert sorted(found) == sorted((name, row["content"]) for name, rows in expected.items() for row in rows)
        assert not [damage for damage in condition.damages if "2262" not in damage]


@pytest.mark.parametrize("make", ["bag", *StoragePlugin])
def test_every_storage_gives_the_same_columns(tmp_path, make):
    messages = {"/imu": [imu(n / 10) for n in range(30)], "/chatter": [text("x" * n) for n in range(30)]}
    if make == "bag":
        path = write_bag1(tmp_path / "x.bag", {name: [*map(to_ros1, many)] for name, many in messages.items()})
    else:
        path = write_bag2(tmp_path / "x", messages, make)
    found = columns_of(path)
    assert found["/imu"].column("stamp_ns").tolist() == [1_700_000_000_000_000_006] * 30
    assert len({*found["/imu"].column("frame").tolist()}) == 1
    sizes = found["/chatter"].column("payload_bytes")
    assert (sizes[1:] - sizes[:-1]).tolist() == [1] * 29
    assert found["/chatter"].column("stamp_ns").tolist() == [NONE] * 30


def to_ros1(message):
    from bags import ROS1

    if hasattr(message, "data"):
        return text(message.data, ROS1)
    return imu(message.orientation.z, ROS1)


def make_large(path, count):
    writer = Writer(str(path))
    writer.start("", "made")
    channel = writer.register_channel("/a", "cdr", writer.register_schema(*SCHEMAS["cdr"]))
    other = writer.register_channel("/b", "cdr", writer.register_schema(*SCHEMAS["cdr none"]))
    for number in range(count):
        stamp = struct.pack("<iI", 1_790_000_000 + number // 1000, number % 1000 * 10**6)
        log_ns = START_NS + number * 10**6 + number % 7 * 1000
        writer.add_message(
            other if number % 5 == 0 else channel, log_ns, b"\0\1\0\0" + stamp + bytes(80), log_ns, number
        )
    writer.finish()
    return path


def test_a_message_costs_bytes_and_no_calls(tmp_path):
    paths = {count: make_large(tmp_path / f"{count}.mcap", count) for count in (60_000, 160_000)}
    columns_of(paths[160_000])  # the memory of a block stays
    peaks, calls = [], []
    for path in paths.values():
        tracemalloc.start()
        columns_of(path)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        profile = Profile()
        profile.runcall(columns_of, path)
        calls.append(Stats(profile).total_calls)
    assert (peaks[1] - peaks[0]) / 100_000 < 80
    assert (calls[1] - calls[0]) / 100_000 < 0.2
