"""Counters of one run."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from statistics import median
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections import Counter

    from dds_trace.tracefile.format.wire import Direction

    from .packets.classes import WireClass
    from .packets.frames import Frame


@dataclass(slots=True)
class ClassTally:
    """Counters of one class in one direction; `ClassCount` has their meaning."""

    packets: int = 0
    bytes: int = 0
    submessages: int = 0
    fragments: int = 0
    ip_fragments: int = 0


@dataclass(slots=True)
class Beginnings:
    """Beginnings of discovery and traffic, CLOCK_MONOTONIC ns; None until then.

    Attributes:
        spdp_ns: the first announcement of a participant.
        data_ns: the first message with our stamp, probes included.
        reply_ns: the first with a relay's id in it: both ways have been matched.
    """

    spdp_ns: int | None = None
    data_ns: int | None = None
    reply_ns: int | None = None

    def note(self, name: str, time_ns: int) -> None:
        """Keep the time if it is the first."""
        if getattr(self, name) is None:
            setattr(self, name, time_ns)


@dataclass(slots=True)
class RunTally:
    """Counters that begin anew with each run.

    Attributes:
        classes: by class and direction.
        foreign_packets: of DDS domains other than ours.
        unseen_headers: packets in which a submessage header was not captured.
        requests: ACKNACK and NACK_FRAG that asked for something again.
        tcp_again_bytes: TCP payload that this side sent again.
        heartbeat_gaps_ns: between two heartbeats of a writer that came without data.
        packets: frames handled.
    """

    classes: defaultdict[tuple[WireClass, Direction], ClassTally] = field(
        default_factory=lambda: defaultdict(ClassTally)
    )
    foreign_packets: int = 0
    unseen_headers: int = 0
    requests: int = 0
    tcp_again_bytes: int = 0
    heartbeat_gaps_ns: list[int] = field(default_factory=list)
    packets: int = 0

    @property
    def heartbeat_gap_p50_ns(self) -> float | None:
        """Median of the gaps, None without any."""
        return median(self.heartbeat_gaps_ns) if self.heartbeat_gaps_ns else None

    def count_frame(self, frame: Frame, kind: WireClass, direction: Direction) -> None:
        """Count a frame, with all its bytes, for one class."""
        tally = self.classes[kind, direction]
        tally.packets += 1
        tally.bytes += frame.wire_bytes
        tally.ip_fragments += bool(frame.fragment_offset or frame.more_fragments)

    def move_bytes(self, found: Counter[WireClass], principal: WireClass, direction: Direction) -> None:
        """Move the bytes of a packet's other submessages from its principal class to their own."""
        for kind, size in found.items():
            if kind is not principal:
                self.classes[kind, direction].bytes += size
                self.classes[principal, direction].bytes -= size
