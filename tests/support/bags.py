"""Bags as other programs record them, made with rosbags: ROS 1, ROS 2 folders, single MCAP files."""

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

ROS2 = get_typestore(Stores.ROS2_JAZZY)
ROS1 = get_typestore(Stores.ROS1_NOETIC)
PERIOD_NS = 20_000_000
"""Between two messages of a bag: 50 Hz."""


def header(store: Any = ROS2, frame_id: str = "lidar_link", stamp_ns: int = 1_700_000_000_000_000_006) -> Any:
    time = store.types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 1_000_000_000))
    more = {"seq": 9} if store is ROS1 else {}
    return store.types["std_msgs/msg/Header"](stamp=time, frame_id=frame_id, **more)


def points(count: int, store: Any = ROS2) -> Any:
    field = store.types["sensor_msgs/msg/PointField"]
    return store.types["sensor_msgs/msg/PointCloud2"](
        header=header(store),
        height=1,
        width=count,
        fields=[field(name=name, offset=4 * n, datatype=7, count=1) for n, name in enumerate("xyz")],
        is_bigendian=False,
        point_step=16,
        row_step=16 * count,
        data=np.random.default_rng(count).integers(0, 256, 16 * count, np.uint8),
        is_dense=True,
    )


def image(count: int, store: Any = ROS2) -> Any:
    return store.types["sensor_msgs/msg/Image"](
        header=header(store, "camera"),
        height=count,
        width=10,
        encoding="rgb8",
        is_bigendian=0,
        step=30,
        data=np.full(30 * count, count, np.uint8),
    )


def jpeg(count: int, store: Any = ROS2) -> Any:
    return store.types["sensor_msgs/msg/CompressedImage"](
        header=header(store), format="jpeg", data=np.full(count, 7, np.uint8)
    )


def imu(yaw: float, store: Any = ROS2, **stamped: Any) -> Any:
    vector, quaternion = (store.types[f"geometry_msgs/msg/{name}"] for name in ("Vector3", "Quaternion"))
    return store.types["sensor_msgs/msg/Imu"](
        header=header(store, **stamped),
        orientation=quaternion(0.0, 0.0, yaw, 1.0),
        orientation_covariance=np.zeros(9),
        angular_velocity=vector(1.0, 2.0, 3.0),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(4.0, 5.0, 6.0),
        linear_acceleration_covariance=np.zeros(9),
    )


def text(data: str, store: Any = ROS2) -> Any:
    return store.types["std_msgs/msg/String"](data=data)


def write_bag2(
    path: Path,
    topics: dict[str, Sequence[Any]],
    plugin: StoragePlugin = StoragePlugin.MCAP,
    mode: CompressionMode = CompressionMode.NONE,
    times_ns: Sequence[int] | None = None,
) -> Path:
    """A rosbag2 folder with the messages of each topic, logged at these times or at 50 Hz; the folder."""
    bag = Writer2(path, version=9, storage_plugin=plugin)
    if mode is not CompressionMode.NONE:
        bag.set_compression(mode, CompressionFormat.ZSTD)
    _write(bag, topics, ROS2, ROS2.serialize_cdr, times_ns)
    return path


def write_bag1(
    path: Path,
    topics: dict[str, Sequence[Any]],
    compression: Writer1.CompressionFormat | None = None,
    times_ns: Sequence[int] | None = None,
) -> Path:
    bag = Writer1(path)
    if compression is not None:
        bag.set_compression(compression)
    _write(bag, topics, ROS1, ROS1.serialize_ros1, times_ns)
    return path


def _write(bag: Any, topics: dict[str, Sequence[Any]], store: Any, serialize: Any, times_ns: Any) -> None:
    with bag:
        for topic, messages in topics.items():
            connection = bag.add_connection(topic, messages[0].__msgtype__, typestore=store)
            for n, message in enumerate(messages):
                log_ns = 1_700_000_000_000_000_000 + n * PERIOD_NS if times_ns is None else times_ns[n]
                bag.write(connection, log_ns, serialize(message, message.__msgtype__))


def record(data: bytes = b"", **fields: bytes) -> bytes:
    """A record of a ROS 1 bag."""
    values = [f"{name}=".encode() + value for name, value in fields.items()]
    header = b"".join(struct.pack("<I", len(value)) + value for value in values)
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def chunk(data: bytes) -> bytes:
    return record(data, op=b"\5", compression=b"none", size=struct.pack("<I", len(data)))
