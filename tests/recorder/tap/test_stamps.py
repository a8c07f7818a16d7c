"""Where a message of any type has its first stamp, against rosbags' serializer."""

from __future__ import annotations

import pytest
from rosbags.typesys import Stores, get_typestore

from dds_trace.recorder.tap.stamps import known_first_member, stamp_kind, stamp_reader

STORE = get_typestore(Stores.LATEST)
T = STORE.types


def header(sec, nanosec):
    return T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](sec, nanosec), "map")


def transforms(*stamps):
    zero, unit = T["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0), T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    stamped, transform = T["geometry_msgs/msg/TransformStamped"], T["geometry_msgs/msg/Transform"](zero, unit)
    return T["tf2_msgs/msg/TFMessage"]([stamped(header(*stamp), "child", transform) for stamp in stamps])


MESSAGES = {
    "header": (
        T["geometry_msgs/msg/PointStamped"](header(7, 8), T["geometry_msgs/msg/Point"](1.0, 2.0, 3.0)),
        7_000_000_008,
    ),
    "time": (T["builtin_interfaces/msg/Time"](3, 4), 3_000_000_004),
    "sequence": (transforms((5, 6), (9, 9)), 5_000_000_006),
}


@pytest.mark.parametrize("little_endian", [True, False])
@pytest.mark.parametrize("kind", MESSAGES)
def test_the_first_stamp_is_read(kind, little_endian):
    message, stamp_ns = MESSAGES[kind]
    type_name = message.__msgtype__
    assert stamp_kind(type_name, known_first_member) == kind
    data = bytes(STORE.serialize_cdr(message, type_name, little_endian=little_endian))
    assert stamp_reader(kind)(data) == stamp_ns


def test_a_sequence_without_elements_has_no_stamp():
    data = bytes(STORE.serialize_cdr(transforms(), "tf2_msgs/msg/TFMessage"))
    assert stamp_reader("sequence")(data) == 0


@pytest.mark.parametrize(
    "type_name", ["std_msgs/msg/String", "geometry_msgs/msg/Twist", "my_msgs/msg/Unknown", "std_msgs/msg/Empty"]
)
def test_other_types_have_none(type_name):
    kind = stamp_kind(type_name, known_first_member)
    assert kind is None
    assert stamp_reader(kind)(b"\0\1\0\0" + bytes(100)) == 0


@pytest.mark.parametrize(
    ("members", "kind"),
    [
        ({"a/msg/A": "std_msgs/Header"}, "header"),
        ({"a/msg/A": "b/B", "b/msg/B": "builtin_interfaces/Time"}, "time"),
        ({"a/msg/A": "sequence<b/B>", "b/msg/B": "std_msgs/Header"}, "sequence"),
        ({"a/msg/A": "sequence<b/B, 10>", "b/msg/B": "std_msgs/Header"}, "sequence"),
        ({"a/msg/A": "b/B[3]", "b/msg/B": "std_msgs/Header"}, None),
        ({"a/msg/A": "b/B", "b/msg/B": "sequence<std_msgs/Header>"}, None),
        ({"a/msg/A": "a/A"}, None),
        ({"a/msg/A": "sequence<double>"}, None),
        ({"a/msg/A": "string<10>"}, None),
    ],
)
def test_members_as_rclpy_describes_them(members, kind):
    assert stamp_kind("a/msg/A", members.get) == kind


@pytest.mark.parametrize(
    "data",
    [b"", b"\0\1\0\0", b"\0\1\0\0\1\0\0\0\0\0\0", b"\0\1\0\0\1\0\0\0\xff\xff\xff\xff", b"\0\1\0\0" + b"\xff" * 20],
)
@pytest.mark.parametrize("kind", ["header", "time", "sequence"])
def test_what_is_no_stamp_is_none(kind, data):
    assert stamp_reader(kind)(data) == 0
