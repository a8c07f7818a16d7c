"""`TraceSink`, which keeps the events of a recording node.

The hot path packs an event into a ring file (`dds_trace.tracefile.format.ring`) and returns. The event of a message that is
about to leave (T1, T4) is stamped in the ring as well, so that no message is on its way without it. A thread of the sink's
own moves what is in the ring to the trace, a chunk every `chunk_seconds` or whenever a quarter of the ring is used. A slot
is used again only after its chunk is in the file, so at every instant an event is in the file or in the ring, and a process
killed at any instruction loses none (`dds_trace.tracefile.recovery.recover`).
"""

from __future__ import annotations

import json
import queue
import struct
import sys
import threading
import time
from collections import deque
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import TYPE_CHECKING

from ..errors import OutputError
from ..format.events import RUN_TOPIC, SESSION_TOPIC
from ..format.ring import (
    MARK_WORD,
    SLOT_BYTES,
    SLOT_PAIR_STRUCT,
    SLOT_STRUCT,
    SLOT_WORDS,
    STAGE_MARKS,
    TIME_WORD,
)
from ..threads import run_in_background
from .trace_files import TraceFiles

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from ..format.descriptions import Run, Session
    from ..format.json_fields import Json
    from .destination import ClosedTrace, TraceDestination


BUSY_SWITCH_INTERVAL_S = 1e-4
"""Longest time that a thread keeps the GIL while another fills the ring (see `_quick_switches`)."""

_pack_into, _pack_pair_into = SLOT_STRUCT.pack_into, SLOT_PAIR_STRUCT.pack_into


