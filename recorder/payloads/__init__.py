"""The data that a ping can send: made up here, or read from files, bags and running topics; one file each."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING

from dds_trace.base import limits
from dds_trace.base.errors import OptionError

from .bag import BAG
from .base import DataType, Source, Surroundings
from .binary import BINARY
from .file import FILE
from .header import header_data_type
from .imu import IMU
from .string import STRING
from .topic import TOPIC

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable, Iterable

    from ..backends.node import Node
    from .base import Payload

PAYLOADS: dict[str, DataType | Source] = {
    payload.name: payload for payload in (BINARY, STRING, IMU, FILE, BAG, TOPIC)
}
"""Everything that `--data` can name, by its name or by the text before the colon."""


def data_types() -> dict[str, DataType]:
    """Return the data types that are made up here, by name; a relay serves all of them at once."""
    return {name: payload for name, payload in PAYLOADS.items() if isinstance(payload, DataType)}


def find_data_type(name: str) -> DataType:
    """Return the data type `name`.

    Raises:
        OptionError: there is none.
    """
    made = data_types()
    if name not in made:
        *usages, last = (payload.usage for payload in PAYLOADS.values() if isinstance(payload, Source))
        raise OptionError(
            f"there is no data type {limits.shown(name)}; choose one of {', '.join(made)}, or write {', '.join(usages)} or {last}"
        )
    return made[name]


def open_payload(
    data: str,
    size_bytes: int | None,
    seed: int,
    *,
    open_node: Callable[[], Node],
    wait_s: float,
    stop: threading.Event,
) -> AbstractContextManager[Payload]:
    """Open the payload that `--data` names, for as long as the block runs.

    Args:
        data: value of `--data`.
        size_bytes: application bytes of a message, None for the default of its type.
        seed: seed of random content.
        open_node: opens a node beside that of the ping, for a live source.
        wait_s: longest wait for a live source, in seconds.
        stop: ends that wait, and the making or reading of the data.

    Raises:
        StoppedError: `stop` was set before there was a message.
        OptionError: there is no such data, or it has a size of its own and another was asked for.
        BackendUnavailableError: reading it takes a package that is not installed.
    """
    kind, colon, where = data.partition(":")
    source = PAYLOADS.get(kind)
    if not colon or not isinstance(source, Source):
        return nullcontext(find_data_type(data).make(size_bytes, seed, stop))
    if size_bytes is not None:
        raise OptionError(
            f"--size {size_bytes}: the messages of {data} have sizes of their own; leave --size out"
        )
    return source.open(where, Surroundings(_own_types(), open_node, wait_s, stop))


def check_data(data: str) -> None:
    """Refuse a value of `--data` that names no data, without opening any.

    Raises:
        OptionError: there is no such data type, or the text behind the colon names nothing.
    """
    limits.check(limits.TEXT, data, "--data")
    kind, colon, where = data.partition(":")
    source = PAYLOADS.get(kind)
    if colon and isinstance(source, Source):
        source.check(where)
    else:
        find_data_type(data)


def is_live(data: str) -> bool:
    """Return whether `--data` names a running topic, whose messages are part of the surroundings."""
    kind, colon, _ = data.partition(":")
    return bool(colon) and kind == TOPIC.name


def served_data_types(type_names: Iterable[str] = ()) -> tuple[DataType, ...]:
    """Return what a relay serves: the data types that are made up here, and those of further message types.

    Raises:
        OptionError: one of `type_names` is no name of a message type.
    """
    own_types = _own_types()
    further = dict.fromkeys(name for name in type_names if name not in own_types)
    return (*data_types().values(), *map(header_data_type, further))


def _own_types() -> dict[str, DataType]:
    return {data_type.type_name: data_type for data_type in data_types().values()}


__all__ = [
    "BINARY",
    "IMU",
    "PAYLOADS",
    "STRING",
    "check_data",
    "data_types",
    "find_data_type",
    "header_data_type",
    "is_live",
    "open_payload",
    "served_data_types",
]
