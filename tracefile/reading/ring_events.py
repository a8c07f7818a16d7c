"""Events that a killed recorder left in the ring beside its trace, as a batch behind those of the file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.units import counted

from ..format.ring import TICKET_MASK, events_by_stage, read_ring, ring_path
from .source import Batch

if TYPE_CHECKING:
    from pathlib import Path

    from ..format.ring import RingContents


@dataclass(frozen=True, slots=True)
class RingBeside:
    """Ring beside one file of a trace.

    Attributes:
        contents: the whole content of the ring; None if it cannot be read.
        fault: the reason why it cannot be read, or None.
    """

    contents: RingContents | None
    fault: str | None = None

    def batch(self, events_in_file: int) -> Batch:
        """Return the events that the file lacks, given the number of events that the recorder had written to it."""
        if self.contents is None:
            return Batch(notes=[self.fault] if self.fault else [])
        slots = self.contents.slots
        slots = slots[(slots["mark"] & TICKET_MASK) >= events_in_file]
        batch = Batch(events_by_stage(slots))
        if len(slots):
            last = int(slots["mark"][-1] & TICKET_MASK)
            missing = last + 1 - events_in_file - len(slots)
            if missing:
                batch.notes.append(
                    f"{counted(missing, 'event is', 'events are')} neither in the file nor in the ring beside it"
                )
        if self.contents.recording:
            batch.notes.append("still being recorded; these are the events up to now")
        return batch


def ring_beside(file: Path) -> RingBeside | None:
    """Read the ring of a storage file; call this before the file is opened.

    In this order no event is missed while the recorder still lives: an event that has left the ring when the ring is
    read is in the file when the file is read. The other way round it could be in neither.

    Returns:
        None if there is no ring, or none with an event.
    """
    path = ring_path(file)
    try:
        contents = read_ring(path, 0)
    except FileNotFoundError:
        return None
    except (TraceFormatError, OSError) as err:
        return RingBeside(None, f"the ring beside it is not used: {err}")
    return RingBeside(contents) if contents else None
