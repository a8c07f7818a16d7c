import re
import struct

import numpy as np
import polars as pl
import pytest
from card_bags import HEADER, MS, START_NS, S, blob, card, timer, write, write_mcap
from commands import run_trace
from mcap.writer import Writer
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.typesys import Stores, get_typestore
from wording import numbers

from dds_trace.analyzer.exports.kinds import EXPORT_KINDS
from dds_trace.extensions.bags.analyze import analyze_topics
from dds_trace.extensions.bags.card import qos_words
from dds_trace.extensions.bags.periods import find_grid, find_regularity
from dds_trace.extensions.bags.report import COLUMNS, BagReport
from dds_trace.reports.reporters import REPORT_MODULES, load_reporter
from dds_trace.reports.terminal import print_report


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
    print_report(BagReport(report))
    shown = capsys.readouterr().out
    assert "missing for 1 s at 00:20" in shown
    assert "20 Hz while no message" in shown
    (camera,) = re.findall("/camera .*", shown)
    assert numbers(camera)[:6] == [540, 18, 60, 10, 2.05, 90], "the last two: largest gap, share covered"
    assert "all topics: nothing for" in shown
    for kind in REPORT_MODULES:
        assert "/imu" in load_reporter(kind).render(BagReport(report))


def test_the_rows_of_many_recordings_are_read_once(tmp_path, monkeypatch):
    for number in range(3):
        write(tmp_path / f"{number}x.mcap", {"/imu": timer(100, 2, without=[(1, 1.5)]), "/gps": timer(10, 2)})
    report, read = BagReport(analyze_topics(tmp_path)), []
    rows_of = pl.DataFrame.iter_rows
    monkeypatch.setattr(pl.DataFrame, "iter_rows", lambda frame, **how: read.append(frame) or rows_of(frame, **how))
    assert [len(topic["holes"]) for topic in report.document["topics"]] == [0, 1] * 3
    assert len(report.sections) == 3 + 4
    assert len(read) == 2, "topics and holes, once for all"


@pytest.mark.parametrize(
    ("camera", "start_s", "words"),
    [(timer(20, 10), 10, "ends at 00:10, 20 s"), (timer(20, 10, since_ns=START_NS + 20 * 10**9), 0, "begins at 00:20")],
)
def test_a_late_start_and_an_early_end_are_no_loss(tmp_path, capsys, camera, start_s, words):
    report, health, rows = card(write(tmp_path / "x.mcap", {"/camera": camera, "/imu": timer(100, 30)}))
    assert (rows["/camera"]["missing"], rows["/camera"]["missing_high"], health.verdict) == (0, 0, "whole")
    assert report.holes.select("start_s", "duration_s").rows() == [pytest.approx((start_s, 20), abs=0.1)]
    assert [*map(sum, report.strips)] == [pytest.approx(20, abs=0.2), 60]  # parts of 60
    print_report(BagReport(report))
    shown = capsys.readouterr().out
    assert words in shown
    assert "s 20 s " in shown.splitlines()[1]
    page = load_reporter("html").render(BagReport(report))
    assert ('<rect class="gap"' in page, '<rect class="hole"' in page) == (True, False)


