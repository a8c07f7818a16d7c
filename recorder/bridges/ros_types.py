"""Message types as RTI's XML type definitions, for bridges that cannot do without."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING

from ..backends.dds_types import DDS_TYPES, dds_name, split_type
from .texts import element

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

RTI_NAMES = {"uint8": "byte", "bool": "boolean"}
"""Plain types that RTI's XML calls otherwise than ROS does."""


def rti_types(type_names: list[str]) -> tuple[Element, ...]:
    """A `types` element that defines `type_names` and all that they are made of, nothing if none is known here.

    A type that is not known here is left for the program to learn from the nodes that it discovers.
    """
    needed: set[str] = set()
    for name in type_names:
        _collect(name, needed)
    packages = groupby(filter(needed.__contains__, DDS_TYPES), key=lambda name: name.split("/")[0])
    modules = [_package(package, list(names)) for package, names in packages]
    return (element("types", *modules),) if modules else ()


def _collect(name: str, needed: set[str]) -> None:
    if name in DDS_TYPES:
        needed.add(name)
        for text in DDS_TYPES[name].values():
            _collect(split_type(text)[0], needed)


def _package(package: str, names: list[str]) -> Element:
    inner = element("module", *map(_struct, names), name="dds_")
    return element("module", element("module", inner, name="msg"), name=package)


def _struct(name: str) -> Element:
    members = (_member(member, text) for member, text in DDS_TYPES[name].items())
    return element("struct", *members, name=dds_name(name)[2])


def _member(name: str, text: str) -> Element:
    kind, length = split_type(text)
    attributes = {"name": name, "type": RTI_NAMES.get(kind, kind)}
    if kind in DDS_TYPES:
        package, _, plain = dds_name(kind)
        attributes |= {"type": "nonBasic", "nonBasicTypeName": f"{package}::msg::dds_::{plain}"}
    if kind == "string":
        attributes["stringMaxLength"] = "-1"
    if length is not None:
        attributes |= {"arrayDimensions": str(length)} if length else {"sequenceMaxLength": "-1"}
    return element("member", **attributes)
