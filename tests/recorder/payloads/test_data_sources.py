import struct
import threading

import pytest

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.recorder.payloads import BINARY, IMU, STRING, header_data_type, open_payload, served_data_types
from dds_trace.recorder.payloads import base as payloads_base
from dds_trace.recorder.payloads.stamp import RAW_HEADER_STAMP, stamp_text

pytest.importorskip("rosbags", reason="rosbags is not installed")

from bags import ROS1, ROS2, image, imu, jpeg, points, text, write_bag1, write_bag2
from rosbags.rosbag2 import StoragePlugin

STAMP = stamp_text(0, 0).decode()


def load(data):
    stop = threading.Event()
    with open_payload(data, None, 0, open_node=lambda: pytest.fail("a node"), wait_s=0, stop=stop) as payload:
        return payload


def test_a_file_is_the_data_of_an_image(tmp_path):
    (tmp_path / "photo.jpg").write_bytes(b"\xff\xd8" + bytes(range(200)))
    payload = load(f"file:{tmp_path}/photo.jpg")
    assert payload.data_type is BINARY
    assert (payload.payload_bytes, payload.rate_hz, payload.feed) == (202, None, None)
    assert payload.source == f"file:{tmp_path}/photo.jpg"
    (message,) = payload.messages
    sent = ROS2.deserialize_cdr(bytes(message.data), "sensor_msgs/msg/Image")
    assert sent.data.tobytes() == b"\xff\xd8" + bytes(range(200))
    assert (sent.header.frame_id, sent.height, sent.width, sent.step) == (STAMP, 1, 202, 202)


def test_a_folder_is_its_files_in_turn(tmp_path):
    for name, size in (("b.png", 5), ("a.png", 9), (".hidden", 3)):
        (tmp_path / name).write_bytes(bytes(size))
    (tmp_path / "folder").mkdir()
    payload = load(f"file:{tmp_path}")
    assert [message.payload_bytes for message in payload.messages] == [9, 5]
    assert payload.payload_bytes == 9


def test_files_that_cannot_be_sent(tmp_path, monkeypatch):
    with pytest.raises(OptionError, match="No such file"):
        load("file:/nowhere")
    with pytest.raises(OptionError, match="the folder has no files"):
        load(f"file:{tmp_path}")
    (tmp_path / "empty").touch()
    with pytest.raises(OptionError, match=r"empty: the file is empty"):
        load(f"file:{tmp_path}")
    (tmp_path / "empty").write_bytes(bytes(11))
    monkeypatch.setattr(payloads_base, "MAX_PAYLOAD_BYTES", 10)
    with pytest.raises(OptionError, match="more than 0 GiB"):
        load(f"file:{tmp_path}")


IMU_ROWS = "time,gx,gy,gz,ax,ay,az\n10.00,1,2,3,4,5,6\n\n10.01,-1,-2e0,-3,-4,-5,-6.5\n10.04,0,0,0,0,0,9.8\n"


@pytest.mark.parametrize(
    "text",
    [IMU_ROWS, IMU_ROWS.replace(",", "\t "), "\ufeff" + IMU_ROWS.replace("\n", "\r\n"), IMU_ROWS.split("\n", 1)[1]],
)
def test_recorded_inertial_data_are_messages_with_those_values(tmp_path, text):
    (tmp_path / "drive.csv").write_text(text, newline="")
    payload = load(f"imu:{tmp_path}/drive.csv")
    assert payload.data_type is IMU
    assert payload.rate_hz == pytest.approx(2 / 0.04)
    assert (payload.payload_bytes, payload.source) == (296, f"imu:{tmp_path}/drive.csv")
    assert len(payload.messages) == 3
    sent = ROS2.deserialize_cdr(bytes(payload.messages[1].data), "sensor_msgs/msg/Imu")
    gyro, acceleration = sent.angular_velocity, sent.linear_acceleration
    assert (gyro.x, gyro.y, gyro.z) == (-1.0, -2.0, -3.0)
    assert (acceleration.x, acceleration.y, acceleration.z) == (-4.0, -5.0, -6.5)
    assert sent.header.frame_id == STAMP
    assert sent.orientation_covariance[0] == -1.0  # there is no estimate
    assert not sent.angular_velocity_covariance.any()
    assert not sent.linear_acceleration_covariance.any()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "the file has no values"),
        ("time,gx,gy,gz,ax,ay,az\n", "the file has no values"),
        ("1,2,3,4,5,6\n", "line 1 has 6 numbers in 6 columns"),
        ("1,2,3,4,5,6,7\n1,2,3,4,5,6,7,8\n", "line 2 has 8 numbers in 8 columns"),
        ("1,2,3,4,5,6,seven\n", "line 1 has 6 numbers in 7 columns"),
        ("1,2,3,4,5,6,nan\n", "line 1 has 6 numbers in 7 columns"),
        ("1,2,3,4,5,6,7\n\xff\n", "line 2 has 0 numbers in 1 columns"),
        ("2,2,3,4,5,6,7\n1,2,3,4,5,6,7\n", "line 2 is earlier"),
    ],
)
def test_inertial_data_that_cannot_be_sent_name_the_line(tmp_path, text, words):
    (tmp_path / "drive.csv").write_text(text, encoding="latin-1")
    with pytest.raises(OptionError, match=f"^--data imu:.*drive.csv: {words}"):
        load(f"imu:{tmp_path}/drive.csv")


