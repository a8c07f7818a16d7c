import importlib
import os
import random
import string
import threading
import time
import zlib
from types import SimpleNamespace

import pytest

from dds_trace.base.errors import OptionError
from dds_trace.extensions.topics.payload import MAX_WAITING, LiveFeed, rate_of, shows_rate
from dds_trace.recorder.errors import StoppedError
from dds_trace.recorder.payloads import BINARY, IMU, STRING, data_types, find_data_type, open_payload
from dds_trace.recorder.payloads import base as payloads_base
from dds_trace.recorder.payloads.stamp import stamp_text

SIZES = [
    *(pytest.param(BINARY, size, id=f"binary-{size}") for size in (1, 2, 3, 4, 33_000, 502_000)),
    *(pytest.param(STRING, size, id=f"string-{size}") for size in (0, 4, 91, 1405, 2675)),
    pytest.param(IMU, 296, id="imu"),
]


def padding_of(data_type):
    return {"binary": (63, 83), "imu": (63, 64, 65, 66, 67), "string": ()}[data_type.name]


@pytest.mark.parametrize(("data_type", "size"), SIZES)
def test_bytes_equal_those_of_ros(data_type, size):
    serialization = pytest.importorskip("rclpy.serialization", reason="no ROS 2 here")
    package, _, name = data_type.type_name.split("/")
    message_class = getattr(importlib.import_module(f"{package}.msg"), name)
    ours = data_type.make(size, 3).messages[0].data
    data_type.raw.stamp.write(ours, 0xAB, 12)
    assert data_type.raw.stamp.write_second(ours, 1_700_000_000_100_000_000) == 1_700_000_000_000_000_000
    data_type.raw.stamp.write_nanoseconds(ours, 123_456_789)

    message = serialization.deserialize_message(bytes(ours), message_class)
    theirs = bytearray(serialization.serialize_message(message))
    for position in padding_of(data_type):
        assert ours[position] == 0
        theirs[position] = 0
    assert ours == theirs
    assert data_type.objects.stamp.read(message) == (0xAB, 12, 0)
    assert data_type.objects.payload_bytes_of(message) == size
    if data_type is not STRING:
        assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1_700_000_000, 123_456_789)


@pytest.mark.parametrize(("data_type", "size"), SIZES)
def test_size_counts_the_application_bytes_alone(data_type, size):
    payload = data_type.make(size, 3)
    (message,) = payload.messages
    assert payload.payload_bytes == message.payload_bytes == size
    assert data_type.raw.payload_bytes_of(message.data) == size
    assert data_type.raw.payload_bytes_of(bytes(message.data)) == size


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0", bytes(200), bytes(72) + b"\xff" * 100])
def test_bytes_that_are_no_image_of_ours_have_size_0(data):
    assert BINARY.raw.payload_bytes_of(data) == 0


@pytest.mark.parametrize("data_type", data_types().values(), ids=lambda data_type: data_type.name)
def test_the_seed_decides_the_content(data_type):
    first, again, other = (data_type.make(None, seed).messages[0].data for seed in (1, 1, 2))
    assert first == again
    assert first != other


def test_binary_data_cannot_be_compressed():
    data = BINARY.make(33_000, 5).messages[0].data
    assert len(zlib.compress(data, 9)) > 33_000


def test_defaults_are_those_of_the_command_line():
    assert {name: each.make(None, 0).payload_bytes for name, each in data_types().items()} == {
        "binary": 33_000,
        "string": 91,
        "imu": 296,
    }


def test_every_imu_number_is_set():
    data = IMU.make(None, 9).messages[0].data
    assert len(data) == 68 + 296
    assert all(any(data[68 + 8 * i : 76 + 8 * i]) for i in range(37))
    assert data[16:62] == stamp_text(0, 0)


@pytest.mark.parametrize(("data_type", "size"), [(BINARY, 0), (BINARY, 2**32), (STRING, -1), (IMU, 5)])
def test_a_size_that_cannot_be_is_refused(data_type, size):
    with pytest.raises(OptionError, match=f"--size {size}"):
        data_type.make(size, 0)


def test_an_unknown_data_type_is_named():
    with pytest.raises(OptionError, match="'video'; choose one of binary, string, imu"):
        find_data_type("video")


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


LETTERS = (string.ascii_letters + string.digits).encode()
PIECE = 1 << 20


class StopAtThird(threading.Event):
    looks = 0

    def is_set(self):
        self.looks += 1
        return self.looks >= 3


def load(data, size_bytes=None, stop=None):
    stop = stop or threading.Event()
    with open_payload(data, size_bytes, 3, open_node=lambda: pytest.fail("a node"), wait_s=0, stop=stop) as payload:
        return payload


@pytest.mark.parametrize("data", ["binary", "string"])
@pytest.mark.parametrize("size", [(1 << 30) + 1, 1 << 32, 10**12, 10**400])
def test_size_beyond_what_is_held_is_refused(data, size):
    with pytest.raises(OptionError, match="payload has"):
        load(data, size)


@pytest.mark.parametrize("size", [1, 4, PIECE - 1, PIECE, PIECE + 1, 2 * PIECE + 5])
def test_pieces_are_the_bytes_that_one_draw_gives(size):
    binary, text = (data_type.make(size, 3).messages[0].data for data_type in (BINARY, STRING))
    assert binary.endswith(random.Random(3).randbytes(size))
    assert text.endswith(stamp_text(0, 0) + bytes(random.Random(3).choices(LETTERS, k=size)) + b"\0")


@pytest.mark.parametrize("data", ["binary", "string"])
def test_a_signal_ends_the_making(data):
    stop = StopAtThird()
    with pytest.raises(StoppedError, match="nothing is recorded"):
        load(data, 1 << 30, stop)
    assert stop.looks == 3


def test_a_signal_ends_the_reading_of_a_file(tmp_path):
    with (tmp_path / "large").open("wb") as file:
        file.truncate(payloads_base.MAX_PAYLOAD_BYTES)
    stop = StopAtThird()
    with pytest.raises(StoppedError):
        load(f"file:{tmp_path / 'large'}", stop=stop)
    assert stop.looks == 3


def test_a_file_of_a_terabyte_is_refused(tmp_path):
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(1 << 40)
    for where in (tmp_path / "sparse", tmp_path):
        with pytest.raises(OptionError, match="more than 1 GiB"):
            load(f"file:{where}")


@pytest.mark.parametrize("device", ["/dev/zero", "/dev/urandom", "/dev/null", "/dev/tty"])
def test_a_device_is_no_file(device):
    with pytest.raises(OptionError, match=device):
        load(f"file:{device}")


@pytest.mark.parametrize("data", ["file:{}", "bag:{}#/topic"])
def test_a_pipe_is_no_file_and_is_not_waited_for(tmp_path, data):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OptionError, match="pipe"):
        load(data.format(tmp_path / "pipe"))


def test_devices_behind_links_in_a_folder_are_left_out(tmp_path):
    (tmp_path / "a").write_bytes(b"data")
    (tmp_path / "b").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "c")
    assert [message.payload_bytes for message in load(f"file:{tmp_path}").messages] == [4]