class TraceSink:
    """Trace while it is recorded.

    Args:
        destination: the file or folder, and how it is written.
        session: the recording process, in state `open`; its description is in the file when this returns.
        clock_ns: the monotonic clock of the events' time stamps, which `stamp` reads.

    Raises:
        OutputExistsError: the destination exists already and `force` was not given.
        OutputError: the file cannot be made.
    """

    def __init__(
        self,
        destination: TraceDestination,
        session: Session,
        *,
        clock_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._session = session
        self._clock_ns = clock_ns
        self._flush_seconds = destination.flush_seconds
        self._error: OutputError | None = None
        self._closed: ClosedTrace | None = None
        self._texts: deque[tuple[str, str, int]] = deque()  # topic, JSON, log time: not yet in the file
        self._saved_ns = time.monotonic_ns()  # what was recorded until then is in the file
        self._longest_unsaved_ns = 0
        self._measures_unsaved = destination.fsync
        self._use(TraceFiles(destination, session, session.wall_ns(clock_ns())))
        self._dropped = 0
        self._is_paused = False
        self._record_lock = threading.Lock()
        self._write_lock = threading.Lock()
        self._wake: queue.SimpleQueue[bool] = queue.SimpleQueue()  # True: drain now; False: the end
        self._thread = threading.Thread(target=self._drain, name="trace-sink", daemon=True)
        self._thread.start()

    def _use(self, files: TraceFiles) -> None:
        """Send the next event to the ring of these files, its ticket 0; the caller holds the record lock, if there is one."""
        self._files = files
        self._memory = files.ring.memory
        self._words = files.ring.words
        self._slots_at = files.ring.slots_at
        self._slot_count = len(files.ring.slots)
        self._head = 0  # ticket of the next event; all below are packed
        self._limit = self._slot_count  # the ring is full when the head is here
        self._quarter = self._slot_count // 4
        self._attention = self._quarter  # the head is next looked at here; never above the limit

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
        """Keep one event, or count it as dropped: when the ring is full, the sink closed, or a value out of range.

        Never raises and never waits for the disk. The lock makes ticket, slot and mark one step, so that the
        ring has no holes; it is only ever held by a thread that runs or waits for the GIL, so that waiting
        for it is waiting for the GIL, as every Python call does.

        Args:
            stage: 1 to 4, for T1 to T4.
            run_id: the random number of the run.
            sequence: the message's number in the run.
            monotonic_ns: the time stamp, on this device's monotonic clock.
            scheduled_ns: T0 on the same clock (T1 only).
            source_ns: the middleware's source time stamp, ns since 1970; 0 if unknown.
            received_ns: the middleware's reception time stamp, ns since 1970; 0 if unknown.
            payload_bytes: application bytes of the message.
            relay_id: the relay that handled the message; 0 on T1.
        """
        with self._record_lock:
            head = self._head
            if head >= self._attention and not self._has_room(head):
                return
            try:
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
            except (struct.error, LookupError, TypeError):
                self._drop()
            else:
                self._head = head + 1

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
        """Read the clock, keep the event of this instant, and return its time stamp; arguments as for `record`.

        What is known before is packed before, so that only two stores lie between the clock and the return: a process
        that is killed at any instruction behind the return, where the message leaves, has left its event.
        """
        now = self._clock_ns
        with self._record_lock:
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
        """Keep the arrival of a message, and stamp its departure: `record`, then `stamp`, in one step and one pack.

        Caches are cold when a message arrives, and what is touched costs more than what is computed.

        Args:
            stages: stages of the arrival and of the departure.
            run_id: of both, as for `record`; so are `sequence`, `payload_bytes` and `relay_id`.
            sequence: the message's number in the run.
            monotonic_ns: time stamp of the arrival; `source_ns` and `received_ns` are its as well.
            source_ns: the middleware's source time stamp, ns since 1970; 0 if unknown.
            received_ns: the middleware's reception time stamp, ns since 1970; 0 if unknown.
            payload_bytes: application bytes of the message.
            relay_id: the relay that handled the message.

        Returns:
            The time stamp of the departure.
        """
        now = self._clock_ns
        with self._record_lock:
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
        self.record(
            stages[0], run_id, sequence, monotonic_ns, 0, source_ns, received_ns, payload_bytes, relay_id
        )
        return self.stamp(stages[1], run_id, sequence, 0, 0, 0, payload_bytes, relay_id)

    def _has_room(self, head: int) -> bool:
        """Wake the draining thread and return whether there is a free slot; the caller holds the record lock."""
        if head >= self._limit:
            self._drop()
            return False
        self._wake.put(True)
        self._attention = self._limit
        return True

    def _drop(self) -> None:
        self._dropped += 1
        if self._closed is None:
            self._files.ring.note_dropped(self._dropped)

    def write_run(self, run: Run) -> None:
        """Write a run's description; when this returns it is in the file, after all events before it."""
        self._write(RUN_TOPIC, run.to_json())

    def write_json(self, topic: str, value: Mapping[str, object]) -> None:
        """Write `value` as JSON in a `std_msgs/msg/String`, at once as `write_run` does."""
        self._write(topic, json.dumps(value))

    def _write(self, topic: str, text: str) -> None:
        with self._write_lock:
            if (
                self._closed is None and not self._is_paused
            ):  # a host sample of that time is not worth the room
                self._texts.append((topic, text, self._session.wall_ns(self._clock_ns())))
                self._flush()

    @property
    def dropped_events(self) -> int:
        """Number of events that could not be kept so far."""
        return self._dropped

    @property
    def error(self) -> OutputError | None:
        """First failure of writing, or None. What was written before stays; the ring continues to fill."""
        return self._error

    @property
    def bytes_written(self) -> int:
        """Length of the file that is written now, in bytes."""
        return self._files.writer.bytes_written

    def pause(self) -> None:
        """Write nothing until `resume`: events wait in the ring, whose room on the disk is its own; of more, the newest are dropped."""
        with self._write_lock:
            self._is_paused = self._closed is None

    def resume(self) -> None:
        """Write again, first what waits."""
        with self._write_lock:
            self._is_paused = False
            if self._closed is None:
                self._flush()

    def go_on_in(self, destination: TraceDestination, **session_extra: Json) -> ClosedTrace | None:
        """Close the file with `session_extra` and go on in another one, from one event to the next.

        The new file and its ring are made before, and what the old ring still holds is written behind: no event waits for
        the disk, and a process that is killed meanwhile leaves two whole traces. `part` of the session counts its files,
        `followed` says that another one was begun.

        Returns:
            The closed file; None, and nothing is changed, if events wait for the disk or the sink is closed.

        Raises:
            OutputExistsError: the new file is there already; the recording goes on in the old one.
            OutputError: it cannot be made; likewise.
        """
        with self._write_lock:
            if self._closed is not None or not self._flush():
                return None
            part = int(str(self._session.extra.get("part", 1))) + 1
            session = replace(self._session, extra={**self._session.extra, **session_extra, "part": part})
            files = TraceFiles(destination, session, session.wall_ns(self._clock_ns()))
            with self._record_lock:
                old, head = self._files, self._head
                files.ring.note_dropped(self._dropped)
                self._use(files)
            closed = self._end(old, head, {**session_extra, "followed": True})
            self._session = session
            return closed

    def close(self, **session_extra: Json) -> ClosedTrace:
        """Write what is pending, the closed session with `session_extra` and the summary; delete the ring.

        If that fails, the ring stays beside the file, and the two together are still a whole trace. Do not call this
        in a signal handler: the thread that it interrupts may be recording.
        """
        self._wake.put(False)
        self._thread.join()
        with self._write_lock:
            if self._closed is not None:
                return self._closed
            with self._record_lock:  # from here on every event is dropped, and counted
                head = self._limit = self._attention = self._head
            return self._end(self._files, head, session_extra)

    def _end(self, files: TraceFiles, head: int, session_extra: Mapping[str, Json]) -> ClosedTrace:
        """Write what is left up to ticket `head` and the closed session, and close the files; the caller holds the write lock."""
        self._flush_to(files, head)
        if self._measures_unsaved:
            session_extra = {**session_extra, "longest_unsaved_ns": self._longest_unsaved_ns}
        with self._record_lock:
            session = self._session.closed(self._dropped, **session_extra)
        self._texts.append((SESSION_TOPIC, session.to_json(), session.wall_ns(self._clock_ns())))
        if self._flush_to(files, head):
            error = files.finish()
            self._error = self._error or error
        else:
            files.writer.abandon()
            self._texts.clear()
        with self._record_lock:
            closed = files.closed(head, self._dropped, self._error)
            if files is self._files:
                self._closed = closed
            files.ring.close(delete=not closed.ring_events)
        return closed

    def _drain(self) -> None:
        """Write a chunk every `flush_seconds`, or when a quarter of the ring is used; the draining thread runs this."""
        run_in_background()
        going_on = True
        while going_on:
            with suppress(queue.Empty):
                going_on = self._wake.get(timeout=self._flush_seconds)
            with self._write_lock:
                self._flush()

    def _flush(self) -> bool:
        """Move the ring's events so far, then the texts, to the file; return whether all of it is there."""
        return not self._is_paused and self._flush_to(self._files, self._head)

    def _flush_to(self, files: TraceFiles, head: int) -> bool:
        """Move the events up to ticket `head`, then the texts, to a file; the caller holds the write lock."""
        began_ns, had = time.monotonic_ns(), files.drained
        try:
            with _quick_switches(only_if=head - had >= self._quarter):
                while files.drained < head:
                    files.move_chunk(head)
                    if files is self._files:
                        self._limit = files.drained + self._slot_count
                        self._attention = files.drained + self._quarter
            if head > had:
                self._longest_unsaved_ns = max(self._longest_unsaved_ns, time.monotonic_ns() - self._saved_ns)
            self._saved_ns = began_ns
            while self._texts:
                files.writer.write_text(*self._texts[0])
                self._texts.popleft()
        except OutputError as err:
            self._error = self._error or err
            return False
        return True


@contextmanager
def _quick_switches(*, only_if: bool) -> Iterator[None]:
    """Shorten the interpreter's switch interval, so that this thread gets the GIL soon while a busy one fills the ring.

    A thread that computes without pause gives the GIL up only every switch interval (5 ms), and a chunk takes
    it some twenty times between its array operations: 100 ms, in which 65536 slots fill. With 0.1 ms it is
    10 ms. A recorder under ordinary load never shortens its interval.

    Args:
        only_if: whether to do so at all.
    """
    if not only_if:
        yield
        return
    interval = sys.getswitchinterval()
    sys.setswitchinterval(min(interval, BUSY_SWITCH_INTERVAL_S))
    try:
        yield
    finally:
        sys.setswitchinterval(interval)
