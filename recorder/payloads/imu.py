"""Inertial data: a `sensor_msgs/msg/Imu` with 37 random numbers, or the values of a file (`imu:FILE`)."""

from __future__ import annotations

import math
import os
import random
import threading
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import BinaryIO

from dds_trace.base.errors import OptionError
from dds_trace.base.files import open_regular

from ..backends.node import RawMessage, RosMessage
from .base import MOST_PADDING_BYTES, DataType, Form, Message, Payload, Source, check_size, check_stop, sized_by_length
from .cdr import CdrWriter
from .stamp import HEADER_STAMP, RAW_HEADER_STAMP, stamp_text

# orientation, angular velocity and linear acceleration, each with its 3 x 3 covariance
FIELDS = (4, 9, 3, 9, 3, 9)
PAYLOAD_BYTES = 8 * sum(FIELDS)
MESSAGE_BYTES = 4 + 64 + PAYLOAD_BYTES  # encapsulation, header with our stamp to the next eighth byte

COLUMNS = "time in s, three angular velocities in rad/s and three accelerations in m/s^2"
_COLUMN_COUNT = 7
_NO_ORIENTATION, _UNKNOWN_COVARIANCE = (0.0, 0.0, 0.0, 1.0, -1.0, *[0.0] * 8), (0.0,) * 9
"""A covariance that starts with -1 means that there is no estimate; one of zeros, that it is unknown."""


def make_payload(size_bytes: int | None, seed: int, _stop: threading.Event | None = None, /) -> Payload:
    if size_bytes not in (None, PAYLOAD_BYTES):
        raise OptionError(f"--size {size_bytes}: an IMU message always has {PAYLOAD_BYTES} bytes; leave --size out")
    draw = random.Random(seed)  # noqa: S311 - reproducible noise, no secret
    message = _message([draw.uniform(-1.0, 1.0) for _ in range(sum(FIELDS))])
    return Payload(IMU, (message,), PAYLOAD_BYTES)


def _message(numbers: Sequence[float]) -> Message:
    writer = CdrWriter()
    writer.header(stamp_text(0, 0))
    writer.float64s(numbers)
    return Message(writer.message(), PAYLOAD_BYTES)


def load_payload(where: str, stop: threading.Event | None = None) -> Payload:
    path = Path(where)
    times_s: list[float] = []
    messages: list[Message] = []
    try:
        with open_regular(path) as stream:
            check_size(os.fstat(stream.fileno()).st_size, path)
            for time_s, *measured in _rows(stream, where):
                check_stop(stop)
                check_size(PAYLOAD_BYTES * len(messages), path)
                times_s.append(time_s)
                gyro, acceleration = measured[:3], measured[3:]
                messages.append(
                    _message([*_NO_ORIENTATION, *gyro, *_UNKNOWN_COVARIANCE, *acceleration, *_UNKNOWN_COVARIANCE])
                )
    except OSError as err:
        raise OptionError(f"--data imu:{where}: {err.strerror or err}; name a file of {COLUMNS}") from err
    if not messages:
        raise OptionError(f"--data imu:{where}: the file has no values; each row has {COLUMNS}")
    span_s = times_s[-1] - times_s[0]
    rate_hz = (len(times_s) - 1) / span_s if span_s > 0 else None
    return Payload(IMU, tuple(messages), PAYLOAD_BYTES, rate_hz=rate_hz, source=f"imu:{where}")


def _rows(stream: BinaryIO, where: str) -> Iterator[list[float]]:
    latest_s = -math.inf
    for number, line in enumerate(stream, 1):
        cells = line.decode("utf-8-sig", "replace").replace(",", " ").split()
        values = [value for value in map(_number, cells) if value is not None]
        if not cells or (number == 1 and not values):
            continue
        if len(cells) != _COLUMN_COUNT or len(values) != _COLUMN_COUNT:
            raise OptionError(
                f"--data imu:{where}: line {number} has {len(values)} numbers in {len(cells)} columns; write {COLUMNS}"
            )
        if values[0] < latest_s:
            raise OptionError(
                f"--data imu:{where}: line {number} is earlier than the one before; sort the rows by time"
            )
        latest_s = values[0]
        yield values


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def check_path(where: str) -> None:
    if not where or "\0" in where:
        raise OptionError(f"--data imu:{where}: write imu:FILE, a file of {COLUMNS}")


def payload_bytes_of(message: RawMessage) -> int:
    surplus = len(message) - MESSAGE_BYTES
    return PAYLOAD_BYTES if 0 <= surplus <= MOST_PADDING_BYTES else max(PAYLOAD_BYTES + surplus, 0)


def object_bytes_of(_message: RosMessage) -> int:
    return PAYLOAD_BYTES


IMU = DataType(
    name="imu",
    topic="imu_data",
    type_name="sensor_msgs/msg/Imu",
    raw=Form(RAW_HEADER_STAMP, payload_bytes_of, sized_by_length),
    objects=Form(HEADER_STAMP, object_bytes_of),
    object_stamp=HEADER_STAMP,
    make=make_payload,
)

IMU_FILE = Source(
    name="imu",
    usage="imu:FILE",
    open=lambda where, context: nullcontext(load_payload(where, context.stop)),
    check=check_path,
)