def test_the_rate_of_a_start_and_a_late_start_are_no_pause(tmp_path, capsys):
    started = [(START_NS + n * MS // 2, START_NS + (n - 2) * MS // 2) for n in range(10)]
    late = {n: timer(hz, 20, since_ns=START_NS + 2 * S) for n, hz in (("/" + 40 * "a", 60), ("/dds_trace/t", 10))}
    report, health, rows = card(write(tmp_path / "x.mcap", {"/rosout": started, **late}))
    assert (health.verdict, health.pauses, health.coverage, health.notes) == ("whole", (), 1, ())
    assert rows["/rosout"]["missing"] is None  # a burst is no rhythm, and its rate none of the recording
    print_report(BagReport(report))
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= 80
    assert [word for word in (*COLUMNS, "0.409 Hz", "60 Hz") if word not in shown] == []
    assert shown.index("/rosout") < shown.index("Of dds-trace") < shown.index("/dds_trace")


ONE = [n for n in range(300) if n not in (5, 6, 200)]
COUNTERS = {
    "one": ({"/a": ONE}, 3, "sequence"),
    "two publishers in turn": ({"/a": sorted([*ONE, *[n + 0.5 for n in range(300)]])}, 3, "sequence"),
    "a node that starts again": ({"/a": [*ONE, *range(100)]}, 3, "sequence"),
    "a late message": ({"/a": [0, 2, 1, *range(3, 50), *range(53, 100)]}, 3, "sequence"),
    "one of all topics": ({"/a": [n for n in range(300) if n % 20], "/b": range(0, 300, 20)}, 0, "period"),
}  # fmt: skip


@pytest.mark.parametrize("name", COUNTERS)
def test_a_counter_knows_more_than_the_period(tmp_path, name):
    sent, missing, evidence = COUNTERS[name]
    times, sequences = {}, {}
    for topic, counted in sent.items():
        due = np.array(counted, float)
        due[len(ONE) :] += 300 * (name == "a node that starts again")
        if name == "one of all topics":
            due = np.arange(len(due)) if topic == "/a" else due - due // 20 - 0.5
        times[topic] = [(START_NS + int(n * 10 * MS),) * 2 for n in np.sort(due)]
        sequences[topic] = [int(n if n % 1 == 0 else 7000 + n) for n in counted]
    report, _, rows = card(write(tmp_path / "x.mcap", times, sequences=sequences))
    counts = [rows["/a"][name] for name in ("missing", "missing_low", "missing_from")]
    assert counts == [missing, missing, evidence]
    assert sum(report.holes["missing"]) == missing


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
    assert report.holes["missing"].to_list() == [skipped] * (skipped > 0)  # a person's pause is no hole


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


def test_chunks_out_of_order_are_named(tmp_path):
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


def camera(hz, selected, *, jitter_ms=0.2, stamp_jitter_ms=0.0):
    rng, count = np.random.default_rng(3), len(selected)
    stamps = START_NS + np.arange(count) * 1e9 / hz + rng.normal(0, stamp_jitter_ms, count) * MS
    logged = stamps + (3 + np.abs(rng.normal(0, jitter_ms, count))) * MS
    return sorted((int(logged[n]), int(stamps[n])) for n in np.flatnonzero(selected))


N = np.arange(16_000)
GRIDS = {
    "every second frame gone in half of the time": (15, (N[:900] // 75 % 2 == 0) | (N[:900] % 2 == 0)),
    "three quarters lost at random": (20, np.random.default_rng(7).random(1200) > 0.75),
}
THINNED = {
    "five of sixteen": (1000, N % 16 < 5),
    "two of three": (30, N[:3600] % 3 < 2),
    "three of five": (30, N[:3600] % 5 < 3),
    "three of four": (30, N[:3600] % 4 > 0),
    "a throttle": (
        30,
        np.append(True, np.diff((N[:3600] / 30 + np.random.default_rng(4).normal(0, 0.002, 3600)) // 0.05) > 0),
    ),
}


@pytest.mark.parametrize("stamp_jitter", [0, 0.015])
@pytest.mark.parametrize("name", GRIDS)
def test_stamps_on_a_grid_count_what_is_missing(tmp_path, name, stamp_jitter):
    hz, selected = GRIDS[name]
    frames = camera(hz, selected, stamp_jitter_ms=stamp_jitter * 1000 / hz)
    row = card(write(tmp_path / "x.mcap", {"/points": frames}))[2]["/points"]
    missing = int(np.diff(np.flatnonzero(selected) - 1).sum() - selected.sum()) + 1
    assert (row["missing"], row["missing_low"], row["missing_from"]) == (missing, missing, "stamps")
    assert row["expected_rate_hz"] == pytest.approx(hz, rel=1e-3)
    in_turn_ns = START_NS + np.sort(np.concatenate([N[:600] * 50, N[:600] * 50 + 7])) * MS  # of two publishers
    assert (find_grid(in_turn_ns), find_grid(in_turn_ns[::2])[0]) == (None, 50 * MS)


@pytest.mark.parametrize("name", THINNED)
def test_a_topic_that_is_thinned_lacks_nothing_for_sure(tmp_path, name):
    hz, selected = THINNED[name]
    _, health, rows = card(write(tmp_path / "x.mcap", {"/image": camera(hz, selected)}))
    row = rows["/image"]
    assert (row["missing_low"], health.verdict, health.certain) == (0, "unknown", False)
    assert row["missing_high"] == pytest.approx(np.ptp(np.flatnonzero(selected)) + 1 - selected.sum(), rel=0.01)


def stalled(seed, every, stall_ms, next_ms):
    rng, now, arrivals = np.random.default_rng(seed), 0.0, []
    for n in range(1000):
        now = max(now + next_ms * (1 + 0.05 * rng.normal()), n * 20 + abs(rng.normal(0, 0.6)))
        if n % every == every - 1:
            now = n * 20 + stall_ms * (0.6 + 0.8 * rng.random())
        arrivals.append(now)
    return np.array(arrivals)


@pytest.mark.parametrize(
    ("every", "stall_ms", "next_ms"), [(50, 100, 2.2), (25, 100, 0.2), (15, 80, 5), (100, 500, 2.2)]
)
def test_a_queue_that_is_flushed_is_no_other_rate(every, stall_ms, next_ms):
    for seed in range(40):
        times_ns = START_NS + (stalled(seed, every, stall_ms, next_ms) * MS).astype(np.int64)
        regularity = find_regularity(times_ns)
        assert (regularity.missing, regularity.low) == (0, 0)
        assert regularity.rate_hz == pytest.approx(50, rel=0.02)


def test_two_readings_of_arrivals_are_within_the_interval(tmp_path):
    selected = (N[:900] < 450) | (N[:900] % 2 == 0)
    topics = {"/a": [(log, log) for log, _ in camera(15, selected, jitter_ms=1)]}
    report, health, rows = card(write(tmp_path / "x.mcap", topics))
    assert (rows["/a"]["missing_low"], health.verdict, health.certain) == (0, "unknown", False)
    assert rows["/a"]["missing_high"] == pytest.approx(224, abs=2)
    assert "are missing" not in load_reporter("md").render(BagReport(report))


@pytest.mark.parametrize(
    ("back_ms", "is_stamped_so", "words"),
    [(30_000, 1, "begin again at 00:30"), (500, 0, "set back by 500 ms at 00:30")],
)
def test_times_that_run_again_double_no_rate(tmp_path, back_ms, is_stamped_so, words):
    messages = []
    for n in range(3000):
        at, back_ns = START_NS + n * 20 * MS, back_ms * MS * (n >= 1500)
        data = blob(at - MS - is_stamped_so * back_ns, size=8 + (n >= 1500))
        messages += [(name, at - back_ns, at - back_ns, data) for name in ("/a", "/b") if name == "/a" or not n % 5]
    _, health, rows = card(write_mcap(tmp_path / "x.mcap", messages, encoding="cdr", schema=HEADER))
    assert ([words in note for note in health.notes], health.verdict) == ([True], "whole")
    assert [row["rate_hz"] for row in rows.values()] == pytest.approx([50, 10], rel=0.01)
    assert [(row["missing"], row["age_max_ns"]) for row in rows.values()] == [(0, MS)] * 2


def test_the_interval_contains_what_jitter_and_two_publishers_of_one_frame_hide(tmp_path):
    rng = np.random.default_rng(2)
    selected, half = rng.random(3750) > 0.15, N[:1500] * 4 + 1
    exposed = np.sort(START_NS + (np.arange(3750) + rng.normal(0, 0.3, 3750)) * S / 30).astype(np.int64)[selected]
    fast = N[1:3000][rng.random(2999) > 0.05] * 2
    topics = {
        "/camera": [(at, at) for at in exposed.tolist()],
        "/tf": [(START_NS + at * 5 * MS,) * 2 for at in sorted([0, *fast.tolist(), *half.tolist()])],
    }
    _, _, rows = card(write(tmp_path / "x.mcap", topics))
    for row, missing, rate_hz in zip(rows.values(), (3750 - sum(selected), 2999 - len(fast)), (30, 150), strict=True):
        assert row["missing_low"] <= missing <= row["missing_high"]
        assert row["missing"] == pytest.approx(missing, abs=5)
        assert row["expected_rate_hz"] == pytest.approx(rate_hz, rel=0.01)


LONG, SHORT = [(2, 5), (20, 22.5), (41, 47)], [(2, 20), (20.5, 30), (30.4, 47)]


@pytest.mark.parametrize(("name", "pressed"), [("/cmd_vel", LONG), ("/something", LONG), ("/cmd_vel", SHORT)])
def test_silence_of_commands_is_no_loss(tmp_path, name, pressed):
    keys = [at for at in np.arange(2, 47, 1 / 30) if any(first <= at < last for first, last in pressed)]
    topics = {name: [(START_NS + int(at * S), START_NS + int(at * S) - 2 * MS) for at in keys], "/odom": timer(20, 60)}
    _, health, rows = card(write(tmp_path / "x.mcap", topics))
    assert (rows[name]["missing"], rows[name]["missing_from"], health.verdict) == (None, "", "whole")


def ages(count, hz, age_ms):
    due = [(START_NS + int(n * S / hz), int(age_ms(n) * MS)) for n in range(count)]
    return [(at + max(age_ns, 0), at + max(-age_ns, 0)) for at, age_ns in due]


def queued_ms(at_ms):
    return next((3 + end - at_ms for start, end in ((5000, 5800), (9000, 9500)) if start < at_ms < end), 3)


STEADY = {"/imu": ages(3200, 100, lambda _: 3), "/odom": ages(640, 20, lambda _: 3)}
CLOCKS = {
    "a topic": ({"/color": ages(450, 15, lambda n: 60 if n < 150 else 1200), **STEADY}, "/color became 1.14 s later at 00:10"),
    "the recorder": ({t: ages(600, 20, lambda n: 3 + 2500 * (n > 300)) for t in ("/a", "/b")}, "was set forward by 2.5 s at 00:15"),
    "a device": ({"/oak": ages(300, 30, lambda n: 3 - 4000 * (n > 120)), **STEADY}, "jump 1 time"),
    "one topic": ({"/cam": ages(200, 20, lambda n: 3 + 30_000 * (n > 100))}, "no other topic shows which"),
    "one jump": ({"/a": [(at, at - MS - (n >= 50) * 3 * S) for n, (at, _) in enumerate(timer(10, 10))]}, "jump 1 time"),
    "a replay": ({"/tf": [(at, at - 1930 * S) for at, _ in timer(10, 10)], "/rosout": [(at, at - 1930 * S * (n >= 50)) for n, (at, _) in enumerate(timer(10, 10))]}, "like /tf"),
    "a counter of 32 bits": ({"/a": [(at, (at // 1000 % 2**32) * 1000) for at, _ in timer(1, 9000)]}, "32 bits of us"),
    "a stall": ({"/a": ages(2000, 100, lambda n: queued_ms(n * 10)), "/b": ages(1000, 50, lambda n: queued_ms(n * 20))}, "up to 800 ms at 00:05 and 1 more time"),
    "latched": ({"/tf_static": [(START_NS + n * MS, START_NS - 156 * S // (n + 1)) for n in range(3)], **STEADY}, "nodes that started earlier"),
    "two kinds": ({"/tf": sorted(ages(1000, 20, lambda _: 2) + [(at + 7 * MS, at + 1200 * MS) for at, _ in ages(100, 2, lambda _: 0)])}, "two kinds"),
    "two clocks by turns": ({"/diagnostics": [(at, at - MS if n % 3 else 5 * S + n * MS) for n, (at, _) in enumerate(timer(3, 60))]}, "two kinds"),
    "a slow simulation": ({"/pose": [(START_NS + int(n * 0.1 / 0.28 * S), 10 * S + n * 100 * MS) for n in range(1200)]}, "0.28 of real time"),
    "TAI": ({"/points": ages(200, 10, lambda _: -36_995), **STEADY}, "TAI"),
    "GPS": ({"/fix": ages(200, 10, lambda _: -17_950), **STEADY}, "GPS"),
    "microseconds": ({"/flow": [(START_NS + n * 20 * MS, START_NS + n * 20_000) for n in range(500)]}, "microseconds"),
    "late growth": ({"/image": ages(1800, 30, lambda n: 30 + 6000 * max(n - 900, 0) / 900)}, "since 00:30"),
    "growth over two clocks": ({"/image": ages(1800, 30, lambda n: -1000 + 6000 * n / 1800), **STEADY}, "from -993 ms to"),
    "growth": ({"/image": ages(1800, 30, lambda n: 30 + 6000 * n / 1800)}, "from 36.7 ms to"),
}  # fmt: skip


@pytest.mark.parametrize("name", CLOCKS)
def test_each_change_of_an_age_has_its_own_sentence(tmp_path, name):
    topics, words = CLOCKS[name]
    report, health, rows = card(write(tmp_path / "x.mcap", topics))
    notes = [note for note in health.notes if "another clock" not in note]
    assert len(notes) == 1
    assert words in notes[0]
    page = load_reporter("md").render(BagReport(report))
    assert ("| latched |" in page) is (name == "latched")
    assert not re.search(r"(?<![\d.,])1 (messages|times|topics|stamps|chunks|pauses)\b", page)
    assert ("recorder's clock" in notes[0]) is (name in {"the recorder", "one topic"})
    assert not any(row["missing_low"] for row in rows.values())


def test_bursts_and_units_of_stamps_are_said(tmp_path):
    bursts = [(START_NS + b * 100 * MS + k * 100_000, START_NS + (b - 1) * 100 * MS + k * 5 * MS) for b in range(200) for k in range(20)]  # fmt: skip
    seconds = [(at, at // S * S) for at, _ in timer(20, 20)]
    simulated = [(at, at + MS * (n % 3 == 0)) for n, (at, _) in enumerate(timer(50, 10))]
    report, _, rows = card(write(tmp_path / "x.mcap", {"/livox": bursts, "/odom": seconds, "/joints": simulated}))
    assert (rows["/livox"]["expected_rate_hz"], rows["/livox"]["missing"]) == (pytest.approx(200), 0)
    assert (rows["/livox"]["burst_messages"], rows["/livox"]["burst_ns"]) == (20, 1.9 * MS)
    assert rows["/odom"]["age_resolution_ns"] == S
    page = load_reporter("md").render(BagReport(report))
    assert "then 98.1 ms" in page
    assert "below 1 s" in page
    assert (rows["/joints"]["age_negative"], "before the header's stamp" in page) == (167, False)


def test_three_impossible_times_cost_no_message_and_none_is_missing(tmp_path):
    frames = timer(10, 30)
    for number, log_ns in ((50, 2**64 - 5 * S), (51, 2**63 + 17), (200, 123_456_789)):
        frames[number] = log_ns, frames[number][1]
    report, health, rows = card(write(tmp_path / "x.mcap", {"/cam": frames}))
    assert (rows["/cam"]["messages"], rows["/cam"]["missing"], health.duration_ns) == (300, 0, 29.9 * S)
    assert ("2 messages" in health.damages[0], len(health.damages), len(report.holes)) == (True, 1, 0)


def test_bag_is_a_command_that_ends_with_30_where_messages_are_missing(tmp_path, capsys):
    write(tmp_path / "x.mcap", {"/a": timer(20, 30, without=[(10, 12)])})
    more = ["--report", "html", "--export", "perfetto"]
    assert run_trace("bag", tmp_path / "x.mcap", "--out", tmp_path / "health", *more) == 30
    assert "40 messages" in capsys.readouterr().out
    assert "/a" in (tmp_path / "health" / "topics.html").read_text()
    assert b"40 messages" in (tmp_path / "health" / "topics.pftrace").read_bytes()


def test_help_names_each_export_that_a_bag_has_and_no_other(tmp_path, capsys):
    write(tmp_path / "x.mcap", {"/a": timer(20, 3)})
    assert run_trace("bag", "--help") == 0
    (listed,) = re.findall(r"Further file to write: ([^;]*);", " ".join(capsys.readouterr().out.split()))
    for kind in EXPORT_KINDS:
        code = run_trace("bag", tmp_path / "x.mcap", "--out", tmp_path / kind, "--export", kind)
        is_listed = kind in listed.split(", ")
        assert (code, (tmp_path / kind).exists()) == ((0, True) if is_listed else (2, False))
    assert 0 < len(listed.split(", ")) < len(EXPORT_KINDS)
