"""Enums of the values of options; light, since `--help` loads them."""

from __future__ import annotations

from enum import Enum


class Discovery(Enum):
    LOCALHOST = "localhost"
    SUBNET = "subnet"


class Serialization(Enum):
    RAW = "raw"
    TYPED = "typed"


class ExecutorKind(Enum):
    AUTO = "auto"
    EVENTS = "events"
    SINGLE = "single"


class Transport(Enum):
    """Transports of Fast DDS and zenoh, protocols of sockets; other backends have only `DEFAULT`."""

    DEFAULT = "default"
    UDP = "udp"
    SHM = "shm"
    LARGE_DATA = "large-data"
    TCP = "tcp"


class Security(Enum):
    """What of the messages is protected; every level but `OFF` checks certificates of both sides."""

    OFF = "off"
    AUTHENTICATE = "authenticate"
    SIGN = "sign"
    ENCRYPT_DATA = "encrypt-data"
    ENCRYPT_RTPS = "encrypt-rtps"


class Load(Enum):
    NONE = "none"
    CPU = "cpu"
    MEMORY = "memory"
    NETWORK = "network"
    AWAKE = "awake"
    DMA_LATENCY = "dma-latency"
    PI3 = "emulated-pi3"


class WhenFull(Enum):
    """What a zenoh publisher does when the link is full; `DEFAULT` blocks if it is reliable."""

    DEFAULT = "default"
    BLOCK = "block"
    DROP = "drop"


class Call(Enum):
    """Whether a message and its reply are a topic each, or request and response of one call."""

    NONE = "none"
    SERVICE = "service"
    ACTION = "action"


class Role(Enum):
    PING = "ping"
    RELAY = "relay"
    TAP = "tap"
    BEACON = "beacon"


class Side(Enum):
    PING = "ping"
    RELAY = "relay"


class FileMode(Enum):
    GROUP = "0640"
    OWNER = "0600"

    @property
    def bits(self) -> int:
        return int(self.value, 8)


class QosPolicy(str, Enum):
    __str__ = str.__str__


class Reliability(QosPolicy):
    RELIABLE = "reliable"
    BEST_EFFORT = "best_effort"


class Durability(QosPolicy):
    VOLATILE = "volatile"
    TRANSIENT_LOCAL = "transient_local"


class History(QosPolicy):
    KEEP_LAST = "keep_last"
    KEEP_ALL = "keep_all"
