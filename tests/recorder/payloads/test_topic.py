from __future__ import annotations

import threading
import time
from types import SimpleNamespace

import pytest

from dds_trace.base.errors import OptionError
from dds_trace.recorder.payloads.stamp import stamp_text
from dds_trace.recorder.payloads.topic import MAX_WAITING, LiveFeed, rate_of, shows_rate

NEVER = threading.Event()


def message(frame_id="lidar", fields=("std_msgs/Header",)):
    return SimpleNamespace(
        header=SimpleNamespace(frame_id=frame_id),
        get_fields_and_field_types=lambda: dict(zip(("header", "x"), fields, strict=False)),
    )


@pytest.fixture
def feed():
    node = SimpleNamespace(message_to_cdr=lambda each: bytes(16) + each.header.frame_id.encode() + bytes(38))
    return LiveFeed(node, "sensor_msgs/msg/PointCloud2", "--data topic:/x", {})


def payload_of(feed, wait_s=5.0):
    return feed.payload(time.monotonic() + wait_s, NEVER, source="topic:/x")


def test_the_first_message_is_for_probes_and_only_what_comes_later_is_sent(feed):
    for _ in range(10):
        feed.receive(message())
    payload = payload_of(feed)
    assert (payload.data_type.name, payload.payload_bytes, payload.feed) == ("pointcloud2", 36, feed)
    assert payload.rate_hz > 0
    assert payload.messages[0].data[16:62] == stamp_text(0, 0)
    feed.begin()
    before_ns = time.monotonic_ns()
    feed.receive(message())
    made, arrival_ns = feed.take(NEVER)
    assert before_ns <= arrival_ns <= time.monotonic_ns()
    assert made.data[16:62] == stamp_text(0, 0)
    stop = threading.Event()
    stop.set()
    assert feed.take(stop) is None


@pytest.mark.parametrize("is_stamped", [True, False])
def test_the_rate_is_the_publishers_where_its_middleware_stamps_messages(feed, is_stamped):
    """All arrive in a bunch, as they do where the receiver was held up."""
    for number in range(10):
        feed.receive(message(), 1_700_000_000_000_000_000 + number * 40_000_000 if is_stamped else 0)
    rate_hz = payload_of(feed).rate_hz
    assert rate_hz == 25 if is_stamped else rate_hz > 1_000


def test_messages_of_ours_do_not_echo(feed):
    feed.receive(message())
    feed.begin()
    feed.receive(message(stamp_text(7, 1).decode()))
    feed.receive(message())
    assert feed.take(NEVER) is not None
    assert feed._waiting.empty()
    assert feed.skipped == 0


def test_messages_beyond_the_queue_are_counted_and_left_out(feed):
    feed.receive(message())
    feed.begin()
    for _ in range(MAX_WAITING + 3):
        feed.receive(message())
    assert feed.skipped == 3
    assert feed._waiting.qsize() == MAX_WAITING


def test_a_silent_topic_and_a_type_without_header_are_refused(feed):
    with pytest.raises(OptionError, match="--data topic:/x: 0 messages"):
        payload_of(feed, wait_s=0.1)
    feed.receive(message(fields=("double",)))
    with pytest.raises(OptionError, match="PointCloud2 does not start with a std_msgs/Header"):
        payload_of(feed)


@pytest.mark.parametrize(
    ("batch", "pause_ms", "first", "rate_hz"), [(1, 25, 0, 40), (8, 200, 0, 40), (8, 200, 5, 40), (2, 50, 1, 40)]
)
def test_batches_have_the_rate_of_their_messages_wherever_a_look_begins(batch, pause_ms, first, rate_hz):
    sent_ns = [number // batch * pause_ms * 1_000_000 + number % batch * 200_000 for number in range(40)][first:]
    assert shows_rate(sent_ns)
    assert rate_of(sent_ns) == pytest.approx(rate_hz, rel=0.01)


def test_a_part_of_a_batch_shows_no_rate():
    assert not shows_rate([number * 200_000 for number in range(7)] + [200_000_000, 200_200_000])
