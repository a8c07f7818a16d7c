import random
import re
import sqlite3
import struct
from contextlib import closing

import pytest
from bags import imu, text, write_bag2
from card_bags import TEXT_SCHEMA, write_mcap
from damaged_bags import HOWS, KINDS, damage, joined, make_good, read_recovered
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin

from dds_trace.base.errors import OutputExistsError, TraceFormatError
from dds_trace.extensions.bags.analyze import analyze_topics
from dds_trace.extensions.bags.command import report_topics
from dds_trace.extensions.bags.payload import load_payload
from dds_trace.extensions.bags.read import UNCOUNTED, read_messages
from dds_trace.extensions.bags.recorded import Condition
from dds_trace.extensions.bags.recover import is_of_others, recover_recording
from dds_trace.extensions.bags.recover_command import recover_command
from dds_trace.extensions.bags.report import verdict_words
from dds_trace.recorder.payloads import STRING


@pytest.mark.keeps(3)
@pytest.mark.parametrize("kind", KINDS)
def test_every_whole_message_of_a_damaged_file_is_kept_and_read_by_all(tmp_path, kind):
    good, rng = make_good(kind, tmp_path, 7), random.Random(kind)
    for how in [*HOWS * 2, *["cut"] * 8]:
        content, whole = damage(good, rng, how)
        path = good.write(tmp_path, content)
        try:
            report = recover_recording(path)
        except TraceFormatError:
            assert not whole
            continue
        kept, condition = read_recovered(report.recovered), Condition()
        assert whole <= kept
        assert kept == {
            (message.topic.name, message.log_ns, message.data) for message in read_messages(path, condition)
        }
        if how == "cut" and kind not in {"sqlite3 wal", "sqlite3 journal"}:
            said = "; ".join(condition.damages)
            assert (bool(re.search("cut off|cut or damaged|missing", said)), "no record" in said) == (True, False), said
        assert path.read_bytes() == content
        if kind in {"mcap zstd", "mcap lz4", "mcap unpacked"}:  # they have checksums
            assert len(kept - good.needs.keys()) <= report.doubtful + len(report.damages)
        report.recovered.unlink()


DISORDERED = {
    "bag": [(0, 13991), (42724, 65150), (13991, 42724), (65150, None)],
    "mcap unpacked": [(0, 9313), (69113, 79213), (10923, 69113), (9313, 10923), (79213, None)],
}


@pytest.mark.parametrize("kind", DISORDERED)
def test_the_first_and_the_last_message_of_a_piece_are_kept(tmp_path, kind):
    good = make_good(kind, tmp_path, 21)
    content, whole = joined(good, [(start, stop or len(good.content)) for start, stop in DISORDERED[kind]])
    messages = read_messages(good.write(tmp_path, content), Condition())
    assert whole <= {(message.topic.name, message.log_ns, message.data) for message in messages}


@pytest.mark.parametrize("how", ["first bytes", "no first bytes", "before the magic", "short", *range(1, 9)])
def test_all_commands_read_a_file_with_damaged_ends(tmp_path, how):
    good = make_good("mcap zstd", tmp_path, 7)
    is_cut = isinstance(how, int)
    content, whole = (good.content[:-how], good.needs) if is_cut else damage(good, random.Random(3), how)
    path = good.write(tmp_path, content)
    of_topic = {key for key in whole if key[0] == "/camera"}
    report = analyze_topics(path)
    assert (report.topics["messages"].sum(), report.verdict) == (len(whole), "damaged")
    assert report.sources[0].status == "truncated"
    assert len(load_payload(f"{path}#/camera", {"std_msgs/msg/String": STRING}).messages) == len(of_topic)
    assert is_of_others(path)
    assert recover_recording(path).messages == len(whole) > 0


@pytest.mark.parametrize("kind", ["mcap zstd", "mcap lz4"])
@pytest.mark.parametrize("claimed", [0, 2**40])
def test_a_chunk_of_another_size_costs_no_message_of_it_or_of_a_second_file(tmp_path, kind, claimed):
    good, more = (make_good(kind, tmp_path, seed) for seed in (7, 8))
    content = bytearray(good.content)
    second = sorted({need[0][0] for need in good.needs.values()})[1]
    struct.pack_into("<Q", content, second + 25, claimed)
    path = good.write(tmp_path, bytes(content) + more.content)
    assert read_recovered(recover_recording(path).recovered) == good.needs.keys() | more.needs.keys()


def test_data_of_a_bag_are_the_messages_that_can_be_parsed_of_a_topic_that_a_second_file_renames(tmp_path):
    good = make_good("mcap without chunks", tmp_path, 7)
    second = good.content.replace(b"/camera", b"/kamera")
    data = next(data for topic, _, data in good.needs if topic == "/camera")
    path = good.write(tmp_path, good.content.replace(data, data[:4] + b"\xff" * 4 + data[8:]) + second)
    payload = load_payload(f"{path}#/camera", {"std_msgs/msg/String": STRING})
    assert len(payload.messages) == 99
    assert "damaged" in payload.notes[-1]


