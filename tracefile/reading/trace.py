"""What one trace file holds once it is read: the value that passes from `tracefile` to `analyzer`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from ..format.descriptions import Run, Session
    from ..format.events import EventColumns, Stage
    from ..format.json_values import JsonObject


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """One trace: a `.mcap` file (with the ring beside it, if one was left) or a rosbag2 folder.

    Attributes:
        path: the file or folder it was read from.
        sessions: the recording processes named in it, latest description of each, in order of appearance.
        runs: the runs named in it, latest description of each, in order of appearance.
        events: the events of every stage, in file order; a stage without events is there and empty.
        host_samples: the JSON objects of `/dds_trace/host`, each with its `log_time_ns` (wall clock).
        truncated: None, or why the file ends early; all that was complete before is in `events`.
        ring_events: how many of the events came from a ring file that a killed recorder left behind.
        unreadable_messages: messages on event topics that are not events (wrong length or encoding).
        notes: anything else that a reader of the numbers should be told, one line each.
    """

    path: Path
    sessions: tuple[Session, ...]
    runs: tuple[Run, ...]
    events: Mapping[Stage, EventColumns]
    host_samples: tuple[JsonObject, ...] = ()
    truncated: str | None = None
    ring_events: int = 0
    unreadable_messages: int = 0
    notes: tuple[str, ...] = field(default=())

    @property
    def event_count(self) -> int:
        """Events of all stages."""
        return sum(len(columns) for columns in self.events.values())
