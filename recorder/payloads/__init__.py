"""The kinds of data that a ping can send: one file each, the same names in the same order."""

from recorder.payload import DataType
from recorder.payloads.binary import BINARY
from recorder.payloads.imu import IMU
from recorder.payloads.string import STRING
from tracefile import OptionError

DATA_TYPES = {data_type.name: data_type for data_type in (BINARY, STRING, IMU)}
"""By the name that `--data` takes and the trace keeps; a relay serves all of them at once."""


def data_type_called(name: str) -> DataType:
    """The data type `name`.

    Raises:
        OptionError: there is none.
    """
    if name not in DATA_TYPES:
        raise OptionError(f"there is no data type {name!r}; choose one of {', '.join(DATA_TYPES)}")
    return DATA_TYPES[name]


__all__ = ["BINARY", "DATA_TYPES", "IMU", "STRING", "data_type_called"]
