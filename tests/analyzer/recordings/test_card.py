import struct

import numpy as np
import pytest
from card_bags import MS, START_NS, card, timer, write
from mcap.writer import Writer
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.typesys import Stores, get_typestore

from dds_trace.analyzer.recordings.rows import qos_words
from dds_trace.reports.topics.renderers import print_topics, render_json, render_markdown, render_page


def test_what_all_topics_lack_was_lost_inside_the_recorder(tmp_path, capsys):
    gap, own = (10, 12), (20, 21)
    topics = {"/camera": timer(20, 30, without=[gap, own]), "/imu": timer(100, 30, without=[gap])}
    report, health, rows = card(write(tmp_path / "x.mcap", topics))
    assert health.verdict == "holes"
    assert [(start, length) for start, length in health.pauses] == [pytest.approx((9.99, 2.01), abs=0.06)]
    assert health.coverage == pytest.approx(28 / 30, abs=0.01)
    assert [(row["missing"], row["missing_inside"]) for row in rows.values()] == [(60, 40), (200, 200)]
    holes = report.holes.filter(topic="/camera").rows(named=True)
    assert [(hole["start_s"], hole["duration_s"], hole["inside"]) for hole in holes] == [
        (pytest.approx(10, abs=0.01), pytest.approx(2, abs=0.01), True),
        (pytest.approx(20, abs=0.01), pytest.approx(1, abs=0.01), False),
    ]
    print_topics(report)
    shown = capsys.readouterr().out
    assert "nothing for 1 s at 00:20" in shown
    assert "all topics: nothing for" in shown
    for render in (render_json, render_markdown, render_page):
        assert "/imu" in render(report)


@pytest.mark.parametrize(
    ("camera", "start_s", "words"),
    [(timer(20, 10), 10, "ends at 00:10, 20 s"), (timer(20, 10, since_ns=START_NS + 20 * 10**9), 0, "begins at 00:20")],
)
def test_a_late_start_and_an_early_end_are_no_loss(tmp_path, capsys, camera, start_s, words):
    report, health, rows = card(write(tmp_path / "x.mcap", {"/camera": camera, "/imu": timer(100, 30)}))
    assert (rows["/camera"]["missing"], rows["/camera"]["missing_high"], health.verdict) == (0, 0, "whole")
    assert report.holes.select("start_s", "duration_s").rows() == [pytest.approx((start_s, 20), abs=0.1)]
    assert sum(report.strips[0]) == pytest.approx(20, abs=0.2)  # of 60 parts
    assert sum(report.strips[1]) == 60
    print_topics(report)
    assert words in capsys.readouterr().out


def test_a_counter_knows_more_than_the_period(tmp_path):
    sequence = [n for n in range(300) if n not in (5, 6, 200)]
    times = [(START_NS + n * 10 * MS, START_NS + n * 10 * MS) for n in range(297)]
    _, _, rows = card(write(tmp_path / "x.mcap", {"/a": times}, sequences={"/a": sequence}))
    assert (rows["/a"]["missing"], rows["/a"]["missing_low"], rows["/a"]["missing_from"]) == (3, 3, "sequence")


@pytest.mark.parametrize("skipped", [0, 7])
def test_the_counter_of_a_ros_1_publisher_shows_whether_anything_was_sent(tmp_path, skipped):
    store = get_typestore(Stores.ROS1_NOETIC)
    header, time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    joy = store.types["sensor_msgs/msg/Joy"]
    bag = Bag1Writer(tmp_path / "x.bag")
    with bag:
        connection = bag.add_connection("/joy", "sensor_msgs/msg/Joy", typestore=store)
        for n in range(60):
            at = START_NS + n * 100 * MS + (n >= 30) * 700 * MS
            head = header(seq=n + (n >= 30) * skipped, stamp=time(*divmod(at, 10**9)), frame_id="a")
            message = joy(head, np.zeros(1, np.float32), np.zeros(1, np.int32))
            bag.write(connection, at, store.serialize_ros1(message, "sensor_msgs/msg/Joy"))
    report, health, rows = card(tmp_path / "x.bag")
    row = rows["/joy"]
    assert (row["missing_from"], row["missing"], row["missing_high"]) == ("sequence", skipped, skipped)
    assert health.verdict == ("holes" if skipped else "whole")
    assert report.holes["missing"].to_list() == [skipped]


