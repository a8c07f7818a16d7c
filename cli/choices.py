"""Words that options of several commands take, and that no room has as an Enum of its own."""

from __future__ import annotations

from enum import Enum


class Role(Enum):
    """The two ends of a measurement."""

    PING = "ping"
    RELAY = "relay"


class Reliability(Enum):
    """QoS reliability."""

    RELIABLE = "reliable"
    BEST_EFFORT = "best_effort"


class Durability(Enum):
    """QoS durability."""

    VOLATILE = "volatile"
    TRANSIENT_LOCAL = "transient_local"


class History(Enum):
    """QoS history."""

    KEEP_LAST = "keep_last"
    KEEP_ALL = "keep_all"
