"""The state of a tap's topics as `diagnostic_msgs/msg/DiagnosticArray`, which a robot's own monitors read."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from dds_trace.base.units import SECOND_NS, format_duration
from dds_trace.tracefile.format.descriptions import Qos

from ..payloads.cdr import CdrWriter
from ..roles.live import Health, LiveRow, LiveTable

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..backends.node import Node

TOPIC, TYPE_NAME = "diagnostics", "diagnostic_msgs/msg/DiagnosticArray"
_LEVELS = {Health.OK: 0, Health.LATE: 1, Health.STALE: 3}
"""OK, WARN and STALE of `diagnostic_msgs/msg/DiagnosticStatus`."""


def open_diagnostics(node: Node, device: str) -> Callable[[LiveTable], None]:
    """Return the function that publishes a table.

    Raises:
        BackendUnavailableError: `diagnostic_msgs` is not installed.
        OptionError: the backend does not have the type.
    """
    publisher = node.create_publisher(TOPIC, TYPE_NAME, qos=Qos())
    return lambda table: publisher.publish(diagnostic_array(table.rows(), device, time.time_ns()))


def diagnostic_array(rows: tuple[LiveRow, ...], device: str, wall_ns: int) -> bytearray:
    """Return the serialized message of a table at a wall time."""
    writer = CdrWriter()
    writer.uint32(wall_ns // SECOND_NS)
    writer.uint32(wall_ns % SECOND_NS)
    writer.string(b"")
    writer.uint32(len(rows))
    for row in rows:
        values = {
            "rate_hz": f"{row.rate_hz:.3g}",
            "expected_hz": "" if row.expected_hz is None else f"{row.expected_hz:.3g}",
            "age": format_duration(row.age_ns),
            "age_p99": format_duration(row.age_p99_ns),
            "missing": str(row.missing),
        }
        writer.uint8(_LEVELS[row.health])
        for text in (f"dds-trace: {row.topic}", row.health.value, device):
            writer.string(text.encode())
        writer.uint32(len(values))
        for key, value in values.items():
            writer.string(key.encode())
            writer.string(value.encode())
    return writer.message()
