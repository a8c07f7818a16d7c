"""The hot path of a trace: events are packed into the ring, by threads that messages wait for.

Caches are cold when a message arrives, so touching memory costs more than computing: no avoidable call is made, the
lock is a `FastLock`, and what is known earlier is packed earlier.
"""

from __future__ import annotations

import queue
import struct
from collections.abc import Callable
from typing import TypeAlias

from dds_trace.base.threads import FastLock

from ..format.ring import (
    MARK_WORD,
    RECEIVED_WORD,
    SLOT_BYTES,
    SLOT_PAIR_STRUCT,
    SLOT_STRUCT,
    SLOT_WORDS,
    SOURCE_WORD,
    STAGE_MARKS,
    TIME_WORD,
)
from .writer import TraceFiles

ExpectedPair: TypeAlias = tuple[int, int, int, int]
"""Two events without times: ticket of the first, its first word in the ring, the marks of both."""

_pack_into, _pack_pair_into = SLOT_STRUCT.pack_into, SLOT_PAIR_STRUCT.pack_into


class EventPacker:
    """The ring's side of a `TraceSink`: `record` and its like never raise and never wait for the disk.

    The lock makes ticket, slot and mark one step, so that the ring has no holes; its thread runs or waits for the GIL, so
    waiting for the lock is waiting for the GIL, as every Python call does. `wake` gets True when a quarter of the ring is used.
    """

    def __init__(self, files: TraceFiles, clock_ns: Callable[[], int], wake: queue.SimpleQueue[bool]) -> None:
        self._clock_ns = clock_ns
        self._wake = wake
        self._dropped = 0
        self._is_closed = False
        self._packing = FastLock()
        self._take, self._give = self._packing.take, self._packing.give
        self._use(files)

    def _use(self, files: TraceFiles) -> None:
        """Send the next event to the ring of these files, with ticket 0; under the lock, if any."""
        self._files = files
        self._memory = files.ring.memory
        self._words = files.ring.words
        self._slots_at = files.ring.slots_at
        self._slot_count = len(files.ring.slots)
        self._head = 0  # ticket of the next event; all below are packed
        self._limit = self._slot_count  # the ring is full when the head is here
        self._quarter = self._slot_count // 4
        self._attention = self._quarter  # the head is next looked at here; never above the limit
        self._expected: ExpectedPair | None = None  # packed at the head, without marks

    def record(
        self,
        stage: int,
        run_id: int,
        sequence: int,
        monotonic_ns: int,
        scheduled_ns: int = 0,
        source_ns: int = 0,
        received_ns: int = 0,
        payload_bytes: int = 0,
        relay_id: int = 0,
    ) -> None:
        """Store one event (fields: `EventColumns`), or count it as dropped if the ring is full, the sink closed, or a value out of range.

        `stage` is 1 to 4, for T1 to T4; 5 of a tap.
        """
        try:
            self._take()
        except IndexError:
            self._packing.wait()
        try:
            head = self._head
            if head >= self._attention and not self._has_room(head):
                return
            _pack_into(
                self._memory,
                self._slots_at + head % self._slot_count * SLOT_BYTES,
                run_id,
                sequence,
                monotonic_ns,
                scheduled_ns,
                source_ns,
                received_ns,
                payload_bytes,
                relay_id,
                STAGE_MARKS[stage] + head,
            )
            self._head = head + 1
        except (struct.error, LookupError, TypeError):
            self._drop()
        finally:
            self._give(None)
            if self._packing.is_awaited:
                self._packing.wake()

    def stamp(
        self,
        stage: int,
        run_id: int,
        sequence: int,
        scheduled_ns: int = 0,
        source_ns: int = 0,
        received_ns: int = 0,
        payload_bytes: int = 0,
        relay_id: int = 0,
    ) -> int:
        """Read the clock, store the event of this instant, and return its time stamp.

        Everything else is packed first, so that only two stores follow the clock: a process that is killed when the
        message leaves has stored its event.
        """
        now = self._clock_ns
        try:
            self._take()
        except IndexError:
            self._packing.wait()
        try:
            head = self._head
            if head >= self._attention and not self._has_room(head):
                return now()
            slot = head % self._slot_count
            try:
                mark = STAGE_MARKS[stage] + head
                _pack_into(
                    self._memory,
                    self._slots_at + slot * SLOT_BYTES,
                    run_id,
                    sequence,
                    0,
                    scheduled_ns,
                    source_ns,
                    received_ns,
                    payload_bytes,
                    relay_id,
                    0,  # no mark: not an event yet
                )
            except (struct.error, LookupError, TypeError):
                self._drop()
                return now()
            words, following = self._words, head + 1
            time_at = slot * SLOT_WORDS + TIME_WORD
            mark_at = slot * SLOT_WORDS + MARK_WORD
            words[time_at] = monotonic_ns = now()
            words[mark_at] = mark
            self._head = following
            return monotonic_ns
        finally:
            self._give(None)
            if self._packing.is_awaited:
                self._packing.wake()

    def record_and_stamp(
        self,
        stages: tuple[int, int],
        run_id: int,
        sequence: int,
        monotonic_ns: int,
        source_ns: int,
        received_ns: int,
        payload_bytes: int,
        relay_id: int,
    ) -> int:
        """Store the arrival of a message and stamp its departure: `record`, then `stamp`, in one step; the three times are the arrival's."""
        now = self._clock_ns
        with self._packing:
            head = self._head
            slot = head % self._slot_count
            if head + 1 < self._attention and slot + 1 < self._slot_count:
                arrival, departure = stages
                try:
                    mark = STAGE_MARKS[departure] + head + 1
                    _pack_pair_into(
                        self._memory,
                        self._slots_at + slot * SLOT_BYTES,
                        run_id,
                        sequence,
                        monotonic_ns,
                        0,
                        source_ns,
                        received_ns,
                        payload_bytes,
                        relay_id,
                        STAGE_MARKS[arrival] + head,
                        run_id,
                        sequence,
                        0,
                        0,
                        0,
                        0,
                        payload_bytes,
                        relay_id,
                        0,  # no mark: not an event yet
                    )
                except (struct.error, LookupError, TypeError):
                    pass  # out of range, so dropped below
                else:
                    words, at, following = self._words, (slot + 1) * SLOT_WORDS, head + 2
                    words[at + TIME_WORD] = departure_ns = now()
                    words[at + MARK_WORD] = mark
                    self._head = following
                    return departure_ns
        self.record(stages[0], run_id, sequence, monotonic_ns, 0, source_ns, received_ns, payload_bytes, relay_id)
        return self.stamp(stages[1], run_id, sequence, 0, 0, 0, payload_bytes, relay_id)

    def expect(
        self, stages: tuple[int, int], run_id: int, sequence: int, payload_bytes: int, relay_id: int
    ) -> ExpectedPair | None:
        """Pack the pair that `record_and_stamp` would store for the next message without its times: not an event yet.

        Between an arrival and its reply every instruction counts; after the reply there is time. None: there is no slot for it now.
        """
        with self._packing:
            self._expected = None
            head = self._head
            slot = head % self._slot_count
            if head + 1 >= self._attention or slot + 1 >= self._slot_count:
                return None
            event = (run_id, sequence, 0, 0, 0, 0, payload_bytes, relay_id, 0)
            try:
                marks = STAGE_MARKS[stages[0]] + head, STAGE_MARKS[stages[1]] + head + 1
                _pack_pair_into(self._memory, self._slots_at + slot * SLOT_BYTES, *event, *event)
            except (struct.error, LookupError, TypeError):
                return None  # counted as dropped when such a message comes
            self._expected = expected = head, slot * SLOT_WORDS, *marks
            return expected

    def record_expected(self, expected: ExpectedPair, monotonic_ns: int, source_ns: int, received_ns: int) -> bool:
        """Store the pair that `expect` has packed, with its arrival's times; the clock gives the departure's.

        False: nothing is stored, as another event has the slot or a time is out of range; then call `record_and_stamp`.
        """
        now = self._clock_ns
        try:
            self._take()
        except IndexError:
            self._packing.wait()
        try:
            head, at, arrival_mark, departure_mark = expected
            if expected is not self._expected or head != self._head:
                return False
            words, following = self._words, head + 2
            words[at + TIME_WORD] = monotonic_ns
            if source_ns:
                words[at + SOURCE_WORD] = source_ns
            if received_ns:
                words[at + RECEIVED_WORD] = received_ns
            words[at + MARK_WORD] = arrival_mark
            words[at + (SLOT_WORDS + TIME_WORD)] = now()
            words[at + (SLOT_WORDS + MARK_WORD)] = departure_mark
            self._head = following
        except (ValueError, TypeError):
            return False
        else:
            return True
        finally:
            self._give(None)
            if self._packing.is_awaited:
                self._packing.wake()

    def _has_room(self, head: int) -> bool:
        """Wake the draining thread; the caller has the lock."""
        if head >= self._limit:
            self._drop()
            return False
        self._wake.put(True)
        self._attention = self._limit
        return True

    def _drop(self) -> None:
        self._dropped += 1
        self._expected = None  # part of the dropped event may be in its slot
        if not self._is_closed:
            self._files.ring.note_dropped(self._dropped)
