"""What a ping can send: data of our making, files, bags; one file each, and the types that a relay serves."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dds_trace.tracefile import OptionError

from . import bag, file
from .binary import BINARY
from .foreign import OWN_TYPES
from .header import header_data_type
from .imu import IMU
from .string import STRING
from .topic import open_payload as open_live_payload

if TYPE_CHECKING:
    from collections.abc import Iterable

    from .base import DataType, Payload

DATA_TYPES = {data_type.name: data_type for data_type in (BINARY, STRING, IMU)}
"""By the name that `--data` takes and the trace keeps; a relay serves all of them at once."""

SOURCES = {"file": file.load_payload, "bag": bag.load_payload}
"""By what stands before the colon in `--data`; each makes the payload of what stands behind it."""


def data_type_called(name: str) -> DataType:
    """The data type `name`.

    Raises:
        OptionError: there is none.
    """
    if name not in DATA_TYPES:
        raise OptionError(
            f"there is no data type {name!r}; choose one of {', '.join(DATA_TYPES)}, or write file:PATH, "
            "bag:PATH#TOPIC or topic:/NAME"
        )
    return DATA_TYPES[name]


def load_payload(data: str, size_bytes: int | None, seed: int) -> Payload:
    """The messages that `--data` means, made up with the seed or read from a file or bag.

    Raises:
        OptionError: there is no such data, or it has a size of its own and another was asked for.
        BackendUnavailableError: reading it takes a package that is not installed.
    """
    kind, colon, where = data.partition(":")
    if not colon or kind not in SOURCES:
        return data_type_called(data).make(size_bytes, seed)
    if size_bytes is not None:
        raise OptionError(
            f"--size {size_bytes}: the messages of {data} have sizes of their own; leave --size out"
        )
    return SOURCES[kind](where)


def served_data_types(type_names: Iterable[str] = ()) -> tuple[DataType, ...]:
    """What a relay serves: the three of our making, and data of further message types.

    Raises:
        OptionError: one of `type_names` is no name of a message type.
    """
    further = dict.fromkeys(name for name in type_names if name not in OWN_TYPES)
    return (*DATA_TYPES.values(), *map(header_data_type, further))


__all__ = [
    "BINARY",
    "DATA_TYPES",
    "IMU",
    "SOURCES",
    "STRING",
    "data_type_called",
    "header_data_type",
    "load_payload",
    "open_live_payload",
    "served_data_types",
]
