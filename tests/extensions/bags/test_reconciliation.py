import re
import shutil
import sqlite3

import pytest
import zstandard
from bags import imu, write_bag2
from rosbags.rosbag2 import StoragePlugin
from shaped_bags import shapes, write_shape

from dds_trace.extensions.bags.analyze import analyze_topics
from dds_trace.extensions.bags.payload import load_payload
from dds_trace.extensions.bags.recover import recover_recording

MESSAGES = {"/imu": [imu(0.1), imu(0.2)], "/gps": [imu(0.3)]}
SUFFIX = {StoragePlugin.MCAP: ".mcap", StoragePlugin.SQLITE3: ".db3"}


def topics_of(path):
    report = analyze_topics(path)
    return dict(report.topics.select("topic", "messages").rows()), "; ".join(s.detail for s in report.sources)


def replace_in(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@pytest.mark.parametrize("plugin", StoragePlugin)
def test_a_whole_bag_has_no_note(tmp_path, plugin):
    assert topics_of(write_bag2(tmp_path / "bag", MESSAGES, plugin)) == ({"/imu": 2, "/gps": 1}, "")


@pytest.mark.parametrize(
    "change", ["offered_qos_profiles = '- {depth: 7}' WHERE name = '/gps'", "type = 'sensor_msgs/Imu'"]
)
def test_a_database_with_another_qos_or_types_without_msg_is_read(tmp_path, change):
    bag = write_bag2(tmp_path / "bag", MESSAGES, StoragePlugin.SQLITE3)
    with sqlite3.connect(bag / "bag.db3") as database:
        database.execute(f"UPDATE topics SET {change}")
    assert topics_of(bag) == ({"/imu": 2, "/gps": 1}, "")
    assert set(analyze_topics(bag).topics["message_type"]) == {"sensor_msgs/msg/Imu"}
    assert len(load_payload(f"{bag}#/gps", {}).messages) == 1


def test_messages_in_a_log_beside_a_database_are_read(tmp_path, sentences):
    bag = write_bag2(tmp_path / "bag", MESSAGES, StoragePlugin.SQLITE3)
    database = sqlite3.connect(bag / "bag.db3")
    database.execute("PRAGMA journal_mode=WAL")
    database.execute("PRAGMA wal_autocheckpoint=0")
    database.execute(
        "INSERT INTO messages (topic_id, timestamp, data) SELECT topic_id, timestamp + 5, data FROM messages"
    )
    database.commit()
    before = {file.name: file.read_bytes() for file in bag.iterdir()}
    topics, detail = topics_of(bag)
    payload = load_payload(f"{bag}#/gps", {})
    database.close()
    assert topics == {"/imu": 4, "/gps": 2}
    assert "bag.db3-wal" in detail
    assert re.search(r"/gps has 1 .* 2 ", detail)
    sentences(detail)
    assert len(payload.messages) == 2
    assert [note.rpartition("metadata.yaml says")[2] in detail for note in payload.notes] == [True, True]
    assert before.keys() >= {"bag.db3", "bag.db3-wal"}


FILES = {
    "copy{} is not listed": lambda bag, ending: shutil.copy(bag / f"bag{ending}", bag / f"copy{ending}"),
    "drive{} is not listed": lambda bag, ending: (bag / f"bag{ending}").rename(bag / f"drive{ending}"),
    "gone{} is listed": lambda bag, ending: replace_in(
        bag / "metadata.yaml", f"- bag{ending}", f"- bag{ending}\n  - gone{ending}"
    ),
}


@pytest.mark.parametrize("words", FILES)
@pytest.mark.parametrize("plugin", StoragePlugin)
def test_a_file_that_is_not_as_the_bag_lists_it_is_named_and_the_rest_is_read(tmp_path, plugin, words, sentences):
    """One that was renamed is read, one that is there in addition is not."""
    bag = write_bag2(tmp_path / "bag", MESSAGES, plugin)
    FILES[words](bag, SUFFIX[plugin])
    topics, detail = topics_of(bag)
    assert topics == {"/imu": 2, "/gps": 1}
    assert detail.startswith(words.format(SUFFIX[plugin]))
    sentences(detail)
    assert len(load_payload(f"{bag}#/gps", {}).messages) == 1
    assert recover_recording(bag).messages == 3


@pytest.mark.parametrize("plugin", StoragePlugin)
def test_messages_that_are_there_twice_are_said(tmp_path, plugin):
    bag = write_bag2(tmp_path / "bag", {"/imu": [imu(0.1)]}, plugin)
    ending, merged = SUFFIX[plugin], tmp_path / "merged"
    merged.mkdir()
    for name in "ab":
        shutil.copy(bag / f"bag{ending}", merged / f"{name}{ending}")
    text = (bag / "metadata.yaml").read_text().replace(f"- bag{ending}", f"- a{ending}\n  - b{ending}")
    (merged / "metadata.yaml").write_text(text.replace("message_count: 1", "message_count: 2"))
    topics, detail = topics_of(merged)
    payload = load_payload(f"{merged}#/imu", {})
    assert (topics, len(payload.messages)) == ({"/imu": 2}, 2)
    assert [detail] == list(payload.notes)
    assert detail.startswith("1 message of /imu")
    assert "twice" in detail


def test_a_mean_rate_that_is_not_typical_is_said(tmp_path):
    bag = write_bag2(tmp_path / "bag", {"/imu": [imu(0.1)] * 9}, StoragePlugin.SQLITE3)
    assert load_payload(f"{bag}#/imu", {}).notes == ()
    with sqlite3.connect(bag / "bag.db3") as database:  # a pause of 30 s
        database.execute("UPDATE messages SET timestamp = timestamp + 30000000000 WHERE id > 5")
    payload = load_payload(f"{bag}#/imu", {})
    assert payload.rate_hz == pytest.approx(8 / 30.16)
    (note,) = payload.notes
    assert "0.265 Hz" in note
    assert "50 Hz" in note


@pytest.mark.parametrize("plugin", StoragePlugin)
def test_a_count_that_differs_is_said(tmp_path, plugin, sentences):
    bag = write_bag2(tmp_path / "bag", MESSAGES, plugin)
    replace_in(bag / "metadata.yaml", "message_count: 2", "message_count: 9")
    topics, detail = topics_of(bag)
    assert topics["/imu"] == 2
    assert "/imu has 9 messages, 2 " in detail
    assert detail in load_payload(f"{bag}#/imu", {}).notes
    assert load_payload(f"{bag}#/gps", {}).notes == ()
    sentences(detail)


@pytest.mark.parametrize("plugin", StoragePlugin)
def test_a_packed_file_without_metadata_is_read(tmp_path, plugin):
    bag = write_bag2(tmp_path / "bag", MESSAGES, plugin)
    (bag / "metadata.yaml").unlink()
    file = bag / f"bag{SUFFIX[plugin]}"
    packed = zstandard.ZstdCompressor().compress(file.read_bytes())
    (bag / f"{file.name}.zstd").write_bytes(packed)
    assert topics_of(bag)[0] == {"/imu": 2, "/gps": 1}
    file.unlink()
    assert topics_of(bag)[0] == {"/imu": 2, "/gps": 1}


def test_metadata_costs_no_more_memory_than_its_text(tmp_path):
    bag = write_bag2(tmp_path / "bag", MESSAGES, StoragePlugin.SQLITE3)
    with (bag / "metadata.yaml").open("a") as file:
        file.write("  custom_data: [" + "[]," * 1_000_000 + "]\n" + "[" * 100_000 + "\n")
    assert topics_of(bag)[0] == {"/imu": 2, "/gps": 1}


SHAPES = shapes()


@pytest.mark.parametrize("name", SHAPES)
def test_known_deletions_come_back(tmp_path, name):
    shape = SHAPES[name]
    deleted = write_shape(tmp_path / "x.mcap", shape)
    report = analyze_topics(tmp_path / "x.mcap")
    row = report.topics.filter(topic="/topic").row(0, named=True)
    if not shape.is_known:
        assert (row["missing"], row["missing_low"], row["missing_from"]) == (None, None, "")
        return
    assert row["missing"] == pytest.approx(deleted, abs=max(0.01 * len(shape.sent_ms), 1))
    assert row["missing_low"] <= deleted <= row["missing_high"]
    assert sum(report.holes.filter(topic="/topic")["missing"]) <= row["missing"] + 0.01 * len(shape.sent_ms)
