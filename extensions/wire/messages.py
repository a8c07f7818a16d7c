"""Messages on the wire: repeats, a row per message and direction, and counts by repeats."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from dds_trace.recorder.payloads.stamp import STAMP_BYTES, STAMP_PREFIX, Stamp, parse_stamp

from .format import MESSAGE_ROW, NEVER_NS, Direction, MessageRows

_MOST_COUNTED = 65535
WHOLE = 0
"""Fragment number of a sample that is sent whole; fragments count from 1."""
MULTICAST = 0
"""Destination of multicast: what all received need not be sent to one, so another copy is a repeat."""

REMEMBERED_NS = 30_000_000_000
"""A sample is remembered for this time after its last copy."""
REMEMBERED_COPIES = 400_000
"""Copies (samples, or fragments of them, per destination) remembered at once; each about 100 bytes."""


Stream = TypeVar("Stream")


class Copy(NamedTuple):
    """One sample, or fragments of it (1 for a whole one), to one `destination`: address and port, or MULTICAST."""

    sequence: int
    fragment: int
    fragments: int
    destination: int
    time_ns: int
    sample_bytes: int


@dataclass(slots=True)
class SentSample:
    first_ns: int
    last_ns: int
    sample_bytes: int
    stamp: Stamp | None = None
    first_copies: dict[tuple[int, int], int] = field(default_factory=dict)
    repeats: dict[int, int] = field(default_factory=dict)
    resent_after_ns: int | None = None
    heartbeats_before: int = 0
    waited_heartbeats: int = 0

    def add(self, copy: Copy, heartbeats: int = 0) -> bool:
        """Add a copy; return whether any of it was sent to this destination before, after so many `heartbeats`."""
        self.last_ns = copy.time_ns
        again = False
        for fragment in range(copy.fragment, copy.fragment + copy.fragments):
            before_ns = self._before(fragment, copy.destination)
            if before_ns is None:
                self.first_copies[fragment, copy.destination] = copy.time_ns
                continue
            again = True
            self.repeats[fragment] = self.repeats.get(fragment, 0) + 1
            if self.resent_after_ns is None:
                self.resent_after_ns = copy.time_ns - before_ns
                self.waited_heartbeats = heartbeats - self.heartbeats_before
        return again

    def _before(self, fragment: int, destination: int) -> int | None:
        """Return when these octets first went to the destination, None if never.

        Cyclone DDS sends a sample of up to 14 KB whole, and repeats it in fragments.
        """
        if not self.first_copies:
            return None
        for key in ((fragment, destination), (fragment, MULTICAST), (WHOLE, destination), (WHOLE, MULTICAST)):
            before_ns = self.first_copies.get(key)
            if before_ns is not None:
                return before_ns
        if fragment == WHOLE and any(target in (destination, MULTICAST) for _, target in self.first_copies):
            return self.first_ns
        return None


@dataclass(slots=True)
class _StreamSamples:
    """Samples of one stream; `forgotten` is the highest number dropped, `heartbeats` how many the writer has sent."""

    samples: dict[int, SentSample] = field(default_factory=dict)
    forgotten: int = -1
    heartbeats: int = 0


class SendLedger(Generic[Stream]):
    """Samples of all writers, by stream: one writer on one interface and in one direction."""

    def __init__(self, remembered_ns: int = REMEMBERED_NS, remembered_copies: int = REMEMBERED_COPIES) -> None:
        self.late_repeats = 0
        self._remembered_ns = remembered_ns
        self._remembered_copies = remembered_copies
        self._copies = 0
        self._streams: dict[Stream, _StreamSamples] = {}

    def note(self, stream: Stream, copy: Copy, stamp: Stamp | None = None) -> bool:
        recent = self._streams.setdefault(stream, _StreamSamples())
        sample = recent.samples.get(copy.sequence)
        if sample is None:
            if copy.sequence <= recent.forgotten:
                self.late_repeats += 1
                return True
            sample = SentSample(copy.time_ns, copy.time_ns, copy.sample_bytes, heartbeats_before=recent.heartbeats)
            recent.samples[copy.sequence] = sample
        if stamp is not None:
            sample.stamp = stamp
        before = len(sample.first_copies)
        again = sample.add(copy, recent.heartbeats)
        self._copies += len(sample.first_copies) - before
        return again

    def note_heartbeat(self, stream: Stream) -> None:
        self._streams.setdefault(stream, _StreamSamples()).heartbeats += 1

    def forget(self, now_ns: int) -> Iterator[tuple[Stream, SentSample]]:
        horizon_ns = now_ns - self._remembered_ns
        for key, stream in self._streams.items():
            # In the order of their first copies: the first young one ends the search.
            for sequence, sample in list(stream.samples.items()):
                if sample.last_ns >= horizon_ns and self._copies <= self._remembered_copies:
                    break
                yield key, self._drop(stream, sequence)

    def take(self, run_id: int | None) -> Iterator[tuple[Stream, SentSample]]:
        for key, stream in self._streams.items():
            for sequence, sample in list(stream.samples.items()):
                if sample.stamp is not None and run_id in (None, sample.stamp.run_id):
                    yield key, self._drop(stream, sequence)

    def _drop(self, stream: _StreamSamples, sequence: int) -> SentSample:
        sample = stream.samples.pop(sequence)
        stream.forgotten = max(stream.forgotten, sequence)
        self._copies -= len(sample.first_copies)
        return sample


STAMP_OFFSETS = (16, 8)
"""Our stamp in a serialized sample: after a `std_msgs/Header`'s time, or at the start of a `String`."""


def stamp_at(memory: memoryview, payload_at: int, seen_end: int) -> Stamp | None:
    """Return the stamp of the serialized sample that begins at `payload_at`, None if it is not a message of ours."""
    for offset in STAMP_OFFSETS:
        begin = payload_at + offset
        if begin + STAMP_BYTES <= seen_end and memory[begin : begin + len(STAMP_PREFIX)] == STAMP_PREFIX:
            return parse_stamp(bytes(memory[begin : begin + STAMP_BYTES]))
    return None


def message_row(sample: SentSample, direction: Direction) -> tuple[int, ...] | None:
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
    return np.array(rows, MESSAGE_ROW)


def message_rows(packed: Sequence[MessageRows]) -> MessageRows:
    return np.sort(np.concatenate(packed), order=("run_id", "direction", "relay_id", "sequence"))


@dataclass(frozen=True, slots=True)
class RepeatCount:
    """Messages sent again `repeats` times; the other fields are None for those that were sent once."""

    repeats: int
    messages: int
    delay_p50_ns: float | None = None
    delay_p90_ns: float | None = None
    delay_p99_ns: float | None = None
    delay_max_ns: float | None = None
    heartbeats_p50: float | None = None


def count_repeats(rows: MessageRows) -> tuple[RepeatCount, ...]:
    sent = rows[rows["direction"] != Direction.RECEIVED]
    counts = []
    for repeats in np.unique(sent["repeats"]).tolist():
        datagrams = sent[sent["repeats"] == repeats]
        if not repeats:
            counts.append(RepeatCount(0, len(datagrams)))
            continue
        delays_ns = datagrams["resent_after_ns"]
        p50_ns, p90_ns, p99_ns = np.percentile(delays_ns, (50, 90, 99)).tolist()
        heartbeats_p50 = float(np.median(datagrams["waited_heartbeats"]))
        counts.append(
            RepeatCount(repeats, len(datagrams), p50_ns, p90_ns, p99_ns, float(delays_ns.max()), heartbeats_p50)
        )
    return tuple(counts)
