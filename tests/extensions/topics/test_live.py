import json
import time
import urllib.error
import urllib.request

import pytest
from rosbags.typesys import Stores, get_typestore

from dds_trace.cli.record.run import live_table
from dds_trace.extensions.topics.live import KEPT_MESSAGES, Health, LiveRow, LiveTable, LiveTopic
from dds_trace.extensions.topics.recording import TYPE_NAME, diagnostic_array, serve_page

MS, SECOND = 1_000_000, 1_000_000_000
ROWS = (
    LiveRow("/camera", Health.OK, 29.9, 30.0, 12 * MS, 40 * MS, 3, 5 * MS),
    LiveRow("/lidar", Health.STALE, 0.0, None, None, None, 0, None),
)


def fed(rate_hz, seconds, expected_hz=None, start_ns=0):
    topic = LiveTopic("/camera", expected_hz)
    for number in range(round(rate_hz * seconds)):
        topic.count(start_ns + round(number * SECOND / rate_hz), 0, 1, 0)
    return topic


@pytest.mark.parametrize("rate_hz", [0.7, 10, 100, 1000])
def test_the_rate_is_of_the_last_seconds(rate_hz):
    topic, last = fed(rate_hz, 12), round(rate_hz * 12) - 1
    assert topic.row(round(last * SECOND / rate_hz)).rate_hz == pytest.approx(rate_hz, rel=0.05)


def test_the_rate_is_that_of_the_publisher_also_where_messages_are_missing():
    topic, arrived = LiveTopic("/camera", None), 0
    for number in range(500):
        if number % 10 in {0, 3, 4}:
            arrived += 1
            topic.count(number * 50 * MS, 0, 1, number + 1 - arrived)
    row = topic.row(494 * 50 * MS)
    assert (row.rate_hz, row.expected_hz) == (pytest.approx(20, rel=0.05), pytest.approx(20, rel=0.05))
    assert (row.missing, row.health) == (495 - arrived, Health.OK)


def test_a_rate_is_learnt_and_then_kept():
    topic = fed(10, 12, start_ns=1)
    assert topic.row(12 * SECOND).expected_hz == pytest.approx(10)
    for number in range(100):
        topic.count(12 * SECOND + number * 200 * MS, 0, 1, 0)
    row = topic.row(12 * SECOND + 100 * 200 * MS)
    assert row.expected_hz == pytest.approx(10)
    assert (row.health, round(row.rate_hz)) == (Health.SLOW, 5), "slow is not late"


def test_a_burst_at_the_start_is_no_rate():
    topic = LiveTopic("/camera", None)
    for number in range(60):
        topic.count(SECOND + number * MS, 0, 1, 0)
    for number in range(1000):
        topic.count(2 * SECOND + number * 10 * MS, 0, 1, 0)
        row = topic.row(2 * SECOND + number * 10 * MS)
    assert (row.expected_hz, row.health) == (pytest.approx(100), Health.OK)


@pytest.mark.parametrize(
    ("silence_ms", "health"), [(50, Health.OK), (350, Health.LATE), (900, Health.LATE), (1100, Health.STALE)]
)
def test_silence_makes_a_topic_late_and_then_stale(silence_ms, health):
    topic = fed(10, 10, expected_hz=10.0)
    last_ns = 10 * SECOND - 100 * MS
    assert topic.row(last_ns + silence_ms * MS).health is health


def test_an_expected_topic_that_never_comes_is_stale():
    table = LiveTable({"/camera": 30.0})
    (row,) = table.rows()
    assert (row.topic, row.health, row.silence_ns) == ("/camera", Health.STALE, None)


def test_ages_are_by_the_wall_clock_of_this_device():
    topic, now_ns = LiveTopic("/camera", None), time.monotonic_ns()
    offset_ns = time.time_ns() - time.monotonic_ns()
    for number in range(200):
        topic.count(now_ns + number, now_ns + offset_ns + number - (50 * MS if number == 7 else 5 * MS), 1, 0)
    row = topic.row(now_ns + 1000)
    assert row.age_ns == pytest.approx(5 * MS, abs=MS)
    assert row.age_p99_ns == pytest.approx(5 * MS, abs=MS)


def test_memory_is_bounded_and_losses_add_up():
    topic = LiveTopic("/camera", None)
    for number in range(5 * KEPT_MESSAGES):
        topic.count(number, 1, number % 2, number // 1000)
    assert max(len(topic._arrivals), len(topic._ages_ns)) == KEPT_MESSAGES
    assert topic.row(5000).missing == 8


def test_the_page_has_the_table_and_answers_only_its_own_name():
    with serve_page(0, lambda: ROWS, "robot <1>") as address:
        with urllib.request.urlopen(address + "live.json") as answer:
            rows = json.load(answer)
        with urllib.request.urlopen(address) as answer:
            assert b"Topics of robot &lt;1&gt;" in answer.read()
        foreign = urllib.request.Request(address + "live.json", headers={"Host": "evil.example"})
        with pytest.raises(urllib.error.HTTPError):
            urllib.request.urlopen(foreign)
    assert [(row["topic"], row["health"], row["age_ns"]) for row in rows] == [
        ("/camera", "OK", 12 * MS),
        ("/lidar", "STALE", None),
    ]


def test_diagnostics_are_the_message_of_ros_2():
    store = get_typestore(Stores.LATEST)
    message = store.deserialize_cdr(diagnostic_array(ROWS, "robot", 7 * SECOND + 9), TYPE_NAME)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (7, 9)
    assert [(status.level, status.message, status.hardware_id) for status in message.status] == [
        (0, "OK", "robot"),
        (3, "STALE", "robot"),
    ]
    values = {value.key: value.value for value in message.status[0].values}
    assert (values["rate_hz"], values["age"], values["missing"]) == ("29.9", "12 ms", "3")


def test_the_terminal_shows_a_row_for_each_topic():
    table = live_table(ROWS)
    assert table.row_count == 2
    assert [str(cell) for cell in table.columns[1].cells] == ["OK", "STALE"]
