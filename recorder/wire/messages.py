"""Records of messages on the wire, one a message and direction, and counts of messages by their repeats."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from dds_trace.tracefile.format.wire import MESSAGE_ROW, NEVER_NS, Direction

from ..payloads.stamp import STAMP_BYTES, STAMP_PREFIX, Stamp, parse_stamp

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from dds_trace.tracefile.format.wire import MessageRows

    from .ledger import SentSample


_MOST_COUNTED = 65535


STAMP_PLACES = (16, 8)
"""Offsets of our stamp from a sample's first byte: behind a `std_msgs/Header`'s time, and at the start of a `String`."""


def stamp_at(memory: memoryview, payload_at: int, seen_end: int) -> Stamp | None:
    """Return the stamp of the serialized sample that begins at `payload_at`, None if it is not a message of ours.

    Of a message without our stamp four bytes are compared, at either place, and none is kept.
    """
    for place in STAMP_PLACES:
        begin = payload_at + place
        if begin + STAMP_BYTES <= seen_end and memory[begin : begin + len(STAMP_PREFIX)] == STAMP_PREFIX:
            return parse_stamp(bytes(memory[begin : begin + STAMP_BYTES]))
    return None


def message_row(sample: SentSample, direction: Direction) -> tuple[int, ...] | None:
    """Return the fields of MESSAGE_ROW, None for a sample without our stamp."""
    if sample.stamp is None:
        return None
    repeats = sample.repeats.values()
    return (
        *sample.stamp,
        direction,
        len({fragment for fragment, _ in sample.first_copies}),
        sum(repeats),
        min(max(repeats, default=0), _MOST_COUNTED),
        sample.sample_bytes,
        sample.first_ns,
        sample.last_ns,
        NEVER_NS if sample.resent_after_ns is None else sample.resent_after_ns,
        min(sample.waited_heartbeats, _MOST_COUNTED),
    )


def pack_rows(rows: Sequence[tuple[int, ...]]) -> MessageRows:
    """Return records, given as tuples, as an array."""
    return np.array(rows, MESSAGE_ROW)


def message_rows(packed: Sequence[MessageRows]) -> MessageRows:
    """Return rows, of which some are packed already, as one array: by run, direction, relay and sequence."""
    return np.sort(np.concatenate(packed), order=("run_id", "direction", "relay_id", "sequence"))


@dataclass(frozen=True, slots=True)
class RepeatCount:
    """Messages that were sent again equally often.

    Attributes:
        repeats: how often, 0 for messages that went out once.
        messages: how many there are.
        delay_p50_ns, delay_p90_ns, delay_p99_ns, delay_max_ns: of `resent_after_ns` (linear interpolation, as numpy
            has it); None for messages that went out once.
        heartbeats_p50: median of the heartbeats that their writer sent meanwhile; None likewise.
    """

    repeats: int
    messages: int
    delay_p50_ns: float | None = None
    delay_p90_ns: float | None = None
    delay_p99_ns: float | None = None
    delay_max_ns: float | None = None
    heartbeats_p50: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object."""
        return asdict(self)

    @classmethod
    def from_dict(cls, found: Mapping[str, Any]) -> RepeatCount:
        """Return the count that a JSON object of `to_dict` holds; unknown fields are ignored."""
        return cls(**{name: found[name] for name in cls.__slots__ if name in found})


def count_repeats(rows: MessageRows) -> tuple[RepeatCount, ...]:
    """Count the messages that this side sent by their number of repeats."""
    sent = rows[rows["direction"] != Direction.RECEIVED]
    return tuple(
        _repeat_count(int(repeats), sent[sent["repeats"] == repeats])
        for repeats in np.unique(sent["repeats"])
    )


def _repeat_count(repeats: int, rows: MessageRows) -> RepeatCount:
    if repeats == 0:
        return RepeatCount(0, len(rows))
    delays_ns = rows["resent_after_ns"]
    heartbeats_p50 = float(np.median(rows["waited_heartbeats"]))
    p50_ns, p90_ns, p99_ns = np.percentile(delays_ns, (50, 90, 99)).tolist()
    return RepeatCount(repeats, len(rows), p50_ns, p90_ns, p99_ns, float(delays_ns.max()), heartbeats_p50)
