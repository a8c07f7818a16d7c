"""The stamp that a tap reads of messages of any type, against rosbags' serializer."""

from __future__ import annotations

import pytest
from rosbags.typesys import Stores, get_typestore

from dds_trace.recorder.tap.tap import definition_of, reader_of

STORE = get_typestore(Stores.LATEST)
T = STORE.types


def nobody_knows(_type_name):
    return None


def header(sec, nanosec):
    return T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](sec, nanosec), "map")


def transforms(*stamps):
    zero, unit = T["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0), T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    stamped, transform = T["geometry_msgs/msg/TransformStamped"], T["geometry_msgs/msg/Transform"](zero, unit)
    return T["tf2_msgs/msg/TFMessage"]([stamped(header(*stamp), "child", transform) for stamp in stamps])


POINT = T["geometry_msgs/msg/PointStamped"](header(7, 8), T["geometry_msgs/msg/Point"](1.0, 2.0, 3.0))
AS_RCLPY = {
    "geometry_msgs/msg/PointStamped": {"header": "std_msgs/Header", "point": "geometry_msgs/Point"},
    "tf2_msgs/msg/TFMessage": {"transforms": "sequence<geometry_msgs/TransformStamped>"},
    "geometry_msgs/msg/TransformStamped": {"header": "std_msgs/Header", "child_frame_id": "string"},
}


@pytest.mark.parametrize("little_endian", [True, False])
@pytest.mark.parametrize("members", [nobody_knows, AS_RCLPY.get])
@pytest.mark.parametrize(("message", "stamp_ns"), [(POINT, 7_000_000_008), (transforms((5, 6), (9, 9)), 5_000_000_006)])
def test_the_first_stamp_is_read(message, stamp_ns, members, little_endian):
    data = bytes(STORE.serialize_cdr(message, message.__msgtype__, little_endian=little_endian))
    assert reader_of(message.__msgtype__, members)(data) == stamp_ns


def test_a_sequence_without_elements_has_no_stamp():
    data = bytes(STORE.serialize_cdr(transforms(), "tf2_msgs/msg/TFMessage"))
    assert not reader_of("tf2_msgs/msg/TFMessage", nobody_knows)(data)


@pytest.mark.parametrize(
    "type_name", ["std_msgs/msg/String", "geometry_msgs/msg/Twist", "my_msgs/msg/Unknown", "Square"]
)
def test_other_types_have_none(type_name):
    assert reader_of(type_name, nobody_knows) is None


@pytest.mark.parametrize(
    "first",
    [
        "double[36]",
        "sequence<uint8, 10>",
        "string<10>",
        "sequence<double>",
        "boolean",
        "float",
        "b/B[2]",
        "uint8[]",
        "string",
    ],
)
def test_members_as_rclpy_spells_them_are_passed_over(first):
    definitions = {"a/msg/A": {"first": first, "header": "std_msgs/Header"}, "b/msg/B": {"x": "double"}}
    read = reader_of("a/msg/A", definitions.get)
    head = (5).to_bytes(4, "little") + (6).to_bytes(4, "little") + bytes(8)
    width = {"double[36]": 288, "b/B[2]": 16}.get(first, 4)  # a sequence and a string of no elements, a padded flag
    assert read(b"\0\1\0\0" + bytes(width) + head) == 5_000_000_006


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0", b"\0\1\0\0\1\0\0\0\0\0\0"])
def test_what_is_cut_short_has_none(data):
    assert not reader_of("geometry_msgs/msg/PointStamped", nobody_knows)(data)


def test_the_text_of_a_type_has_all_that_it_is_made_of():
    members = {
        "my_msgs/msg/Scan": {"header": "std_msgs/Header", "ranges": "sequence<double, 3>", "name": "string<10>"},
        "my_msgs/msg/Odd": {"left": "my_msgs/Unknown"},
    }
    text = definition_of("my_msgs/msg/Scan", members.get)
    first, second, third = text.split(f"{'=' * 80}\n")
    assert first.split() == ["std_msgs/Header", "header", "float64[]", "ranges", "string", "name"]
    assert second.splitlines()[0] == "MSG: std_msgs/Header"
    assert third.splitlines()[0] == "MSG: builtin_interfaces/Time"
    assert definition_of("my_msgs/msg/Odd", members.get) == ""