def test_inertial_data_of_no_file_or_too_much(tmp_path, monkeypatch):
    with pytest.raises(OptionError, match="No such file"):
        load("imu:/nowhere")
    with pytest.raises(OptionError, match="not a regular file"):
        load("imu:/dev/zero")
    (tmp_path / "drive.csv").write_text("1 2 3 4 5 6 7\n" * 20)
    assert load(f"imu:{tmp_path}/drive.csv").rate_hz is None  # no time passes
    monkeypatch.setattr(payloads_base, "MAX_PAYLOAD_BYTES", 296 * 10)
    with pytest.raises(OptionError, match="more than 0 GiB"):
        load(f"imu:{tmp_path}/drive.csv")


@pytest.mark.parametrize("plugin", StoragePlugin, ids=lambda plugin: plugin.value)
def test_messages_of_a_bag_keep_all_but_their_header(tmp_path, plugin):
    bag = write_bag2(tmp_path / "bag", {"/points": [points(n) for n in (3, 100, 7)]}, plugin)
    payload = load(f"bag:{bag}#/points")
    data_type = payload.data_type
    assert (data_type.name, data_type.topic) == ("pointcloud2", "data_sensor_msgs_PointCloud2")
    assert (data_type.type_name, data_type.relay_topic) == (
        "sensor_msgs/msg/PointCloud2",
        "data_sensor_msgs_PointCloud2_relay",
    )
    assert payload.rate_hz == pytest.approx(50.0)
    assert len(payload.messages) == 3
    for count, message in zip((3, 100, 7), payload.messages, strict=True):
        stamps = data_type.raw.stamp
        stamps.write(message.data, 0xAB, 12)
        stamps.write_nanoseconds(message.data, 8_000_000_009 - stamps.write_second(message.data, 8_000_000_001))
        assert stamps.read(message.data) == (0xAB, 12, 0)
        sent, original = ROS2.deserialize_cdr(bytes(message.data), data_type.type_name), points(count)
        assert sent.header.frame_id == stamp_text(0xAB, 12).decode()
        assert (sent.header.stamp.sec, sent.header.stamp.nanosec) == (8, 9)
        assert sent.data.tobytes() == original.data.tobytes()
        assert [field.name for field in sent.fields] == ["x", "y", "z"]
        assert (sent.width, sent.row_step, sent.is_dense) == (count, 16 * count, True)
        # Behind the header: height, width, three fields (length, then name 4 + 2, offset, datatype, count, aligned),
        # flag, steps, the data with its length, is_dense; the exact number is what a relay finds as well.
        assert message.payload_bytes == data_type.raw.payload_bytes_of(message.data)
        assert 16 * count < message.payload_bytes < 16 * count + 120
        filled = message.data + bytes(-len(message.data) % 4)  # by a vendor, on the way
        assert data_type.raw.payload_bytes_of(filled) == message.payload_bytes
    assert payload.payload_bytes == max(message.payload_bytes for message in payload.messages)


def test_a_single_mcap_file_is_a_bag(tmp_path):
    folder = write_bag2(tmp_path / "bag", {"/jpeg": [jpeg(500)] * 2})
    (file,) = folder.glob("*.mcap")
    payload = load(f"bag:{file}#/jpeg")
    assert (payload.data_type.name, len(payload.messages)) == ("compressedimage", 2)
    # format: length 4, "jpeg" and zero 5; behind it 3 to align, length 4, data 500; header ends one short of 64
    assert payload.payload_bytes == 4 + 5 + 3 + 4 + 500


