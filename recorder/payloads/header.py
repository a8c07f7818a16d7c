"""Any other type that begins with a `std_msgs/msg/Header`: the stamp is in `header.frame_id`, the rest is data."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from dds_trace.tracefile import OptionError

from ..backends.base import Serialization
from .base import DataType
from .stamp import RAW_HEADER_STAMP

if TYPE_CHECKING:
    from ..backends.base import RawMessage
    from .base import Payload

HEADER_BYTES = 64
"""Encapsulation 4, time 8, length of frame_id 4, our stamp and its zero 47; rounded up to four."""
_TYPE_NAME = re.compile(r"([a-z][a-z0-9_]*)/msg/([A-Z][A-Za-z0-9]*)")


def header_data_type(type_name: str) -> DataType:
    """The data type of messages of `type_name`, on the topic `data_PACKAGE_TYPE`.

    Raises:
        OptionError: that is no name of a message type.
    """
    match = _TYPE_NAME.fullmatch(type_name)
    if match is None:
        raise OptionError(f"{type_name!r} is no message type; write it as sensor_msgs/msg/PointCloud2")
    return DataType(
        name=match[2].lower(),
        topic=f"data_{match[1]}_{match[2]}",
        type_name=type_name,
        stamps={Serialization.RAW: RAW_HEADER_STAMP},
        make=_refuse_to_make,
        payload_bytes_of={Serialization.RAW: payload_bytes_of},
    )


def payload_bytes_of(message: RawMessage) -> int:
    """Serialized bytes behind the header, rounded up to four as some vendors fill them up on the way."""
    return max(len(message) + -len(message) % 4 - HEADER_BYTES, 0)


def _refuse_to_make(_size_bytes: int | None, _seed: int) -> Payload:
    raise OptionError("only binary, string and imu can be made up; give --data bag:PATH#TOPIC or topic:/NAME")
