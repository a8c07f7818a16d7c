"""What a tap takes of the processor, measured over its whole life."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from dds_trace.base.units import format_duration

if TYPE_CHECKING:
    from dds_trace.tracefile.format.json_fields import JsonObject


@dataclass(frozen=True, slots=True)
class OwnCost:
    """Processor time of this process, all threads, in a duration, ns."""

    cpu_ns: int
    duration_ns: int
    messages: int

    def to_json(self) -> JsonObject:
        """Return the session's field `own_cost`."""
        return asdict(self)

    @property
    def words(self) -> str:
        """One line for the user."""
        share = self.cpu_ns / max(self.duration_ns, 1)
        each = f", {format_duration(self.cpu_ns / self.messages)} for each message" if self.messages else ""
        return f"the tap itself used {share:.1%} of one core{each}"


class OwnUse:
    """Counts from its making."""

    def __init__(self) -> None:
        self._cpu_ns, self._start_ns = time.process_time_ns(), time.monotonic_ns()

    def taken(self, messages: int) -> OwnCost:
        """Return the cost so far."""
        return OwnCost(time.process_time_ns() - self._cpu_ns, time.monotonic_ns() - self._start_ns, messages)