@pytest.mark.parametrize("name", ["/camera", "camera"])
def test_images_imu_and_strings_travel_as_those_of_our_making(tmp_path, name):
    topics = {"/camera": [image(4)], "/imu": [imu(0.5)], "/text": [text("héllo")]}
    bag = write_bag2(tmp_path / "bag", topics)
    payload = load(f"bag:{bag}#{name}")
    assert (payload.data_type, payload.payload_bytes, payload.rate_hz) == (BINARY, 120, None)
    payload = load(f"bag:{bag}#/imu")
    assert (payload.data_type, payload.payload_bytes) == (IMU, 296)
    assert struct.unpack_from("<d", payload.messages[0].data, 68 + 16) == (0.5,)
    payload = load(f"bag:{bag}#/text")
    assert (payload.data_type, payload.payload_bytes) == (STRING, 6)
    sent = ROS2.deserialize_cdr(bytes(payload.messages[0].data), "std_msgs/msg/String")
    assert sent.data == STAMP + "héllo"


def test_a_bag_of_ros_1_becomes_cdr(tmp_path):
    topics = {"/points": [points(9, ROS1), points(4, ROS1)], "/camera": [image(2, ROS1)]}
    bag = write_bag1(tmp_path / "x.bag", topics)
    payload = load(f"bag:{bag}#/points")
    assert (payload.data_type.name, payload.rate_hz) == ("pointcloud2", pytest.approx(50.0))
    sent = ROS2.deserialize_cdr(bytes(payload.messages[0].data), "sensor_msgs/msg/PointCloud2")
    assert (sent.header.frame_id, sent.width) == (STAMP, 9)
    assert sent.data.tobytes() == points(9).data.tobytes()
    assert RAW_HEADER_STAMP.read(payload.messages[1].data) == (0, 0, 0)
    assert load(f"bag:{bag}#/camera").payload_bytes == 60


def test_a_bag_that_cannot_be_sent_is_refused_in_one_line(tmp_path, monkeypatch):
    vector = ROS2.types["geometry_msgs/msg/Vector3"](1.0, 2.0, 3.0)
    bag = write_bag2(tmp_path / "bag", {"/camera/image": [image(4)] * 3, "/vector": [vector]})
    with pytest.raises(OptionError, match=r"bag has no topic /camra/image; the nearest of its 2 is /camera/image$"):
        load(f"bag:{bag}#/camra/image")
    with pytest.raises(OptionError, match=r"geometry_msgs/msg/Vector3 does not start with a std_msgs/Header"):
        load(f"bag:{bag}#/vector")
    with pytest.raises(OptionError, match=r"write bag:PATH#TOPIC"):
        load(f"bag:{bag}")
    (tmp_path / "text.mcap").write_text("no bag")
    with pytest.raises(OptionError, match="not a MCAP file"):
        load(f"bag:{tmp_path}/text.mcap#/x")
    with pytest.raises(OptionError, match="neither MCAP nor a ROS 1 bag"):
        load(f"bag:{__file__}#/x")
    with pytest.raises(OptionError, match="there is no such file or folder"):
        load(f"bag:{tmp_path}/nothing#/x")
    monkeypatch.setattr(payloads_base, "MAX_PAYLOAD_BYTES", 300)
    with pytest.raises(OptionError, match="has more than"):
        load(f"bag:{bag}#/camera/image")


def test_without_rosbags_the_extra_is_named(monkeypatch):
    monkeypatch.setattr("dds_trace.extensions.bags.payload.find_spec", lambda _: None)
    with pytest.raises(BackendUnavailableError, match=r"pip install 'dds-trace\[bags\]'"):
        load("bag:x#/y")


def test_a_relay_serves_each_type_once():
    served = served_data_types(["sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2"])
    assert [data_type.name for data_type in served] == ["binary", "string", "imu", "pointcloud2"]


def test_messages_of_a_further_type_cannot_be_made_up():
    with pytest.raises(OptionError, match="messages of nav_msgs/msg/Odometry cannot be made up"):
        header_data_type("nav_msgs/msg/Odometry").make(None, 0)
