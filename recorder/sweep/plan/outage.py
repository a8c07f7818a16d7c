"""Kinds of outages."""

from enum import Enum


class OutageBy(Enum):
    LINK = "link"  # the ping's interface goes down, and comes up with its address
    ADDRESS = "address"  # likewise, and comes up with another address
    LOSS = "loss"  # the link stays up, and every packet is lost
    RELAY = "relay"  # the relay is killed, and another one is started
