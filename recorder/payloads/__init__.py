"""The data that a ping can send."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.extension import offers

from ..backends.node import Node
from .base import DataType, Payload, PayloadContext, Source
from .binary import BINARY, FILE
from .header import header_data_type
from .imu import IMU, IMU_FILE
from .string import STRING

PAYLOADS: dict[str, DataType | Source] = {
    **{data_type.name: data_type for data_type in (BINARY, STRING, IMU)},
    **{source.usage: source for source in (IMU_FILE, FILE)},
}


def data_types() -> dict[str, DataType]:
    return {name: payload for name, payload in PAYLOADS.items() if isinstance(payload, DataType)}


def find_data_type(name: str) -> DataType:
    types = data_types()
    if name not in types:
        *usages, last = (source.usage for source in sources().values())
        raise OptionError(
            f"there is no data type {limits.shown(name)}; choose one of {', '.join(types)}, or write {', '.join(usages)} or {last}"
        )
    return types[name]


def open_payload(
    data: str, size_bytes: int | None, seed: int, *, open_node: Callable[[], Node], wait_s: float, stop: threading.Event
) -> AbstractContextManager[Payload]:
    """Open the payload that `--data` names; a live source opens a second node, and waits for `wait_s` or `stop`."""
    source, name = _split_source(data)
    if source is None:
        return nullcontext(find_data_type(data).make(size_bytes, seed, stop))
    if size_bytes is not None:
        raise OptionError(f"--size {size_bytes}: the messages of {data} have sizes of their own; leave --size out")
    return source.open(name, PayloadContext(_own_types(), open_node, wait_s, stop))


def check_data(data: str) -> None:
    limits.check(limits.TEXT, data, "--data")
    source, name = _split_source(data)
    if source is None:
        find_data_type(data)
    else:
        source.check(name)


def is_live(data: str) -> bool:
    source = _split_source(data)[0]
    return source is not None and source.is_live


def sources() -> dict[str, Source]:
    local = (payload for payload in PAYLOADS.values() if isinstance(payload, Source))
    return {source.name: source for source in (*local, *(load() for load in offers("payloads").values()))}


def _split_source(data: str) -> tuple[Source | None, str]:
    kind, colon, name = data.partition(":")
    source = sources().get(kind) if colon else None
    return (source, name) if source else (None, data)


def served_data_types(type_names: Iterable[str] = ()) -> tuple[DataType, ...]:
    own_types = _own_types()
    further = dict.fromkeys(name for name in type_names if name not in own_types)
    return (*data_types().values(), *map(header_data_type, further))


def _own_types() -> dict[str, DataType]:
    return {data_type.type_name: data_type for data_type in data_types().values()}
