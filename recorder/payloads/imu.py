"""Inertial data: a `sensor_msgs/msg/Imu` with 37 random numbers."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

from dds_trace.base.errors import OptionError

from .base import DataType, Form, Message, Payload, sized_by_length
from .cdr import CdrWriter
from .stamp import HEADER_STAMP, RAW_HEADER_STAMP, stamp_text

if TYPE_CHECKING:
    import threading

    from ..backends.node import RawMessage, RosMessage

# orientation, angular velocity and linear acceleration, each with its 3 x 3 covariance
FIELDS = (4, 9, 3, 9, 3, 9)
PAYLOAD_BYTES = 8 * sum(FIELDS)


def make_payload(size_bytes: int | None, seed: int, _stop: threading.Event | None = None, /) -> Payload:
    """Make up one message."""
    if size_bytes not in (None, PAYLOAD_BYTES):
        raise OptionError(f"--size {size_bytes}: an IMU message always has {PAYLOAD_BYTES} bytes; leave --size out")
    draw = random.Random(seed)  # noqa: S311 - reproducible noise, no secret
    writer = CdrWriter()
    writer.header(stamp_text(0, 0))
    for length in FIELDS:
        writer.float64s([draw.uniform(-1.0, 1.0) for _ in range(length)])
    return Payload(IMU, (Message(writer.message(), PAYLOAD_BYTES),), PAYLOAD_BYTES)


def payload_bytes_of(_message: RawMessage | RosMessage) -> int:
    """Return `PAYLOAD_BYTES`."""
    return PAYLOAD_BYTES


IMU = DataType(
    name="imu",
    topic="imu_data",
    type_name="sensor_msgs/msg/Imu",
    raw=Form(RAW_HEADER_STAMP, payload_bytes_of, sized_by_length),
    objects=Form(HEADER_STAMP, payload_bytes_of),
    object_stamp=HEADER_STAMP,
    make=make_payload,
)
