"""Messages that others made: which data type they are, and how our stamp gets its place in them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dds_trace.tracefile import OptionError

from .binary import BINARY
from .header import header_data_type
from .imu import IMU
from .stamp import stamp_text
from .string import STRING

if TYPE_CHECKING:
    from .base import DataType

OWN_TYPES = {data_type.type_name: data_type for data_type in (BINARY, STRING, IMU)}
"""The types that every relay serves."""


def foreign_data_type(type_name: str, first_field_type: str, where: str) -> DataType:
    """The data type of messages of `type_name`: one of our three, or one of its own.

    Args:
        type_name: ROS name of the type.
        first_field_type: of its first field, `std_msgs/msg/Header` or `std_msgs/Header` if that is the header.
        where: the messages come from, for the error.

    Raises:
        OptionError: there is no place for the stamp.
    """
    if type_name in OWN_TYPES:
        return OWN_TYPES[type_name]
    if first_field_type.replace("/msg/", "/") != "std_msgs/Header":
        raise OptionError(
            f"{where}: {type_name} does not begin with a std_msgs/Header, so it cannot carry the stamp"
        )
    return header_data_type(type_name)


def make_room(message: Any, data_type: DataType) -> None:
    """Put a stamp into a message object of others, so that serialized bytes have its 46 characters in place."""
    stamp = stamp_text(0, 0).decode()
    if data_type is STRING:
        message.data = stamp + message.data
    else:
        message.header.frame_id = stamp
