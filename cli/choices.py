"""The closed sets of words that options take, shared by the commands.

Those of `dds_trace.recorder.backends.base` stand here once more, so that `--help` loads neither recorder nor numpy; a test compares.
"""

from __future__ import annotations

from enum import Enum


class Role(str, Enum):
    """Which end of the measurement a process is."""

    PING = "ping"
    RELAY = "relay"


class Discovery(str, Enum):
    """How far a node or a bridge looks for others."""

    LOCALHOST = "localhost"
    SUBNET = "subnet"


class Reliability(str, Enum):
    """QoS reliability."""

    RELIABLE = "reliable"
    BEST_EFFORT = "best_effort"


class Durability(str, Enum):
    """QoS durability."""

    VOLATILE = "volatile"
    TRANSIENT_LOCAL = "transient_local"


class History(str, Enum):
    """QoS history."""

    KEEP_LAST = "keep_last"
    KEEP_ALL = "keep_all"


class Serialization(str, Enum):
    """How messages pass the client library."""

    RAW = "raw"
    TYPED = "typed"


class Transport(str, Enum):
    """Transports of Fast DDS, and of sockets."""

    DEFAULT = "default"
    UDP = "udp"
    SHM = "shm"
    LARGE_DATA = "large-data"


class Executor(str, Enum):
    """Executors of rclpy."""

    AUTO = "auto"
    EVENTS = "events"
    SINGLE = "single"
