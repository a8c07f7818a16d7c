"""The events that a killed recorder left in the ring beside its trace, as a batch behind those of the file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..errors import TraceFormatError
from ..format.events import EVENT_DTYPE
from ..format.ring import STAGE_NUMBERS, TICKET_MASK, read_ring, ring_path
from ..units.counts import counted
from .source import Batch

if TYPE_CHECKING:
    from pathlib import Path

    from ..format.ring import RingContents


@dataclass(frozen=True, slots=True)
class RingBeside:
    """The ring beside one file of a trace.

    Attributes:
        contents: all that is in it; None if it cannot be read.
        fault: why it cannot be read.
    """

    contents: RingContents | None
    fault: str | None = None

    def batch(self, events_in_file: int) -> Batch:
        """The events that the file does not have, of which the recorder had written `events_in_file` to it."""
        if self.contents is None:
            return Batch(notes=[self.fault] if self.fault else [])
        slots = self.contents.slots
        slots = slots[(slots["mark"] & TICKET_MASK) >= events_in_file]
        batch = Batch()
        for number, stage in STAGE_NUMBERS.items():
            events = slots["event"][slots["stage"] == number]
            if len(events):
                batch.events.append((stage, np.frombuffer(events.tobytes(), EVENT_DTYPE)))
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
    """The ring of a storage file, None if there is none. To be called before the file is opened.

    In this order nothing is missed where the recorder still lives: an event that has left the ring when it is read
    is in the file when that is read. The other way round it could be in neither.
    """
    path = ring_path(file)
    try:
        contents = read_ring(path, 0)
    except FileNotFoundError:
        return None
    except (TraceFormatError, OSError) as err:
        return RingBeside(None, f"the ring beside it is not used: {err}")
    return RingBeside(contents) if contents else None
