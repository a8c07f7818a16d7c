"""Topics of foreign recordings: the same timeline written as rosbag1, rosbag2 (both storages) and MCAP reads the same."""

import json
import struct

import pytest
import zstandard
from bags import ROS1, ROS2, imu, write_bag1, write_bag2
from card_bags import write_mcap
from mcap.writer import CompressionType
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.typesys import Stores, get_typestore

from dds_trace.base.errors import MissingEventsError, TraceFormatError
from dds_trace.extensions.bags.analyze import analyze_topics
from dds_trace.extensions.bags.messages import find_recordings
from dds_trace.extensions.bags.read import read_messages
from dds_trace.extensions.bags.recorded import Condition
from dds_trace.extensions.bags.report import BagReport
from dds_trace.reports.terminal import print_report
from dds_trace.tracefile.mcapfile import blocks
from dds_trace.tracefile.reading import source

MS = 1_000_000
START_NS = 1_700_000_000 * 10**9

# Logged at 0, 100, 200, 500, 600 ms: one gap (200 -> 500), median interval 100 ms. Stamped 5, 5, 7, 5, 9 ms before.
LOGGED_MS = (0, 100, 200, 500, 600)
AGE_MS = (5, 5, 7, 5, 9)


def imu_topic(store=ROS2):
    stamps_ns = [START_NS + (logged - age) * MS for logged, age in zip(LOGGED_MS, AGE_MS, strict=True)]
    return {"/imu": [imu(0, store, frame_id="imu", stamp_ns=stamp_ns) for stamp_ns in stamps_ns]}


