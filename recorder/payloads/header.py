"""Messages of other programs that start with a `std_msgs/msg/Header`: our stamp is in `header.frame_id`."""

from __future__ import annotations

import re
import threading
from collections.abc import Mapping
from functools import partial

from dds_trace.base.errors import OptionError

from ..backends.node import RawMessage
from .base import DataType, Form, Payload, sized_by_length
from .stamp import HEADER_STAMP, RAW_HEADER_STAMP

HEADER_BYTES = 64
"""Offset of the data: encapsulation 4, time 8, frame_id with our stamp 4 + 47, rounded up to four."""
_TYPE_NAME = re.compile(r"([a-z][a-z0-9_]*)/msg/([A-Z][A-Za-z0-9]*)")


def header_data_type(type_name: str) -> DataType:
    match = _TYPE_NAME.fullmatch(type_name)
    if match is None:
        raise OptionError(f"{type_name!r} is not a message type; write it as sensor_msgs/msg/PointCloud2")
    return DataType(
        name=match[2].lower(),
        topic=f"data_{match[1]}_{match[2]}",
        type_name=type_name,
        raw=Form(RAW_HEADER_STAMP, payload_bytes_of, sized_by_length),
        objects=None,
        object_stamp=HEADER_STAMP,
        make=partial(_refuse_to_make, type_name),
    )


def payload_bytes_of(message: RawMessage) -> int:
    return max(len(message) + -len(message) % 4 - HEADER_BYTES, 0)


def _refuse_to_make(
    type_name: str, _size_bytes: int | None, _seed: int, _stop: threading.Event | None = None, /
) -> Payload:
    raise OptionError(f"messages of {type_name} cannot be made up; give --data bag:PATH#TOPIC or topic:/NAME instead")


def recognize_data_type(
    type_name: str, first_field_type: str, where: str, own_types: Mapping[str, DataType]
) -> DataType:
    if type_name in own_types:
        return own_types[type_name]
    if first_field_type.replace("/msg/", "/") != "std_msgs/Header":
        raise OptionError(f"{where}: {type_name} does not start with a std_msgs/Header, so it cannot carry the stamp")
    return header_data_type(type_name)
