"""ROS message types and names in DDS, for what speaks DDS without ROS."""

from __future__ import annotations

import re

from dds_trace.base.errors import OptionError

_OCTETS, _COVARIANCE = "uint8[]", "float64[9]"

DDS_TYPES: dict[str, dict[str, str]] = {
    "builtin_interfaces/msg/Time": {"sec": "int32", "nanosec": "uint32"},
    "std_msgs/msg/Header": {"stamp": "builtin_interfaces/msg/Time", "frame_id": "string"},
    "std_msgs/msg/String": {"data": "string"},
    "geometry_msgs/msg/Vector3": {"x": "float64", "y": "float64", "z": "float64"},
    "geometry_msgs/msg/Quaternion": {"x": "float64", "y": "float64", "z": "float64", "w": "float64"},
    "sensor_msgs/msg/Image": {
        "header": "std_msgs/msg/Header",
        "height": "uint32",
        "width": "uint32",
        "encoding": "string",
        "is_bigendian": "uint8",
        "step": "uint32",
        "data": _OCTETS,
    },
    "sensor_msgs/msg/CompressedImage": {"header": "std_msgs/msg/Header", "format": "string", "data": _OCTETS},
    "sensor_msgs/msg/Imu": {
        "header": "std_msgs/msg/Header",
        "orientation": "geometry_msgs/msg/Quaternion",
        "orientation_covariance": _COVARIANCE,
        "angular_velocity": "geometry_msgs/msg/Vector3",
        "angular_velocity_covariance": _COVARIANCE,
        "linear_acceleration": "geometry_msgs/msg/Vector3",
        "linear_acceleration_covariance": _COVARIANCE,
    },
    "sensor_msgs/msg/PointField": {"name": "string", "offset": "uint32", "datatype": "uint8", "count": "uint32"},
    "sensor_msgs/msg/PointCloud2": {
        "header": "std_msgs/msg/Header",
        "height": "uint32",
        "width": "uint32",
        "fields": "sensor_msgs/msg/PointField[]",
        "is_bigendian": "bool",
        "point_step": "uint32",
        "row_step": "uint32",
        "data": _OCTETS,
        "is_dense": "bool",
    },
    "diagnostic_msgs/msg/KeyValue": {"key": "string", "value": "string"},
    "diagnostic_msgs/msg/DiagnosticStatus": {
        "level": "uint8",
        "name": "string",
        "message": "string",
        "hardware_id": "string",
        "values": "diagnostic_msgs/msg/KeyValue[]",
    },
    "diagnostic_msgs/msg/DiagnosticArray": {
        "header": "std_msgs/msg/Header",
        "status": "diagnostic_msgs/msg/DiagnosticStatus[]",
    },
}
"""Type -> member -> type; `[]` is a sequence, `[9]` an array. A type follows its parts, as in XML."""


def split_type(text: str) -> tuple[str, int | None]:
    element, bracket, length = text.removesuffix("]").partition("[")
    return element, int(length or 0) if bracket else None


def check_type(backend: str, type_name: str) -> None:
    if type_name not in DDS_TYPES:
        names = ", ".join(name for name in DDS_TYPES if name.startswith(("sensor_msgs", "std_msgs")))
        raise OptionError(f"the backend {backend} does not know the type {type_name}; it knows {names}")


def dds_name(type_name: str) -> str:
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def ros_name(dds_type: str) -> str:
    parts = re.fullmatch(r"(\w+)::(\w+)::dds_::(\w+)_", dds_type)
    return dds_type if parts is None else "/".join(parts.groups())


def dds_topic(topic: str) -> str:
    return f"rt/{topic}"
