"""Checks of the devices: clocks that jump, stop or drift, processors that are overloaded."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

from dds_trace.tracefile.units.counts import counted

from ..model.finding import Finding, Severity

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .evidence import Evidence

_SATURATED_PERCENT = 95.0
_SATURATED_SHARE = 0.1
"""Share of samples with a busy processor from which on it delays messages, though no median shows it."""


def cpu_saturation(evidence: Evidence) -> Iterator[Finding]:
    """Report devices with a processor that was busy in many samples."""
    busy: dict[int, list[float]] = defaultdict(list)
    samples = evidence.details.host_samples.select("session_id", "cpu_busiest_percent").drop_nulls()
    for session_id, percent in samples.iter_rows():
        busy[session_id].append(percent)
    for session_id, percents in busy.items():
        full = sum(percent >= _SATURATED_PERCENT for percent in percents)
        if full > _SATURATED_SHARE * len(percents):
            yield Finding(
                Severity.WARNING,
                "cpu_saturated",
                evidence.session_name(evidence.campaign.sessions[session_id]),
                f"In {full} of {counted(len(percents), 'second')} a processor was busy to at least {_SATURATED_PERCENT:g} %.",
                "Latencies here hold time spent waiting for the processor: lower rate or size, or free the device.",
            )
