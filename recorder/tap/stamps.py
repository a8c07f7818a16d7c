"""The header stamp of a message of any type that the node, our own table, or rosbags knows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.util import find_spec

from dds_trace.tracefile.format.header_stamps import Field, Fields, plain_name, stamp_reader

from ..backends.dds_types import DDS_TYPES

Members = Callable[[str], Mapping[str, str] | None]


_PLAIN = {"double": "float64", "float": "float32", "boolean": "bool"}


def reader_of(type_name: str, members: Members) -> Callable[[bytes], int | None] | None:
    def stored(name: str) -> Fields | None:
        return _fields(name, members)

    is_stored = stored(plain_name(type_name)) is not None
    return stamp_reader(type_name, "" if is_stored else _definition(type_name), "cdr", stored)


def definition_of(type_name: str, members: Members) -> str:
    remaining, sections = [plain_name(type_name)], dict[str, str]()
    while remaining:
        name = remaining.pop(0)
        if name in sections or "/" not in name:
            continue
        fields = _fields(name, members)
        if fields is None:
            return _definition(type_name)
        sections[name] = "".join(
            f"{field.type.replace('octet', 'byte')}{_brackets(field.length)} {field.name}\n" for field in fields
        )
        remaining += [field.type for field in fields]
    first, *others = sections.items()
    return first[1] + "".join(f"{'=' * 80}\nMSG: {name}\n{text}" for name, text in others)


def _brackets(length: int | None) -> str:
    return "" if length is None else "[]" if length < 0 else f"[{length}]"


def _fields(name: str, members: Members) -> Fields | None:
    package, slash, short_name = name.partition("/")
    if not slash:
        return None
    full_name = f"{package}/msg/{short_name}"
    definition = members(full_name) or DDS_TYPES.get(full_name)
    return None if definition is None else tuple(_field(member, text) for member, text in definition.items())


def _field(name: str, text: str) -> Field:
    is_sequence = text.startswith("sequence<") or text.endswith("[]")
    element = text.removeprefix("sequence<").partition(",")[0].removesuffix("[]").removesuffix(">").partition("<")[0]
    element, bracket, length = element.partition("[")
    several = -1 if is_sequence else int(length.removesuffix("]")) if bracket else None
    return Field(name, plain_name(_PLAIN.get(element, element)), several)


def _definition(type_name: str) -> str:
    if find_spec("rosbags") is None:
        return ""
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 - optional

    store = get_typestore(Stores.LATEST)
    return store.generate_msgdef(type_name)[0] if type_name in store.fielddefs else ""
