"""Checks of the load of the devices: no processor left for the messages."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from dds_trace.tracefile.units.counts import counted

from ..model.finding import Finding, Severity

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .evidence import Evidence

_FREE_PROCESSORS = 0.5
"""Free processors of the machine, mean of a second, below which a woken thread often finds none: with one of 64 busy, 63 are."""

_FULL_PERCENT = 95.0
"""Share of one processor from which on the recording process has none left: Python runs on one at a time."""

_SATURATED_SHARE = 0.1
"""Share of seconds from which on it delays messages that percentiles show, though no median does."""

_SATURATED_SECONDS = 2
"""Seconds at least: the first one of a short recording holds its start."""


def cpu_saturation(evidence: Evidence) -> Iterator[Finding]:
    """Report recordings in many seconds of which the machine, or the one processor of the process, was full."""
    full = (pl.col("cpu_free_processors") < _FREE_PROCESSORS, pl.col("node_cpu_percent") >= _FULL_PERCENT)
    words = (
        f"the machine had less than {_FREE_PROCESSORS:g} processors free",
        f"the recording process filled a processor to at least {_FULL_PERCENT:g} %",
    )
    counts = evidence.details.host_samples.group_by("session_id", maintain_order=True).agg(
        pl.len().alias("seconds"), *(each.sum().alias(str(cause)) for cause, each in enumerate(full))
    )
    for session_id, seconds, *of_cause in counts.iter_rows():
        most = max(of_cause)
        if most >= _SATURATED_SECONDS and most > _SATURATED_SHARE * seconds:
            yield Finding(
                Severity.WARNING,
                "cpu_saturated",
                evidence.session_name(evidence.campaign.sessions[session_id]),
                f"In {most} of {counted(seconds, 'second')} {words[of_cause.index(most)]}.",
                "Latencies here hold time spent waiting for the processor: lower rate or size, or free the device.",
                evidence.groups_of_sessions.get(session_id, ()),
                effect=most / seconds,
            )
