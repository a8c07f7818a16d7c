"""`TraceSink`, which stores the events of a recording node.

Events are packed into a ring file (`EventPacker`), departures (T1, T4) stamped in it, so that no message leaves
without its event. A thread moves them to the trace, a chunk every `chunk_seconds` or a quarter of the ring. A slot is
reused only after its chunk is in the file: a killed process loses no event (`recovery`).
"""

from __future__ import annotations

import json
import queue
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace

from dds_trace.base.errors import OutputError
from dds_trace.base.threads import run_in_background

from ..format.bag_metadata import RecordedTopic
from ..format.descriptions import Run, Session
from ..format.events import RUN_TOPIC, SESSION_TOPIC
from ..format.json_fields import Json
from .destination import ClosedTrace, TraceDestination
from .event_chunks import CHUNK_BYTES, Payload, PayloadQueue
from .packing import EventPacker
from .writer import TraceFiles

BUSY_SWITCH_INTERVAL_S = 1e-4
"""Switch interval while another thread fills the ring (see `_quick_switches`)."""


class TraceSink(EventPacker):
    """Trace while it is recorded: a new file, with the description of `session` in state `open` on return."""

    def __init__(
        self, destination: TraceDestination, session: Session, *, clock_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self._session = session
        self._flush_seconds = destination.flush_seconds
        self._error: OutputError | None = None
        self._closed: ClosedTrace | None = None
        self.payloads = PayloadQueue()
        self._texts: deque[tuple[str, str, int]] = deque()  # topic, JSON, log time: not yet in the file
        self._saved_ns = time.monotonic_ns()  # what was recorded until then is in the file
        self._longest_unsaved_ns = 0
        self._measures_unsaved = destination.fsync
        self._is_paused = False
        self._write_lock = threading.Lock()
        files = TraceFiles(destination, session, session.wall_ns(clock_ns()))
        super().__init__(files, clock_ns, queue.SimpleQueue())  # True: drain now; False: the end
        self._thread = threading.Thread(target=self._drain, name="trace-sink", daemon=True)
        self._thread.start()

    def write_run(self, run: Run) -> None:
        self._write(RUN_TOPIC, run.to_json())

    def write_json(self, topic: str, value: Mapping[str, object]) -> None:
        self._write(topic, json.dumps(value))

    def _write(self, topic: str, text: str) -> None:
        with self._write_lock:
            if self._closed is None and not self._is_paused:  # a host sample during a pause is not worth the space
                self._texts.append((topic, text, self._session.wall_ns(self._clock_ns())))
                self._flush()

    def keep_payload(self, topic: RecordedTopic, data: bytes | bytearray, arrival_ns: int) -> None:
        """Keep a message that arrived at a monotonic time; from one thread. It is written later, or counted as left out."""
        before = self.payloads.waiting_bytes
        self.payloads.put(Payload(topic, data, self._session.wall_ns(arrival_ns)))
        if before <= CHUNK_BYTES < self.payloads.waiting_bytes:
            self._wake.put(True)

    @property
    def dropped_events(self) -> int:
        return self._dropped

    @property
    def error(self) -> OutputError | None:
        """First failure of writing, or None. Earlier content stays; the ring continues to fill."""
        return self._error

    @property
    def bytes_written(self) -> int:
        return self._files.writer.bytes_written

    def pause(self) -> None:
        """Write nothing until `resume`: events wait in the ring (its disk space is reserved); when it is full, new ones are dropped."""
        with self._write_lock:
            self._is_paused = self._closed is None

    def resume(self) -> None:
        with self._write_lock:
            self._is_paused = False
            if self._closed is None:
                self._flush()

    def go_on_in(self, destination: TraceDestination, **session_extra: Json) -> ClosedTrace | None:
        """Close the file with `session_extra` and continue in another one, between two events.

        The new files are created first and the old ring is drained afterwards: no event waits for the disk, and a kill
        leaves two whole traces. Return the closed file; None, and nothing changes, if events wait for the disk or the
        sink is closed.
        """
        with self._write_lock:
            if self._closed is not None or not self._flush():
                return None
            part = int(str(self._session.extra.get("part", 1))) + 1
            session = replace(self._session, extra={**self._session.extra, **session_extra, "part": part})
            files = TraceFiles(destination, session, session.wall_ns(self._clock_ns()))
            with self._packing:
                old, head = self._files, self._head
                files.ring.note_dropped(self._dropped)
                self._use(files)
            closed = self._end(old, head, {**session_extra, "followed": True})
            self._session = session
            return closed

    def close(self, **session_extra: Json) -> ClosedTrace:
        """Write what is pending, the closed session with `session_extra` and the summary; delete the ring.

        If that fails, the ring stays, and file and ring together are still a whole trace. Do not call this in a signal handler:
        the interrupted thread may be recording.
        """
        self._wake.put(False)
        self._thread.join()
        with self._write_lock:
            if self._closed is not None:
                return self._closed
            with self._packing:  # from here on every event is dropped, and counted
                head = self._limit = self._attention = self._head
                self._expected = None
            return self._end(self._files, head, session_extra)

    def _end(self, files: TraceFiles, head: int, session_extra: Mapping[str, Json]) -> ClosedTrace:
        """Write the rest up to ticket `head` and the closed session; under the write lock."""
        self._flush_to(files, head)
        if self._measures_unsaved:
            session_extra = {**session_extra, "longest_unsaved_ns": self._longest_unsaved_ns}
        with self._packing:
            session = self._session.closed(self._dropped, **session_extra)
        self._texts.append((SESSION_TOPIC, session.to_json(), session.wall_ns(self._clock_ns())))
        if self._flush_to(files, head):
            error = files.finish()
            self._error = self._error or error
        else:
            files.writer.abandon()
            self._texts.clear()
        with self._packing:
            path, size_bytes, left = files.destination.path, files.writer.bytes_written, head - files.drained
            closed = ClosedTrace(path, files.drained, self._dropped, size_bytes, self._error, left)
            if files is self._files:
                self._closed, self._is_closed = closed, True
            files.ring.close(delete=not closed.ring_events)
        return closed

    def _drain(self) -> None:
        run_in_background()
        going_on = True
        while going_on:
            with suppress(queue.Empty):
                going_on = self._wake.get(timeout=self._flush_seconds)
            with self._write_lock:
                self._flush()

    def _flush(self) -> bool:
        return not self._is_paused and self._flush_to(self._files, self._head)

    def _flush_to(self, files: TraceFiles, head: int) -> bool:
        """Move the events up to ticket `head`, then the texts; under the write lock."""
        start_ns, before = time.monotonic_ns(), files.drained
        try:
            with _quick_switches(only_if=head - before >= self._quarter):
                while files.drained < head:
                    files.move_chunk(head)
                    if files is self._files:
                        self._limit = files.drained + self._slot_count
                        self._attention = files.drained + self._quarter
            if head > before:
                self._longest_unsaved_ns = max(self._longest_unsaved_ns, time.monotonic_ns() - self._saved_ns)
            self._saved_ns = start_ns
            while batch := self.payloads.first():
                files.writer.write_payloads(batch)
                self.payloads.remove(batch)
            while self._texts:
                files.writer.write_text(*self._texts[0])
                self._texts.popleft()
        except OutputError as err:
            self._error = self._error or err
            return False
        return True


@contextmanager
def _quick_switches(*, only_if: bool) -> Iterator[None]:
    """Shorten the switch interval: a busy thread releases the GIL every 5 ms, and a chunk needs it some twenty times:
    65536 slots would fill meanwhile.
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
