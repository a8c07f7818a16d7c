"""The first time stamp of a serialized message of any type."""

from __future__ import annotations

import struct
from functools import cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from dds_trace.base.units import SECOND_NS

from ..backends.dds_types import DDS_TYPES

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from ..backends.node import RawMessage

    FirstMember = Callable[[str], str | None]
    """Type name -> type of its first member as in a `.msg` file."""

HEADER, TIME, SEQUENCE = "header", "time", "sequence"
"""Values of `header` in a publisher's description."""
_LEAVES = {"std_msgs/msg/Header": HEADER, "builtin_interfaces/msg/Time": TIME}
_MOST_LEVELS = 16
_COUNT_AT, _STAMP_AT, _FIRST_STAMP_AT = 4, 4, 8
_COUNTS = (struct.Struct(">I"), struct.Struct("<I"))
_STAMPS = (struct.Struct(">iI"), struct.Struct("<iI"))


def stamp_kind(type_name: str, first_member: FirstMember) -> str | None:
    """Return what a message begins with: a header, a time, or a sequence of messages that begin with one; None for none of these."""
    name, is_sequence = type_name, False
    for _ in range(_MOST_LEVELS):
        if name in _LEAVES:
            return SEQUENCE if is_sequence else _LEAVES[name]
        member = first_member(name)
        if member is None:
            return None
        element = member.removeprefix("sequence<").removesuffix(">").partition(",")[0].partition("[")[0]
        if element != member:
            # Of a second sequence, or an array, the offset would depend on the content.
            is_array = member.endswith("]") and not member.endswith("[]")
            if is_array or is_sequence or name != type_name:
                return None
            is_sequence = True
        package, _, last = element.rpartition("/")
        name = f"{package.partition('/')[0]}/msg/{last}"
        if not package:
            return None
    return None


def stamp_reader(kind: str | None) -> Callable[[RawMessage], int]:
    """Return the function that reads a message's stamp, ns; 0 for none, or none that is a time."""
    if kind is None:
        return lambda _message: 0
    at = _FIRST_STAMP_AT if kind == SEQUENCE else _STAMP_AT
    is_sequence = kind == SEQUENCE

    def read(message: RawMessage) -> int:
        if len(message) < at + 8:
            return 0
        order = message[1] & 1
        if is_sequence and not _COUNTS[order].unpack_from(message, _COUNT_AT)[0]:
            return 0
        seconds, nanoseconds = _STAMPS[order].unpack_from(message, at)
        return seconds * SECOND_NS + nanoseconds if 0 <= nanoseconds < SECOND_NS and seconds >= 0 else 0

    return read


def known_first_member(type_name: str) -> str | None:
    """Return the first member's type without a node that knows it: from our own table, else from rosbags if it is installed."""
    if type_name in DDS_TYPES:
        return next(iter(DDS_TYPES[type_name].values()), None)
    if find_spec("rosbags") is None:
        return None
    from rosbags.interfaces import Nodetype  # noqa: PLC0415 - optional

    _, members = _definitions().get(type_name, ((), ()))
    kind, detail = members[0][1] if members else (None, "")
    if kind == Nodetype.NAME:
        return str(detail)
    if kind == Nodetype.SEQUENCE and detail[0][0] == Nodetype.NAME:
        return f"{detail[0][1]}[]"
    return None


@cache
def _definitions() -> Mapping[str, Any]:
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 - optional

    return get_typestore(Stores.LATEST).fielddefs