def test_the_counts_of_rosbag2_stand_for_a_topic_without_a_period(tmp_path):
    def text(value):
        data = value.encode() + b"\0"
        return struct.pack("<I", len(data)) + data + bytes(-len(data) % 4)

    def event(topic, transport, recorder):
        body = text("/rosbag2_recorder") + struct.pack("<I", 1) + text(topic)
        body += bytes(-len(body) % 8)
        return b"\0\1\0\0" + body + struct.pack("<QQ", transport, recorder)

    rng = np.random.default_rng(1)
    with (tmp_path / "x.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema("rosbag2_interfaces/msg/MessagesLostEvent", "ros2msg", b"string node_name\n")
        lost = writer.register_channel("/events/rosbag2_messages_lost", "cdr", schema)
        pose = writer.register_channel("/pose", "cdr", 0)
        at = START_NS
        for number, wait in enumerate(rng.exponential(1e8, 50)):
            at += int(wait)
            writer.add_message(pose, at, b"\0\1\0\0%d" % number, at)
        writer.add_message(lost, at, event("/pose", 3, 4), at)
        writer.add_message(lost, at, event("/pose", 1, 0), at)
        writer.finish()
    _, health, rows = card(tmp_path / "x.mcap")
    row = rows["/pose"]
    assert (row["lost_in_transport"], row["lost_in_recorder"], row["missing"]) == (4, 4, 8)
    assert (row["missing_from"], row["missing_inside"], health.verdict) == ("recorder", 4, "holes")


def test_messages_at_time_0_are_of_another_clock(tmp_path):
    times = [(0, 1), (0, 2), (1, 3), *timer(10, 10)]
    _, health, rows = card(write(tmp_path / "x.mcap", {"/cam": times}))
    assert rows["/cam"]["expected_rate_hz"] == pytest.approx(10)
    assert (rows["/cam"]["missing"], rows["/cam"]["messages"]) == (0, 103)
    assert health.duration_ns < 10 * 10**9
    assert any(note.startswith("3 messages logged 54 years") for note in health.notes)


def test_a_clock_that_was_set_forward_is_no_loss(tmp_path):
    moved = [(log_ns + (n >= 100) * 30 * 10**9, stamp_ns) for n, (log_ns, stamp_ns) in enumerate(timer(20, 10))]
    _, health, rows = card(write(tmp_path / "x.mcap", {"/cam": moved}))
    assert rows["/cam"]["missing"] == 0
    assert any("set forward" in note for note in health.notes)


def test_stamps_that_jump_or_run_over_are_named(tmp_path):
    stamps = [(at, at - MS - (n >= 50) * 5 * 10**9) for n, (at, _) in enumerate(timer(10, 10))]
    _, health, _ = card(write(tmp_path / "x.mcap", {"/a": stamps}))
    assert any("jump 1 time" in note for note in health.notes)
    over = [(at, (at // 1000 % 2**32) * 1000) for at, _ in timer(1, 9000)]
    _, health, _ = card(write(tmp_path / "y.mcap", {"/a": over}))
    assert any("32 bits of us" in note for note in health.notes)


def test_chunks_out_of_order_are_counted(tmp_path):
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=200)
        writer.start("ros2")
        channel = writer.register_channel("/a", "cdr", 0)
        for at in [*range(50, 100), *range(50)]:
            writer.add_message(channel, START_NS + at * 100 * MS, b"1234%d" % at, 0)
        writer.finish()
    _, health, rows = card(path)
    assert (rows["/a"]["missing"], health.verdict) == (0, "whole")
    assert any("stored in order" in note for note in health.notes)
    assert any("end of an earlier one" in note for note in health.notes)


def test_one_odd_type_costs_no_other_topic(tmp_path):
    with (tmp_path / "x.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("")
        odd = writer.register_channel("/odd", "protobuf", writer.register_schema("a.B", "protobuf", b"\xff\x00\x12"))
        broken = writer.register_schema("x/msg/Y", "ros2msg", b"this is } no type\xff")
        channels = [odd, writer.register_channel("/broken", "cdr", broken), writer.register_channel("/json", "json", 0)]
        for n in range(20):
            for channel in channels:
                writer.add_message(channel, START_NS + n * 10 * MS, b"{%d}" % n, 0)
        writer.finish()
    _, health, rows = card(tmp_path / "x.mcap")
    assert {name: row["messages"] for name, row in rows.items()} == {"/odd": 20, "/broken": 20, "/json": 20}
    assert health.verdict == "whole"


NUMBERS = "- history: 1\n  depth: 7\n  reliability: 1\n  durability: 2\n"
NAMES = "- history: keep_all\n  depth: 0\n  reliability: best_effort\n  durability: transient_local\n"


@pytest.mark.parametrize(
    ("profiles", "words"),
    [
        (NUMBERS, "reliable, volatile, keep_last 7"),
        (NAMES, "best_effort, transient_local, keep_all"),
        ("", ""),
        ("durability: transient_local", "transient_local"),
    ],
)
def test_qos_as_recorded(tmp_path, profiles, words):
    assert qos_words(profiles) == words
    path = write(tmp_path / "x.mcap", {"/a": timer(10, 1)}, metadata={"offered_qos_profiles": profiles})
    assert card(path)[2]["/a"]["qos"] == words


def test_a_damaged_chunk_is_a_damage_and_the_rest_is_read(tmp_path):
    path = write(tmp_path / "x.mcap", {"/a": timer(100, 10)}, chunk_size=4096)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 255
    path.write_bytes(content)
    report, health, rows = card(path)
    assert (report.verdict, health.verdict) == ("damaged", "damaged")
    assert "is damaged" in health.damages[0]
    assert rows["/a"]["messages"] >= 999
