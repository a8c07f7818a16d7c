"""Ledger of each writer's samples: whether a sample or a fragment is on the wire for the first time or again, and when."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ..payloads.stamp import Stamp

WHOLE = 0
"""Fragment number of a sample that is sent whole; fragments count from 1."""
MULTICAST = 0
"""Destination of whatever goes to a group: what is sent to all need not be sent to one, so one copy more is a repeat."""

REMEMBERED_NS = 30_000_000_000
"""Time after its last copy for which a sample is remembered; a later copy is a repeat of a forgotten sample."""
REMEMBERED_COPIES = 400_000
"""Copies (samples, or fragments of them, per destination) remembered at once, about 100 bytes each; the oldest go first."""


Stream = TypeVar("Stream")


class Copy(NamedTuple):
    """One sample, or some fragments of it, on its way to one destination.

    Attributes:
        sequence: of the sample.
        fragment: number of the first fragment, WHOLE for a whole sample.
        fragments: how many, 1 for a whole sample.
        destination: a number for address and port; MULTICAST for all groups.
        time_ns: when it was captured.
        sample_bytes: serialized length of the sample.
    """

    sequence: int
    fragment: int
    fragments: int
    destination: int
    time_ns: int
    sample_bytes: int


@dataclass(slots=True)
class SentSample:
    """State of one sample.

    Attributes:
        first_ns, last_ns: of its first and last copy.
        sample_bytes: serialized length.
        stamp: ours, None until a copy shows one.
        first_copies: (fragment, destination) -> time of its first copy.
        repeats: fragment -> how often it was sent again.
        resent_after_ns: from the first copy of the fragment that was repeated first to its repetition; None if none was.
        heartbeats_before: of its writer, up to its first copy.
        waited_heartbeats: of its writer, from its first copy to its first repetition.
    """

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
        """Note a copy, and return whether anything in it was on its way to this destination before.

        Args:
            copy: of this sample.
            heartbeats: that its writer has sent so far.
        """
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
        """Return when these octets of the sample first went to the destination, None if they never did.

        Cyclone DDS sends a sample of up to 14 KB whole, and repeats it in fragments.
        """
        if not self.first_copies:
            return None
        for key in (
            (fragment, destination),
            (fragment, MULTICAST),
            (WHOLE, destination),
            (WHOLE, MULTICAST),
        ):
            before_ns = self.first_copies.get(key)
            if before_ns is not None:
                return before_ns
        if fragment == WHOLE and any(target in (destination, MULTICAST) for _, target in self.first_copies):
            return self.first_ns
        return None


@dataclass(slots=True)
class _Known:
    """Samples of one stream; `forgotten` is the highest number dropped, `heartbeats` how many its writer has sent."""

    samples: dict[int, SentSample] = field(default_factory=dict)
    forgotten: int = -1
    heartbeats: int = 0


class SendLedger(Generic[Stream]):
    """All writers' samples; a stream is one writer's on one interface and in one direction.

    Attributes:
        late_repeats: copies of samples that were forgotten already.
    """

    def __init__(
        self, remembered_ns: int = REMEMBERED_NS, remembered_copies: int = REMEMBERED_COPIES
    ) -> None:
        self.late_repeats = 0
        self._remembered_ns = remembered_ns
        self._remembered_copies = remembered_copies
        self._copies = 0
        self._streams: dict[Stream, _Known] = {}

    def note(self, stream: Stream, copy: Copy, stamp: Stamp | None = None) -> bool:
        """Note a copy of a sample of `stream`, and return whether it is a repeat."""
        known = self._streams.setdefault(stream, _Known())
        sample = known.samples.get(copy.sequence)
        if sample is None:
            if copy.sequence <= known.forgotten:
                self.late_repeats += 1
                return True
            sample = SentSample(
                copy.time_ns, copy.time_ns, copy.sample_bytes, heartbeats_before=known.heartbeats
            )
            known.samples[copy.sequence] = sample
        if stamp is not None:
            sample.stamp = stamp
        before = len(sample.first_copies)
        again = sample.add(copy, known.heartbeats)
        self._copies += len(sample.first_copies) - before
        return again

    def note_heartbeat(self, stream: Stream) -> None:
        """Count a heartbeat of the stream's writer."""
        self._streams.setdefault(stream, _Known()).heartbeats += 1

    def forget(self, now_ns: int) -> Iterator[tuple[Stream, SentSample]]:
        """Forget samples that are old, or the oldest of too many; yield each with its stream."""
        horizon_ns = now_ns - self._remembered_ns
        for key, stream in self._streams.items():
            # In the order of their first copies, so the first that is young ends the search.
            for sequence, sample in list(stream.samples.items()):
                if sample.last_ns >= horizon_ns and self._copies <= self._remembered_copies:
                    break
                yield key, self._drop(stream, sequence)

    def take(self, run_id: int | None) -> Iterator[tuple[Stream, SentSample]]:
        """Forget the samples whose stamp names this run, or any if None; yield each with its stream."""
        for key, stream in self._streams.items():
            for sequence, sample in list(stream.samples.items()):
                if sample.stamp is not None and run_id in (None, sample.stamp.run_id):
                    yield key, self._drop(stream, sequence)

    def _drop(self, stream: _Known, sequence: int) -> SentSample:
        sample = stream.samples.pop(sequence)
        stream.forgotten = max(stream.forgotten, sequence)
        self._copies -= len(sample.first_copies)
        return sample
