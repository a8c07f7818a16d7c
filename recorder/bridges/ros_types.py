"""The message types of the bridged topics as RTI's XML type definitions, for bridges that cannot do without."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING

from recorder.bridges.texts import element

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

STRING, FLOAT64, UINT32 = ("string",), ("float64",), ("uint32",)
BYTES = ("byte", "sequenceMaxLength", "-1")
COVARIANCE = ("float64", "arrayDimensions", "9")

MEMBERS: dict[str, dict[str, tuple[str, ...]]] = {
    "builtin_interfaces/msg/Time": {"sec": ("int32",), "nanosec": UINT32},
    "std_msgs/msg/Header": {"stamp": ("builtin_interfaces/msg/Time",), "frame_id": STRING},
    "std_msgs/msg/String": {"data": STRING},
    "geometry_msgs/msg/Vector3": {"x": FLOAT64, "y": FLOAT64, "z": FLOAT64},
    "geometry_msgs/msg/Quaternion": {"x": FLOAT64, "y": FLOAT64, "z": FLOAT64, "w": FLOAT64},
    "sensor_msgs/msg/Image": {
        "header": ("std_msgs/msg/Header",),
        "height": UINT32,
        "width": UINT32,
        "encoding": STRING,
        "is_bigendian": ("byte",),
        "step": UINT32,
        "data": BYTES,
    },
    "sensor_msgs/msg/Imu": {
        "header": ("std_msgs/msg/Header",),
        "orientation": ("geometry_msgs/msg/Quaternion",),
        "orientation_covariance": COVARIANCE,
        "angular_velocity": ("geometry_msgs/msg/Vector3",),
        "angular_velocity_covariance": COVARIANCE,
        "linear_acceleration": ("geometry_msgs/msg/Vector3",),
        "linear_acceleration_covariance": COVARIANCE,
    },
}
"""Type -> member -> its type and, for sequences and arrays, the attribute that says so, in the order of the .msg files.

A type stands behind those that it is made of, and the types of a package stand together.
"""


def rti_types(type_names: list[str]) -> tuple[Element, ...]:
    """A `types` element that defines `type_names` and all that they are made of, nothing if none is known here.

    A type that is not known here is left for the program to learn from the nodes that it discovers.
    """
    needed: set[str] = set()
    for name in type_names:
        _collect(name, needed)
    packages = groupby(filter(needed.__contains__, MEMBERS), key=lambda name: name.split("/")[0])
    modules = [_package(package, list(names)) for package, names in packages]
    return (element("types", *modules),) if modules else ()


def _collect(name: str, needed: set[str]) -> None:
    if name in MEMBERS:
        needed.add(name)
        for kind, *_ in MEMBERS[name].values():
            _collect(kind, needed)


def _package(package: str, names: list[str]) -> Element:
    inner = element("module", *map(_struct, names), name="dds_")
    return element("module", element("module", inner, name="msg"), name=package)


def _struct(name: str) -> Element:
    members = (_member(member, *definition) for member, definition in MEMBERS[name].items())
    return element("struct", *members, name=f"{name.rpartition('/')[2]}_")


def _member(name: str, kind: str, attribute: str | None = None, value: str = "") -> Element:
    attributes = {"name": name, "type": kind}
    if kind in MEMBERS:
        package, _, plain = kind.split("/")
        attributes |= {"type": "nonBasic", "nonBasicTypeName": f"{package}::msg::dds_::{plain}_"}
    if kind == "string":
        attributes["stringMaxLength"] = "-1"
    if attribute is not None:
        attributes[attribute] = value
    return element("member", **attributes)
