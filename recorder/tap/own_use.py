"""What a tap takes of the processor, all threads of this process."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from dds_trace.base.units import format_duration

if TYPE_CHECKING:
    from dds_trace.tracefile.format.json_fields import JsonObject


class OwnUse:
    """Counts from its making."""

    def __init__(self) -> None:
        self._cpu_ns, self._start_ns = time.process_time_ns(), time.monotonic_ns()

    def taken(self, messages: int) -> tuple[JsonObject, str]:
        """Return the session's field `own_cost` so far, and one line for the user."""
        cpu_ns, duration_ns = time.process_time_ns() - self._cpu_ns, time.monotonic_ns() - self._start_ns
        of_message = f", {format_duration(cpu_ns / messages)} for each message" if messages else ""
        words = f"the tap itself used {cpu_ns / max(duration_ns, 1):.1%} of one core{of_message}"
        return {"cpu_ns": cpu_ns, "duration_ns": duration_ns, "messages": messages}, words
