"""A recording's trace, rotation, disk, and reports to systemd and `dds-trace record status`."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterable, MutableMapping
from contextlib import AbstractContextManager, suppress
from dataclasses import replace
from types import TracebackType

from dds_trace.base.errors import OutputError, OutputExistsError
from dds_trace.base.printable import MAX_FINDING_CHARACTERS, printable
from dds_trace.base.units import counted
from dds_trace.recorder.option import Rotation
from dds_trace.recorder.options import RecordOptions
from dds_trace.tracefile.format.descriptions import Session
from dds_trace.tracefile.format.json_fields import Json, JsonObject
from dds_trace.tracefile.writing.destination import ClosedTrace, TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink

from .rotation import RotatedFiles, find_shortage
from .running import RunningRecording

STATUS_PERIOD_S = 5.0
"""Time between two statuses: each wakes the manager."""

RETRY_S = 60.0


class ServiceManager:
    """The protocol of sd_notify(3); without a manager at NOTIFY_SOCKET every method does nothing.

    The library sdnotify blocks while the manager is stuck, and drops statuses that are not Latin-1. Variables are
    removed, so that child processes do not notify.
    """

    def __init__(
        self, environment: MutableMapping[str, str] = os.environ, clock_s: Callable[[], float] = time.monotonic
    ) -> None:
        address = environment.pop("NOTIFY_SOCKET", "")
        watchdog_us, for_pid = environment.pop("WATCHDOG_USEC", ""), environment.pop("WATCHDOG_PID", "")
        self._clock_s = clock_s
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._is_watched = watchdog_us.isdecimal() and for_pid in ("", str(os.getpid()))
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) if address else None
        self._is_ready = False
        self._status_s = -STATUS_PERIOD_S
        if self._socket is not None:
            self._socket.setblocking(False)  # a stuck manager must not block the recording

    def notify(self, status: str) -> None:
        if self._socket is None:
            return
        assignments = ["WATCHDOG=1"] if self._is_watched else []
        if not self._is_ready:
            self._is_ready = True
            assignments.insert(0, "READY=1")
        if self._clock_s() - self._status_s >= STATUS_PERIOD_S:
            self._status_s = self._clock_s()
            assignments.append(f"STATUS={printable(status, MAX_FINDING_CHARACTERS)}")
        self._send(assignments)

    def close(self) -> None:
        if self._socket is not None:
            self._send(["STOPPING=1"])
            self._socket.close()
            self._socket = None

    def _send(self, assignments: list[str]) -> None:
        if self._socket is not None and assignments:
            with suppress(OSError):
                self._socket.sendto("\n".join(assignments).encode(errors="replace"), self._address)


class Upkeep(AbstractContextManager["Upkeep"]):
    """Opens a recording's sink, and closes it on exit; with `-o rotate` its session's `part` counts the files from 1."""

    def __init__(
        self, options: RecordOptions, session: Session, clock_ns: Callable[[], int], note: Callable[[str], None]
    ) -> None:
        self._options = options
        self._note = note
        self._rotation = options.rotation
        self._files = RotatedFiles(options.destination, session.session_id)
        self._count = 1
        self._closed_events = self._closed_bytes = 0  # of all files but the last
        self._failed_s: float | None = None
        self.shortage: OutputError | None = None
        self._short: OutputError | None = None  # while the disk is short
        self._dropped = 0  # events dropped before the disk became short
        shortage = find_shortage(options.destination.trace_path, options.keep_free)
        if shortage is not None:
            raise shortage
        destination = options.destination
        if self._rotation is not None:
            destination = self._files.next()
            session = replace(session, extra={**session.extra, "part": 1})
        self.destination = destination
        self.sink = TraceSink(destination, session, clock_ns=clock_ns)
        self._began_s = time.monotonic()
        self._manager = ServiceManager()
        self._running = RunningRecording(session, destination.path)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._manager.close()
        if error is None or isinstance(error, KeyboardInterrupt | SystemExit):
            self.sink.close()
        else:  # also a panic of Rust below zenoh, which is no Exception
            self.sink.close(error=str(error) or type(error).__name__)
        self._running.close()

    def look(self, messages: int, describe: Callable[[], JsonObject]) -> None:
        was_short = self._short is not None
        shortage = find_shortage(self.destination.trace_path, self._options.keep_free, was_short=was_short)
        self._blame_disk()
        self._short = shortage
        if (shortage is not None) != was_short:
            self._stop_or_go_on(shortage)
        elif shortage is None and self._rotation is not None and self._is_due(self._rotation):
            self._rotate(self._rotation, describe)
        self._blame_disk()
        stopped = None if shortage is None else str(shortage)
        self._running.update(path=self.destination.path, messages=messages, files=self._count, stopped=stopped)
        activity = f"into {self.destination.path}" if stopped is None else f"waiting for disk space: {stopped}"
        self._manager.notify(f"{counted(messages, 'message')}, {activity}")

    def report(self, causes: Iterable[str]) -> None:
        self._running.causes = tuple(causes)

    def close_trace(self, **described: Json) -> ClosedTrace:
        """Close the last file; the result has the events and bytes of all."""
        self._blame_disk()
        is_stopped = self.shortage is not None and self._options.ping is None
        stopped: JsonObject = {"stopped": str(self.shortage)} if is_stopped else {}
        closed = self.sink.close(**described, **stopped)
        return replace(closed, events=closed.events + self._closed_events, bytes=closed.bytes + self._closed_bytes)

    def _blame_disk(self) -> None:
        if self._options.ping is not None or self.sink.dropped_events > self._dropped:
            self.shortage = self.shortage or self._short

    def _stop_or_go_on(self, shortage: OutputError | None) -> None:
        if shortage is None:
            self.sink.resume()
            self._note("there is disk space again: writing continues")
        elif self._options.ping is None:
            self.sink.pause()
            self._dropped = self.sink.dropped_events
            self._note(f"{shortage}; until then events wait in the ring, and the relay keeps replying")
        else:
            self._note(f"{shortage}; the run ends here")

    def _is_due(self, rotation: Rotation) -> bool:
        now_s = time.monotonic()
        if self._failed_s is not None and now_s - self._failed_s < RETRY_S:
            return False
        is_large = rotation.file_bytes is not None and self.sink.bytes_written >= rotation.file_bytes
        return is_large or (rotation.age_s is not None and now_s - self._began_s >= rotation.age_s)

    def _rotate(self, rotation: Rotation, describe: Callable[[], JsonObject]) -> None:
        try:
            destination = self._go_on(describe())
        except OutputError as err:
            if self._failed_s is None:
                self._note(f"{err}; the recording continues in {self.destination.path.name}")
            self._failed_s = time.monotonic()
            return
        if destination is None:
            return
        self._failed_s, self._began_s = None, time.monotonic()
        self.destination = destination
        self._count += 1
        dropped = [] if rotation.keep is None else self._files.drop_oldest(rotation.keep)
        deleted = f"; deleted {', '.join(path.name for path in dropped)} (-o keep={rotation.keep})" if dropped else ""
        self._note(f"the recording continues in {self.destination.path.name}{deleted}")

    def _go_on(self, described: JsonObject) -> TraceDestination | None:
        while True:
            destination = self._files.next()
            try:
                closed = self.sink.go_on_in(destination, **described)
            except OutputExistsError:  # another recording made a file of this name
                continue
            if closed is None:
                return None
            self._closed_events += closed.events
            self._closed_bytes += closed.bytes
            return destination
