"""`TraceFiles`: the file of a trace and the ring beside it, while they are written."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dds_trace.base.errors import OutputError
from dds_trace.base.files import output_error

from ..format.bag_metadata import METADATA_NAME, write_metadata
from ..format.events import SESSION_TOPIC
from ..format.ring import Ring, ring_path
from .destination import ClosedTrace, keep_names, make_room
from .writer import MAX_CHUNK_EVENTS, TraceWriter

if TYPE_CHECKING:
    from ..format.descriptions import Session
    from .destination import TraceDestination


class TraceFiles:
    """A new trace file that describes its session, and its empty ring.

    Args:
        destination: the file or folder, and how it is written.
        session: the recording process, in state `open`.
        time_ns: log time of its description, ns since 1970.

    Attributes:
        writer: the file.
        ring: the ring; its tickets count from 0.
        drained: number of events in the file; all tickets below.

    Raises:
        OutputExistsError: the destination exists already and `force` was not given.
        OutputError: the files cannot be made; none is left then.
    """

    def __init__(self, destination: TraceDestination, session: Session, time_ns: int) -> None:
        self._destination = destination
        self.drained = 0
        trace = destination.trace_path
        make_room(destination)
        self.writer = TraceWriter(trace, session, fsync=destination.fsync, mode=destination.mode)
        try:
            self.writer.write_text(SESSION_TOPIC, session.to_json(), time_ns)
            self.ring = Ring(ring_path(trace), destination.ring_slots, session, mode=destination.mode)
            keep_names(destination)
        except (OutputError, OSError) as err:
            self.writer.abandon()
            trace.unlink(missing_ok=True)
            raise (err if isinstance(err, OutputError) else output_error(ring_path(trace), err)) from err

    def move_chunk(self, head: int) -> None:
        """Move the next chunk of the ring's events below ticket `head` to the file.

        Raises:
            OutputError: it cannot be written; the events stay in the ring.
        """
        slots = self.ring.pending(self.drained, min(head, self.drained + MAX_CHUNK_EVENTS))
        self.writer.write_events(slots)
        self.drained += len(slots)

    def finish(self) -> OutputError | None:
        """Close the file with its summary, everything being in it; return what kept it from that."""
        try:
            self.writer.finish()
            if self._destination.is_bag:
                write_metadata(
                    self.writer.path,
                    self.writer.topics,
                    self.writer.time_range_ns,
                    mode=self._destination.mode,
                    fsync=self._destination.fsync,
                )
        except OutputError as err:
            self.writer.abandon()
            return err
        except OSError as err:
            return output_error(self.writer.path.with_name(METADATA_NAME), err)
        return None

    def closed(self, head: int, dropped_events: int, error: OutputError | None) -> ClosedTrace:
        """Return the result, with the events up to ticket `head` that stay in the ring."""
        return ClosedTrace(
            path=self._destination.path,
            events=self.drained,
            dropped_events=dropped_events,
            bytes=self.writer.bytes_written,
            error=error,
            ring_events=head - self.drained,
        )
