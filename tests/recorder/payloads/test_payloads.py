from __future__ import annotations

import importlib
import zlib

import pytest

from dds_trace.base.errors import OptionError
from dds_trace.recorder.payloads import BINARY, IMU, STRING, data_types, find_data_type
from dds_trace.recorder.payloads.stamp import stamp_text

SIZES = [
    *(pytest.param(BINARY, size, id=f"binary-{size}") for size in (1, 2, 3, 4, 33_000, 502_000)),
    *(pytest.param(STRING, size, id=f"string-{size}") for size in (0, 4, 91, 1405, 2675)),
    pytest.param(IMU, 296, id="imu"),
]


def padding_of(data_type):
    """Bytes that CDR skips to align what follows; their value is anything."""
    return {"binary": (63, 83), "imu": (63, 64, 65, 66, 67), "string": ()}[data_type.name]


@pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")  # lark's, which rclpy imports
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
