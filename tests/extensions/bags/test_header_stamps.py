import struct

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from dds_trace.extensions.bags.header_stamps import parse_definition, stamp_reader

STORE, STORE_OF_ROS1 = get_typestore(Stores.ROS2_JAZZY), get_typestore(Stores.ROS1_NOETIC)
STAMP_NS = 1_700_000_000_123_456_789
STORE_OF_ROS1.register({"tf2_msgs/msg/TFMessage": STORE.fielddefs["tf2_msgs/msg/TFMessage"]})


def header(store, stamp_ns=STAMP_NS, **fields):
    time = store.types["builtin_interfaces/msg/Time"]
    return store.types["std_msgs/msg/Header"](
        stamp=time(stamp_ns // 10**9, stamp_ns % 10**9), frame_id="a frame", **fields
    )


def transforms(store, count, **fields):
    types = store.types
    transform = types["geometry_msgs/msg/Transform"](
        types["geometry_msgs/msg/Vector3"](1, 2, 3), types["geometry_msgs/msg/Quaternion"](0, 0, 0, 1)
    )
    return types["tf2_msgs/msg/TFMessage"](
        [
            types["geometry_msgs/msg/TransformStamped"](header(store, STAMP_NS + n, **fields), "child", transform)
            for n in range(count)
        ]
    )


def pose_array(store, **fields):
    types = store.types
    return types["nav_msgs/msg/Path"](header(store, STAMP_NS, **fields), [])


def definition_of(name, store, version):
    text, _ = store.generate_msgdef(name, ros_version=version)
    return text


def cdr_of(message, name):
    return bytes(STORE.serialize_cdr(message, name))


def ros1_of(message, name):
    return bytes(STORE_OF_ROS1.serialize_ros1(message, name))


@pytest.mark.parametrize("name", ["tf2_msgs/msg/TFMessage", "nav_msgs/msg/Path"])
def test_the_first_header_counts_in_both_encodings(name):
    make = transforms if "TF" in name else lambda store, _count, **fields: pose_array(store, **fields)
    message, of_ros1 = make(STORE, 3), make(STORE_OF_ROS1, 3, seq=7)
    read = stamp_reader(name, definition_of(name, STORE, 2), "cdr")
    assert read(cdr_of(message, name)) == STAMP_NS
    read = stamp_reader(name, definition_of(name, STORE_OF_ROS1, 1), "ros1")
    assert read(ros1_of(of_ros1, name)) == STAMP_NS


def test_an_empty_array_has_no_stamp():
    name = "tf2_msgs/msg/TFMessage"
    read = stamp_reader(name, definition_of(name, STORE, 2), "cdr")
    assert read(cdr_of(transforms(STORE, 0), name)) is None


DEEP = """\
string name  # of any length
wild/Box[<=3] boxes
float64[2] pair
wild/Inner[] inner
int32 LIMIT = 3
================================================================================
MSG: wild/Box
uint8 side
float64 width
================================================================================
MSG: wild/Inner
bool is_there
Header header
"""


@pytest.mark.parametrize(("order", "mark", "widest"), [("<", 1, 8), (">", 0, 8), ("<", 7, 4), (">", 6, 4)])
@pytest.mark.parametrize("boxes", [0, 1, 2])
def test_what_precedes_is_passed_over_in_every_byte_order_and_version(order, mark, widest, boxes):
    body = bytearray()

    def put(code, value):
        size = struct.calcsize(code)
        body.extend(bytes(-len(body) % min(size, widest)))
        body.extend(struct.pack(order + code, value))

    def put_size():
        if widest == 4:
            put("I", 0)

    put("I", 4)
    body.extend(b"abc\0")
    put_size()
    put("I", boxes)
    for _ in range(boxes):
        put("B", 1)
        put("d", 0.5)
    put("d", 1.0)
    put("d", 2.0)
    put_size()
    put("I", 1)
    put("B", 1)
    put("i", STAMP_NS // 10**9)
    put("I", STAMP_NS % 10**9)
    read = stamp_reader("wild/msg/Outer", DEEP, "cdr")
    assert read(bytes([0, mark, 0, 0]) + bytes(body)) == STAMP_NS
    assert read(bytes([0, mark, 0, 0]) + bytes(body[:-1])) is None


@pytest.mark.parametrize(
    ("definition", "is_found"),
    [
        ("std_msgs/Header header\nfloat64 x\n", True),
        ("std_msgs/msg/Header header", True),
        ("Header header", True),
        ("# text\n\nint32 A = 3\nbuiltin_interfaces/Time stamp\n", True),
        ("time stamp\n", True),
        ("float64 x\nstd_msgs/Header header\n", True),
        ("std_msgs/Header[] headers\n", True),
        ("string<=10 name\nHeader header\n", True),
        ("float64 x\nbuiltin_interfaces/Time when\n", False),
        ("string HEADER=Header header\nfloat64 x\n", False),
        ("unknown/Type x\n", False),
        ("", False),
    ],
)
def test_types_with_and_without_a_stamp(definition, is_found):
    assert (stamp_reader("a/msg/B", definition, "cdr") is not None) == is_found
    assert stamp_reader("a/msg/B", definition, "json") is None


def test_a_type_that_contains_itself_and_a_count_beyond_the_message_are_no_stamp():
    endless = "a/B[] more\nHeader header\n"
    read = stamp_reader("a/msg/B", endless, "cdr")
    assert read(b"\0\1\0\0" + struct.pack("<I", 1) * 4000) is None
    assert read(b"\0\1\0\0" + struct.pack("<I", 2**32 - 1)) is None
    many = "a/C[4000000] c\nHeader h\n=====\nMSG: a/C\nuint8 X=1\n"
    assert stamp_reader("a/msg/B", many, "cdr")(b"\0\1\0\0") is None


def test_a_stamp_of_zero_was_never_set():
    read = stamp_reader("a/msg/B", "Header header\n", "cdr")
    assert read(b"\0\1\0\0" + bytes(12)) is None


def test_fields_are_parsed_line_by_line():
    types = parse_definition("a/msg/B", "a/C[<=3] c 5\nfloat32[9] k\n???\nstring S=a b\nC d\n===\nMSG: a/C\nint8 x\n")
    assert [tuple(one) for one in types["a/B"]] == [("c", "a/C", -1), ("k", "float32", 9), ("d", "a/C", None)]
    assert [tuple(one) for one in types["a/C"]] == [("x", "int8", None)]


def test_arrays_of_numbers_are_passed_over_at_once():
    name = "sensor_msgs/msg/CameraInfo"
    types = STORE.types
    info = types[name](
        header(STORE), 1, 2, "plumb_bob", np.zeros(5), np.zeros(9), np.zeros(9), np.zeros(12), 0, 0,
        types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
    )  # fmt: skip
    definition = (
        "float64[1000] first\nsensor_msgs/CameraInfo info\n"
        + "=" * 80
        + f"\nMSG: sensor_msgs/CameraInfo\n{definition_of(name, STORE, 2)}"
    )
    read = stamp_reader("a/msg/B", definition, "cdr")
    data = cdr_of(info, name)
    assert read(data[:4] + bytes(8000) + data[4:]) == STAMP_NS
