"""Stamps in any encoding; the descriptors are encoded by hand, as the product needs no package of protobuf."""

import json
import struct

import pytest
from bags import ROS1, ROS2, header, image, imu, points
from hypothesis import given
from hypothesis import strategies as st

from dds_trace.extensions.bags.message_stamps import stamps_of
from dds_trace.tracefile.format.bag_metadata import RecordedTopic

TIMESTAMP = ".google.protobuf.Timestamp"
SECONDS, NANOSECONDS = 1_790_000_000, 250_000_000
STAMP_NS = SECONDS * 10**9 + NANOSECONDS


def varint(number):
    return bytes([number]) if number < 128 else bytes([number % 128 + 128]) + varint(number // 128)


def part(number, content):
    return varint(number << 3 | 2) + varint(len(content)) + content


def field(number, kind):
    return part(2, part(1, b"name") + varint(3 << 3) + varint(number) + part(6, kind.encode()))


def message_type(name, *parts):
    return part(4, part(1, name.encode()) + b"".join(parts))


def descriptors(package, *types):
    return part(1, part(1, b"x.proto") + part(2, package.encode()) + b"".join(types))


def timestamp(seconds=SECONDS, nanoseconds=NANOSECONDS):
    return varint(8) + varint(seconds) + (varint(16) + varint(nanoseconds) if nanoseconds else b"")


def protobuf_stamp(name, content, data):
    stamps = stamps_of(RecordedTopic("/t", name, "protobuf", descriptors=content))
    return stamps and stamps.read(data)


@given(path=st.lists(st.integers(1, 2000), min_size=1, max_size=6), stamp_ns=st.integers(1, 2**62), before=st.binary())
def test_the_first_timestamp_of_a_schema_is_found_at_any_depth(path, stamp_ns, before):
    types = [message_type(f"T{n}", field(number, f".a.T{n + 1}")) for n, number in enumerate(path[:-1])]
    types.append(message_type(f"T{len(path) - 1}", field(path[-1], TIMESTAMP)))
    data = timestamp(*divmod(stamp_ns, 10**9))
    for number in reversed(path):
        data = part(number + 1, before) + varint(number + 2 << 3) + varint(7) + part(number, data)
    found = protobuf_stamp("a.T0", descriptors("a", *types), data)
    assert found == (stamp_ns if stamp_ns < 2**33 * 10**9 else None)
    assert protobuf_stamp("a.T0", descriptors("a", *types), data[: len(before) + 3]) is None


def test_of_repeated_values_the_first_with_a_stamp_counts_and_later_fields_follow():
    nested = part(3, part(1, b"Inner") + field(1, TIMESTAMP))
    types = descriptors("a", message_type("Outer", field(4, ".a.Outer.Inner"), field(2, TIMESTAMP), nested))
    assert protobuf_stamp("a.Outer", types, part(4, b"") + part(4, part(1, timestamp()))) == STAMP_NS
    assert protobuf_stamp("a.Outer", types, part(2, timestamp(5, 0)) + part(4, part(1, timestamp()))) == STAMP_NS
    assert protobuf_stamp("a.Outer", types, part(2, timestamp(5, 0)) + part(4, b"")) == 5 * 10**9
    assert protobuf_stamp("a.Outer", types, b"") is None
    assert protobuf_stamp("a.Missing", types, part(2, timestamp())) is None
    endless = descriptors("a", message_type("Outer", field(1, ".a.Outer"), field(2, TIMESTAMP)))
    assert protobuf_stamp("a.Outer", endless, part(1, part(2, timestamp()))) == STAMP_NS


@given(content=st.binary(max_size=60), data=st.binary(max_size=60))
def test_any_bytes_are_no_error(content, data):
    protobuf_stamp("a.T0", content, data)
    protobuf_stamp("a.T0", descriptors("a", message_type("T0", field(1, TIMESTAMP))), data)
    stamps_of(RecordedTopic("/t", "X", "json")).read(data)


@pytest.mark.parametrize(
    ("data", "stamp_ns"),
    [
        ({"timestamp": {"sec": SECONDS, "nsec": NANOSECONDS}}, STAMP_NS),
        ({"header": {"frame_id": "a", "stamp": {"nanosec": NANOSECONDS, "sec": SECONDS}}}, STAMP_NS),
        ({"x": [{"stamp": 5}], "y": {"stamp": {"sec": 1}}, "timestamp": {"secs": 7, "nsecs": 1}}, 7 * 10**9 + 1),
        ({"text": '"stamp": {"sec": 1, "nsec": 2}'}, None),
        ({"stamp": {"sec": 0, "nsec": 0}}, None),
        ({"stamp": {"sec": 1.5, "nsec": 0}}, None),
    ],
)
@pytest.mark.parametrize("indent", [None, 2])
def test_json_has_a_stamp_with_seconds_and_nanoseconds(data, stamp_ns, indent):
    assert stamps_of(RecordedTopic("/t", "X", "json")).read(json.dumps(data, indent=indent).encode()) == stamp_ns


def test_a_schema_without_a_stamp_has_none():
    schema = json.dumps({"type": "object", "properties": {"value": {"type": "number"}}})
    assert stamps_of(RecordedTopic("/t", "X", "json", schema, "jsonschema")) is None


MAKERS = {"Imu": imu, "Image": image, "PointCloud2": points}


@pytest.mark.parametrize("name", MAKERS)
@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
@pytest.mark.parametrize("text_of", ["", "ros2msg"])
def test_bytes_of_ros_1_are_not_read_by_a_definition_of_ros_2(name, encoding, text_of):
    store, make = (ROS2, ROS2.serialize_cdr) if encoding == "cdr" else (ROS1, ROS1.serialize_ros1)
    message = MAKERS[name](3, store)
    kind = f"sensor_msgs/msg/{name}"
    text = ROS2.generate_msgdef(kind)[0] if text_of else ""
    stamps = stamps_of(RecordedTopic("/t", kind, encoding, text, text_of))
    data = bytes(make(message, kind))
    stamp = message.header.stamp
    assert stamps.read(data) == stamp.sec * 10**9 + stamp.nanosec
    assert stamps.place is not None
    assert stamps.has_header
    assert struct.unpack_from("<II", data, stamps.place.at) == (stamp.sec, stamp.nanosec)


PLACES = {
    "float64 x\nstd_msgs/Header header": (12, None),
    "uint8 x\nuint8[3] y\nfloat64 z\nbuiltin_interfaces/Time t\nstd_msgs/Header header": (28, None),
    "std_msgs/Header[] headers": (8, 4),
    "std_msgs/Header[2] headers": (4, None),
    "string name\nstd_msgs/Header header": None,
    "uint8[] data\nstd_msgs/Header header": None,
    "uint8[<=4] data\nstd_msgs/Header header": None,
    "builtin_interfaces/Time stamp\nstring name": (4, None),
}


@pytest.mark.parametrize("definition", PLACES)
def test_a_stamp_has_a_fixed_place_unless_values_of_any_length_precede_it(definition):
    stamps = stamps_of(RecordedTopic("/t", "a/msg/B", "cdr", definition, "ros2msg"))
    assert (stamps.place and tuple(stamps.place)) == PLACES[definition]
    if stamps.place:
        data = bytearray(b"\0\1\0\0" + bytes(60))
        if stamps.place.count_at is not None:
            data[stamps.place.count_at] = 1
        struct.pack_into("<iI", data, stamps.place.at, SECONDS, NANOSECONDS)
        assert stamps.read(bytes(data)) == STAMP_NS


def test_a_header_by_itself_has_its_stamp():
    data = bytes(ROS2.serialize_cdr(header(stamp_ns=STAMP_NS), "std_msgs/msg/Header"))
    assert stamps_of(RecordedTopic("/t", "std_msgs/msg/Header", "cdr")).read(data) == STAMP_NS
