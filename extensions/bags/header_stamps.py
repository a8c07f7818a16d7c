"""The header stamp of a message of any type, the first `std_msgs/Header` at any depth or a leading time; rosbag2's counts."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from importlib.util import find_spec
from typing import NamedTuple

_HEADER, _TIME = "std_msgs/Header", "builtin_interfaces/Time"
_SIZES = {
    **dict.fromkeys(("bool", "byte", "char", "int8", "uint8", "octet"), 1),
    **dict.fromkeys(("int16", "uint16"), 2),
    **dict.fromkeys(("int32", "uint32", "float32"), 4),
    **dict.fromkeys(("int64", "uint64", "float64"), 8),
    "float128": 16,
}
_TIMES_OF_ROS1 = {"time": "builtin_interfaces/Time", "duration": "builtin_interfaces/Duration"}
_PAIR_OF_32_BITS = frozenset({"builtin_interfaces/Time", "builtin_interfaces/Duration"})
MOST_STEPS = 10_000
"""Elements or fields that are passed over before the stamp of one message."""


class Field(NamedTuple):
    """A field of a message type; `length` is of an array, None of a single value, -1 of a sequence."""

    name: str
    type: str
    length: int | None


Fields = tuple[Field, ...]

_HEADERS: dict[str, Fields] = {
    "cdr": (Field("stamp", _TIME, None), Field("frame_id", "string", None)),
    "ros1": (Field("seq", "uint32", None), Field("stamp", _TIME, None), Field("frame_id", "string", None)),
}
"""Fields of a header by encoding."""

_FIELD = re.compile(
    r"\s*(?P<type>[A-Za-z]\w*(?:/\w+){0,2})(?:<=\d+)?(?P<array>\[(?:<=)?\d{0,9}\])?\s+(?P<name>[A-Za-z]\w*)(?!\s*=)\b.*"
)
_SECTION = re.compile(r"\s*MSG:\s*(\S+)\s*")


def plain_name(name: str) -> str:
    package, _, remainder = name.partition("/")
    return f"{package}/{remainder.rpartition('/')[2]}" if remainder else name


def parse_definition(name: str, text: str) -> dict[str, Fields]:
    """Return the fields of a type and of those that follow it in the text of its `.msg` file, by `package/Type`."""
    types: dict[str, list[Field]] = {}
    own = fields = types.setdefault(plain_name(name), [])
    package = name.partition("/")[0]
    for line in text.splitlines():
        if section := _SECTION.fullmatch(line):
            package = section[1].partition("/")[0]
            fields = types.setdefault(plain_name(section[1]), [])
            if fields is own:
                fields = []
        elif match := _FIELD.fullmatch(line.partition("#")[0].rstrip()):
            array = match["array"]
            length = None if array is None else int(array[1:-1]) if array[1:-1].isdigit() else -1
            fields.append(Field(match["name"], _full_name(match["type"], package), length))
    return {key: tuple(value) for key, value in types.items()}


def _full_name(name: str, package: str) -> str:
    if name in _SIZES or name in {"string", "wstring"}:
        return name
    if name == "Header":
        return _HEADER
    return _TIMES_OF_ROS1.get(name) or plain_name(name if "/" in name else f"{package}/{name}")


def _with_header(types: Mapping[str, Fields], name: str) -> frozenset[str]:
    pending, parts = [name], dict[str, Fields]()
    while pending:
        type_name = pending.pop()
        if type_name not in parts:
            parts[type_name] = types.get(type_name) or ()
            pending += [part.type for part in parts[type_name]]
    containing = parts.keys() & {_HEADER}
    while (
        more := {kind for kind, fields in parts.items() if any(part.type in containing for part in fields)} - containing
    ):
        containing |= more
    return frozenset(containing)


@cache
def known_definition(name: str, encoding: str = "cdr") -> str:
    """Return the definition of a type of ROS 2, or of ROS 1 for `ros1`, with its parts; empty for others, and without rosbags."""
    if find_spec("rosbags") is None:
        return ""
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 - optional

    is_ros1 = encoding == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.LATEST)
    return store.generate_msgdef(name, ros_version=1 if is_ros1 else 2)[0] if name in store.fielddefs else ""


class StampPlace(NamedTuple):
    """Offset of the stamp in each message of a type; `count_at` is the one of a sequence that must not be empty."""

    at: int
    count_at: int | None = None


class _MessageType(NamedTuple):
    name: str
    types: Mapping[str, Fields]
    with_header: frozenset[str]
    leads: bool


def _stamped_type(name: str, definition: str, encoding: str) -> _MessageType | None:
    if encoding not in _HEADERS:
        return None
    types = {**parse_definition(name, definition), _HEADER: _HEADERS[encoding]}
    plain = plain_name(name)
    fields = types[plain]
    if not fields:
        return None
    leads = fields[0].type == _TIME and fields[0].length is None
    with_header = _with_header(types, plain)
    return _MessageType(plain, types, with_header, leads) if leads or with_header else None


def stamp_place(name: str, definition: str, encoding: str) -> StampPlace | None:
    """Return where plain CDR of version 1, or ROS 1, has the stamp that `stamp_reader` reads; None where values of any length precede it."""
    stamped = _stamped_type(name, definition, encoding)
    if stamped is None:
        return None
    walk = _PlaceWalk(bytes([0, 1, 0, 0]), stamped.types, stamped.with_header, is_cdr=encoding == "cdr")
    with suppress(ValueError, RecursionError):
        try:
            _ = walk.time() if stamped.leads else walk.stamp_of(stamped.name)
        except _FoundPlaceError:
            walk.align(4)
            return StampPlace(walk.at, walk.count_at)
    return None


def stamp_reader(name: str, definition: str, encoding: str) -> Callable[[bytes], int | None] | None:
    """Return a function that reads the stamp of a serialized message in ns, None where it has none; None for a type without.

    `encoding` is `cdr` or `ros1`, `definition` the text of the type. Of several headers, as in an array, the first counts.
    """
    stamped = _stamped_type(name, definition, encoding)
    if stamped is None:
        return None

    def read(data: bytes) -> int | None:
        try:
            walk = _Walk(data, stamped.types, stamped.with_header, is_cdr=encoding == "cdr")
            stamp_ns = walk.time() if stamped.leads else walk.stamp_of(stamped.name)
        except (struct.error, ValueError, RecursionError):
            return None
        return stamp_ns or None

    return read


_CDR_ORDER = {0: (">", 8), 1: ("<", 8), 6: (">", 4), 7: ("<", 4)}
"""Byte order and largest alignment by the second byte of the encapsulation: plain CDR, version 1 and 2 (OMG DDS-XTypes 1.3, 7.6.3.1.2)."""


@dataclass(slots=True)
class _Walk:
    data: bytes
    types: Mapping[str, Fields] = field(default_factory=dict)
    with_header: frozenset[str] = frozenset()
    is_cdr: bool = True
    at: int = 0
    order: str = "<"
    widest: int = 1
    steps: int = field(default=MOST_STEPS)

    def __post_init__(self) -> None:
        if self.is_cdr:
            if len(self.data) < 4 or self.data[0] or self.data[1] not in _CDR_ORDER:
                raise ValueError("not plain CDR")
            self.order, self.widest = _CDR_ORDER[self.data[1]]
            self.at = 4

    def align(self, size: int) -> None:
        size = min(size, self.widest)
        self.at += -(self.at - 4) % size if self.is_cdr else 0

    def number(self, kind: str = "I") -> int:
        size = struct.calcsize(kind)
        self.align(size)
        self.at += size
        (value,) = struct.unpack_from(self.order + kind, self.data, self.at - size)
        return int(value)

    def count(self) -> int:
        value = self.number()
        if value > len(self.data):
            raise ValueError("longer than the message")
        return value

    def text(self) -> bytes:
        size = self.count()
        self.at += size
        return self.data[self.at - size : self.at].rstrip(b"\0")

    def length(self, field: Field) -> int:
        """Return how many values follow; in version 2 their size comes first unless they are numbers."""
        if field.length is None:
            return 1
        if self.widest == 4 and field.type not in _SIZES:
            self.align(4)
            self.at += 4
        return field.length if field.length >= 0 else self.count()

    def time(self) -> int:
        return self.number("i" if self.is_cdr else "I") * 1_000_000_000 + self.number()

    def stamp_of(self, name: str) -> int | None:
        """Return the first stamp in a value of a type that has a header somewhere, None if its sequences are empty."""
        for item in self.types.get(name) or ():
            if name == _HEADER and item.type == _TIME:
                return self.time()
            if item.type not in self.with_header:
                self.skip(item)
                continue
            for _ in range(self.length(item)):
                self.step()
                stamp_ns = self.stamp_of(item.type)
                if stamp_ns is not None:
                    return stamp_ns
        return None

    def step(self) -> None:
        self.steps -= 1
        if self.steps < 0:
            raise ValueError("too much before the stamp")

    def skip(self, field: Field) -> None:
        length, size = self.length(field), _SIZES.get(field.type)
        if size is not None:
            if length:
                self.align(size)
                self.at += size * length
            return
        for _ in range(length):
            self.step()
            if field.type == "string":
                self.text()
            elif field.type in _PAIR_OF_32_BITS:
                self.align(4)
                self.at += 8
            else:
                fields = self.types.get(field.type)
                if fields is None:
                    raise ValueError("unknown type")
                self.at += not fields and self.is_cdr  # an empty structure has one byte
                for inner in fields:
                    self.skip(inner)


class _FoundPlaceError(Exception):
    """The walk is at the stamp."""


@dataclass(slots=True)
class _PlaceWalk(_Walk):
    """The walk without a message: the first sequence with a header has an element, and any other value of variable length ends it."""

    count_at: int | None = None

    def time(self) -> int:
        raise _FoundPlaceError

    def text(self) -> bytes:
        raise ValueError("of variable length")

    def count(self) -> int:
        if self.count_at is not None:
            raise ValueError("of variable length")
        self.align(4)
        self.count_at = self.at
        self.at += 4
        return 1

    def skip(self, field: Field) -> None:
        if field.length == -1:
            raise ValueError("of variable length")
        _Walk.skip(self, field)


def lost_by_recorder(data: bytes) -> Iterator[tuple[str, int, int]]:
    """Yield the topics of a `MessagesLostEvent` with their messages lost on the way and in the recorder."""
    with suppress(struct.error, ValueError):
        event = _Walk(data)
        event.text()  # the node
        for _ in range(event.count()):
            yield event.text().decode(errors="replace"), event.number("Q"), event.number("Q")