@pytest.mark.parametrize("page_bytes", [512, 65536])
def test_a_database_without_its_header_is_read_with_pages_of_any_size(tmp_path, page_bytes):
    good = make_good("sqlite3", tmp_path, 7)
    path = good.write(tmp_path, good.content)
    with closing(sqlite3.connect(path)) as database:
        database.executescript(f"PRAGMA page_size={page_bytes}; VACUUM")
    path.write_bytes(bytes(100) + path.read_bytes()[100:])
    assert read_recovered(recover_recording(path).recovered) == good.needs.keys()


DEFINITION = (b"string data", b"string\0data", -1)


@pytest.mark.parametrize(
    ("kind", "replaced"),
    [("mcap zstd", (b"ros2", b"r\0s2", 1)), ("mcap without chunks", DEFINITION), ("sqlite3", DEFINITION)],
)
def test_a_damaged_profile_or_definition_costs_no_message(tmp_path, kind, replaced):
    good = make_good(kind, tmp_path, 7)
    path = good.write(tmp_path, good.content.replace(*replaced))
    assert read_recovered(recover_recording(path).recovered) == good.needs.keys()


@pytest.mark.parametrize("plugin", StoragePlugin)
def test_a_folder_without_metadata_and_with_a_cut_file_becomes_a_bag(tmp_path, plugin, capsys):
    messages = {"/imu": [imu(n / 100) for n in range(40)], "/chatter": [text("x" * 3000)] * 20}
    bag = write_bag2(tmp_path / "drive", messages, plugin)
    (bag / "metadata.yaml").unlink()
    (file,) = bag.iterdir()
    file.write_bytes(file.read_bytes()[: -file.stat().st_size // 5])
    before = file.read_bytes()
    assert is_of_others(bag)
    recover_command(bag)
    count = int(re.search(r"(\d+) messages recovered, ", capsys.readouterr().out)[1])
    assert count > 0
    assert file.read_bytes() == before
    with AnyReader([tmp_path / "drive-recovered"]) as reader:
        assert reader.message_count == len(list(reader.messages())) == count
    (source,) = analyze_topics(tmp_path / "drive-recovered").sources
    assert (source.status, "recovered" in source.detail) == ("read", True)
    with pytest.raises(OutputExistsError, match="--out"):
        recover_recording(bag)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("plugin", StoragePlugin)
def test_a_copy_lacks_what_the_damaged_bag_counted(tmp_path, plugin, seed, capsys):
    bag = write_bag2(
        tmp_path / "drive", {"/imu": [imu(n / 100) for n in range(400)], "/a": [text("x" * 300)] * 400}, plugin
    )
    (file,) = bag.glob("drive*")
    file.write_bytes(file.read_bytes()[: int(file.stat().st_size * random.Random(seed).uniform(0.3, 0.8))])
    report = recover_recording(bag)
    gone = 800 - report.messages
    assert f"{gone:,} of 800 messages" in "\n".join(report.lines())
    for copy in (report.recovered, recover_recording(report.recovered).recovered):
        assert report_topics([copy], tmp_path / "out", [], [], [])[0] == 30
        rows, (health,) = (about := analyze_topics(copy)).topics, about.recordings
        assert rows["missing_low"].sum() + health.gone == gone > 0
        assert f"{rows['missing_low'].sum():,} messages are missing" in capsys.readouterr().out
    (health,) = (about := analyze_topics(next(report.recovered.glob("drive*")))).recordings
    assert (health.verdict, health.certain, health.notes[0].endswith(UNCOUNTED)) == ("unknown", False, True)
    assert " of what was recovered." in verdict_words(health, about.topics.rows(named=True))


def test_a_whole_bag_is_copied_with_its_qos(tmp_path):
    bag = write_bag2(tmp_path / "drive", {"/imu": [imu(0.1)] * 3}, StoragePlugin.MCAP)
    report = recover_recording(bag, tmp_path / "new")
    assert (report.messages, report.damages, report.doubtful) == (3, [], 0)
    topics = [analyze_topics(path).topics.drop("recording") for path in (bag, tmp_path / "new")]
    assert topics[0].equals(topics[1])
    assert analyze_topics(tmp_path / "new").recordings[0].notes == ()


def test_what_holds_nothing_is_refused_in_one_line(tmp_path):
    for name, content in (("a.mcap", b"\x89MCAP0\r\n" + bytes(500)), ("b.db3", bytes(5000)), ("c.mcap", b"text")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(TraceFormatError, match=name):
            recover_recording(tmp_path / name)
    assert {path.name for path in tmp_path.iterdir()} == {"a.mcap", "b.db3", "c.mcap"}


def test_more_channels_than_a_file_can_have_cost_only_their_messages(tmp_path, monkeypatch):
    monkeypatch.setattr("dds_trace.extensions.bags.recover.MOST_CHANNELS", 3)
    messages = [(f"/{number}", number, number, b"\0\1\0\0\1\0\0\0\0") for number in range(5)]
    write_mcap(tmp_path / "many.mcap", messages, encoding="cdr", schema=TEXT_SCHEMA)
    report = recover_recording(tmp_path / "many.mcap")
    assert report.messages == 3
    assert all("2 messages" in line and "more than 3 channels" in line for line in report.damages)
    with report.recovered.open("rb") as file:
        assert {channel.topic for _, channel, _ in make_reader(file).iter_messages()} == {"/0", "/1", "/2"}