LOGGED_NS = [START_NS + logged * MS for logged in LOGGED_MS]
WRITERS = {
    "rosbag1": ("a.bag", lambda p: write_bag1(p, imu_topic(ROS1), times_ns=LOGGED_NS)),
    **{
        f"rosbag2 {name}": ("a", lambda p, how=how: write_bag2(p, imu_topic(), *how, times_ns=LOGGED_NS))
        for name, how in {
            "sqlite3": (StoragePlugin.SQLITE3,),
            "mcap": (StoragePlugin.MCAP,),
            "compressed": (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
        }.items()
    },
}


@pytest.mark.parametrize("kind", WRITERS)
def test_one_timeline_in_every_format(tmp_path, kind):
    name, write = WRITERS[kind]
    write(tmp_path / name)
    report = analyze_topics(tmp_path)
    (row,) = report.topics.iter_rows(named=True)
    assert (row["topic"], row["message_type"]) == ("/imu", "sensor_msgs/msg/Imu")
    assert (row["messages"], row["start_ns"], row["duration_ns"]) == (5, START_NS, 600 * MS)
    assert row["rate_hz"] == pytest.approx(4 / 0.6)
    assert (row["period_p50_ns"], row["gaps"], row["gap_max_ns"]) == (100 * MS, 1, 300 * MS)
    assert row["jitter_ns"] == 0  # of 100, 100, 300, 100: the hole changes nothing
    assert (row["age_from"], row["age_messages"], row["age_negative"]) == ("header", 5, 0)
    assert (row["age_min_ns"], row["age_p50_ns"], row["age_max_ns"]) == (5 * MS, 5 * MS, 9 * MS)
    assert (row["age_p99_ns"], row["stamps_backwards"]) == (None, 0)
    assert row["payload_min_bytes"] == row["payload_max_bytes"] == row["payload_mean_bytes"]
    assert row["rate_bytes_per_s"] == pytest.approx(5 * row["payload_mean_bytes"] / 0.6)
    (source,) = report.sources
    assert (source.status, source.events) == ("read", 5)


def test_without_a_header_the_age_comes_from_the_publish_time(tmp_path):
    messages = [("/a", t * 10, t * 10 - 3, json.dumps({"t": t}).encode()) for t in range(1, 5)]
    messages += [("/b", 50, 50, b"{}")]
    write_mcap(tmp_path / "x.mcap", messages, compression=CompressionType.ZSTD)
    a, b = analyze_topics(tmp_path).topics.iter_rows(named=True)
    assert (a["topic"], a["encoding"], a["age_from"], a["age_p50_ns"]) == ("/a", "json", "publish", 3.0)
    assert (b["messages"], b["rate_hz"], b["age_from"], b["jitter_ns"]) == (1, None, None, None)


def stamped(seconds, nanoseconds=0, order=1):
    return bytes([0, order, 0, 0]) + struct.pack("<iI" if order == 1 else ">iI", seconds, nanoseconds) + b"\0" * 8


def test_stamps_ahead_of_the_log_and_backwards_are_counted(tmp_path):
    schema = ("pkg/msg/Odd", "ros2msg", b"# a comment\nuint8 ODD=1\n\nstd_msgs/Header header  # first\nint32 x\n")
    data = [
        (10, stamped(8)),
        (20, stamped(21)),  # a second ahead
        (30, stamped(20, order=0)),  # big endian, and backwards
        (40, stamped(0)),  # never set
        (50, b"\x00\x01"),  # cut off
    ]
    write_mcap(tmp_path / "x.mcap", [("/odd", t * 10**9, t * 10**9, d) for t, d in data], encoding="cdr", schema=schema)
    (row,) = analyze_topics(tmp_path).topics.iter_rows(named=True)
    assert (row["messages"], row["age_messages"], row["age_negative"], row["stamps_backwards"]) == (5, 3, 1, 1)
    assert (row["age_min_ns"], row["age_max_ns"]) == (-(10**9), 10 * 10**9)


def write_transforms(path, store, *, ros1=False):
    types = store.types
    vector, turn = types["geometry_msgs/msg/Vector3"](1, 2, 3), types["geometry_msgs/msg/Quaternion"](0, 0, 0, 1)
    more = {"seq": 3} if ros1 else {}
    bag = Bag1Writer(path) if ros1 else Bag2Writer(path, version=9)
    with bag:
        connection = bag.add_connection("/tf", "tf2_msgs/msg/TFMessage", typestore=store)
        for number in range(50):
            log_ns = START_NS + number * 100 * MS
            stamps = [] if number % 5 == 4 else [log_ns - 30 * MS, log_ns - 10 * MS]
            headers = [
                types["std_msgs/msg/Header"](
                    stamp=types["builtin_interfaces/msg/Time"](one // 10**9, one % 10**9), frame_id="map", **more
                )
                for one in stamps
            ]
            transform = types["geometry_msgs/msg/Transform"](vector, turn)
            message = types["tf2_msgs/msg/TFMessage"](
                [types["geometry_msgs/msg/TransformStamped"](one, "base", transform) for one in headers]
            )
            serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
            bag.write(connection, log_ns, serialize(message, "tf2_msgs/msg/TFMessage"))


@pytest.mark.parametrize("ros1", [False, True])
def test_ages_of_transforms_are_of_the_first_header(tmp_path, ros1):
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    if ros1:
        ours = get_typestore(Stores.ROS2_JAZZY).fielddefs
        store.register({"tf2_msgs/msg/TFMessage": ours["tf2_msgs/msg/TFMessage"]})
    write_transforms(tmp_path / ("a.bag" if ros1 else "a"), store, ros1=ros1)
    (row,) = analyze_topics(tmp_path).topics.iter_rows(named=True)
    assert (row["age_from"], row["age_messages"], row["age_p50_ns"]) == ("header", 40, 30 * MS)


@pytest.mark.parametrize(
    ("logged_ms", "copies"),
    [
        ([t + k for t in range(0, 2000, 20) for k in (0, 1)], 0),  # two publishers
        ([200 * (n // 8) + n % 8 for n in range(160)], 0),  # batches
        (sorted([*range(0, 10_000, 100)] * 2), 100),
        ([*range(0, 10_000, 100)] * 2, 100),  # one copy after the other
        ([0, 0, 0], 2),
    ],
)
def test_messages_that_are_there_twice_are_counted(tmp_path, logged_ms, copies):
    """And neither two publishers nor batches are copies, nor other content at the same time."""
    events = [("/a", START_NS + t * MS, 0, b"%d" % t) for t in logged_ms]
    events += [("/b", START_NS, 0, b"x%d" % n) for n in range(5)]
    write_mcap(tmp_path / "x.mcap", events)
    report = analyze_topics(tmp_path)
    assert report.topics["messages"].to_list() == [len(logged_ms), 5]
    assert report.sources[0].detail.partition(" ")[0] == (str(copies) if copies else "")


NAMED = b"string<=10 name\nstd_msgs/Header header\nuint8[] data\n"


@pytest.mark.parametrize(
    ("age_s", "is_other"), [(0.005, False), (-80_000, True), (90_000, True), (-90_000, True), (1_700_000_000, True)]
)
def test_stamps_of_another_clock_are_named(tmp_path, capsys, age_s, is_other):
    stamps = [START_NS - int(age_s * 1e9) + n * MS for n in range(9)]
    schema = ("pkg/msg/Odd", "ros2msg", b"std_msgs/Header header\n")
    data = [("/odd", START_NS + n * MS, 0, stamped(*divmod(stamp, 10**9))) for n, stamp in enumerate(stamps)]
    write_mcap(tmp_path / "x.mcap", data, encoding="cdr", schema=schema)
    report = analyze_topics(tmp_path)
    assert ("another clock" in report.sources[0].detail) is is_other
    print_report(BagReport(report))
    assert ("other clock" in capsys.readouterr().out) is is_other


def test_a_bounded_text_before_the_header_is_a_field(tmp_path):
    write_mcap(
        tmp_path / "x.mcap",
        [("/a", START_NS, START_NS, stamped(6))],
        encoding="cdr",
        schema=("my_msgs/msg/Named", "ros2msg", NAMED),
    )
    assert analyze_topics(tmp_path).topics["age_from"].to_list() == [None]


def test_what_is_no_recording_is_named(tmp_path):
    for path, words in ((tmp_path, "no recording"), (tmp_path / "nowhere", "no such file")):
        with pytest.raises(MissingEventsError, match=words):
            analyze_topics(path)
    for content in (b"", b"not an mcap at all"):
        (tmp_path / "bad.mcap").write_bytes(content)
        with pytest.raises(MissingEventsError, match=r"bad\.mcap"):
            analyze_topics(tmp_path)
    write_mcap(tmp_path / "good.mcap", [("/a", 1, 1, b"{}")])
    (tmp_path / "bad.bag").write_bytes(b"#ROSBAG V9.9\n")
    (tmp_path / "notes.txt").write_text("hello")
    report = analyze_topics(tmp_path)
    assert [(s.path.rsplit("/", 1)[1], s.status) for s in report.sources] == [
        ("bad.bag", "skipped"),
        ("bad.mcap", "skipped"),
        ("good.mcap", "read"),
    ]
    assert report.topics.height == 1
    with pytest.raises(TraceFormatError, match=r"bad\.mcap"):
        list(read_messages(tmp_path / "bad.mcap", Condition()))


def test_recordings_are_found_once_and_outputs_left_out(tmp_path):
    write_bag2(tmp_path / "bag", imu_topic(), times_ns=LOGGED_NS)
    (tmp_path / "analysis").mkdir()
    write_mcap(tmp_path / "analysis" / "derived.mcap", [("/a", 1, 1, b"")])
    write_mcap(tmp_path / "x.mcap", [("/a", 1, 1, b"")])
    found = find_recordings(tmp_path, skip=[tmp_path / "analysis"])
    assert found == [tmp_path / "bag", tmp_path / "x.mcap"]
    seen = []
    analyze_topics(tmp_path, skip=[tmp_path / "analysis"], progress=seen.append)
    assert seen == found


@pytest.mark.parametrize("times", [(2**64 - 1, 1), (1, 2**63)], ids=["log", "publish"])
def test_a_time_beyond_the_year_2262_costs_no_message(tmp_path, times):
    write_mcap(tmp_path / "x.mcap", [("/a", 1, 1, b"{}"), ("/a", *times, b"{}"), ("/a", 2, 2, b"{}")])
    report = analyze_topics(tmp_path)
    assert report.topics["messages"].to_list() == [3]
    assert "1 message has a time" in report.sources[0].detail
    assert report.verdict == "damaged"


def write_chunks(path, *chunks):
    records = [
        struct.pack("<QQQII", 0, 0, claimed, 0, 4) + b"zstd" + struct.pack("<Q", len(packed)) + packed
        for claimed, packed in chunks
    ]
    header = struct.pack("<BQII", 1, 8, 0, 0)
    body = b"".join(struct.pack("<BQ", 6, len(record)) + record for record in records)
    path.write_bytes(b"\x89MCAP0\r\n" + header + body)
    return path


@pytest.mark.parametrize("claimed", [1 << 40, 4_000_000_000, 100_000_000])
def test_a_chunk_is_not_unpacked_to_what_it_claims(tmp_path, claimed):
    path = write_chunks(tmp_path / "x.mcap", (claimed, zstandard.compress(bytes(100_000_000))[:500]))
    with pytest.raises(TraceFormatError, match=r"it claims|unpacks to more than"):
        list(read_messages(path, Condition()))


def test_a_file_of_small_bombs_is_not_unpacked_whole(tmp_path, monkeypatch):
    bomb = struct.pack("<BQ", 0x80, 1_000_000) + bytes(1_000_000)
    path = write_chunks(tmp_path / "x.mcap", *[(len(bomb), zstandard.compress(bomb))] * 20)
    with pytest.raises(TraceFormatError, match="cannot be read"):
        list(read_messages(path, Condition()))
    monkeypatch.setattr(blocks, "_UNSUSPECTED_FILE_BYTES", 0)
    with pytest.raises(TraceFormatError, match="unpacks to more than 200 times"):
        list(read_messages(path, Condition()))


def test_messages_of_a_few_bytes_are_bounded_in_number(tmp_path, monkeypatch, sentences):
    write_mcap(tmp_path / "x.mcap", [("/a", t, t, b"{}") for t in range(300)])
    monkeypatch.setattr(source, "_UNSUSPECTED_MESSAGES", 100)
    monkeypatch.setattr(source, "_LEAST_MESSAGE_BYTES", 1 << 40)
    report = analyze_topics(tmp_path / "x.mcap")
    assert report.topics["messages"].to_list() == [100]
    sentences(report.sources[0].detail)
