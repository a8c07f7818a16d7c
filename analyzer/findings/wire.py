"""Findings about the wire: what a message cost there, and what its repeats say of the settings."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypedDict, cast

from dds_trace.tracefile.units.counts import counted
from dds_trace.tracefile.units.durations import format_ms

from ..model.finding import Finding, Severity
from .evidence import percent

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .evidence import Evidence

STORM_SHARE = 0.2
"""Share of the bytes on the wire, sent again, above which repeating is a load of its own."""

HEARTBEATS_WAITED = 2
"""Heartbeat periods after which a repetition came because of the heartbeat, and not of a request at once."""

FEWEST_AGAIN = 5
"""Messages sent again that are enough to speak of their median."""

DISCOVERY_SHARE, DISCOVERY_BYTES_PER_MINUTE = 0.25, 100_000
"""Share of the bytes, and bytes a minute, above which discovery is out of proportion; few messages alone are not."""


class _Row(TypedDict):
    """A row of `Details.wire`, as far as the checks read it."""

    group: int
    complete: bool
    kernel_drops: int
    again_bytes_share: float | None
    messages: int
    again_messages: int
    requests: int
    resent_after_p50_ns: float | None
    waited_heartbeats_p50: float | None
    discovery_share: float | None
    discovery_bytes_per_minute: float | None


def incomplete_captures(evidence: Evidence) -> Iterator[Finding]:
    """Report groups of which the kernel dropped packets: nothing else is said of their wire."""
    for row in _rows(evidence):
        if row["complete"]:
            continue
        yield Finding(
            Severity.WARNING,
            "wire_incomplete",
            evidence.group_names[row["group"]],
            f"The capture of the wire missed {counted(row['kernel_drops'], 'packet')} that the kernel dropped: its "
            "counts are lower bounds, and prove nothing about repeats.",
            "Record with fewer bytes a second, or on a machine with a processor to spare.",
            (row["group"],),
        )


def retransmission_storms(evidence: Evidence) -> Iterator[Finding]:
    """Report groups of which repeated data were a large part of all bytes."""
    for row in _complete_rows(evidence):
        share = row["again_bytes_share"]
        if share is None or share <= STORM_SHARE:
            continue
        asked = f"; readers asked {counted(row['requests'], 'time')}" if row["requests"] else ""
        yield Finding(
            Severity.WARNING,
            "retransmission_storm",
            evidence.group_names[row["group"]],
            f"{percent(share, 1)} of the bytes on the wire were sent again, "
            f"{row['again_messages']} of {counted(row['messages'], 'message')}{asked}.",
            "Repeats take the room of new messages: lower the rate or --depth, give the sockets larger buffers (--tuned, "
            "net.core.rmem_max), or send best effort where a lost message may stay lost.",
            (row["group"],),
        )


def heartbeat_bound_recoveries(evidence: Evidence) -> Iterator[Finding]:
    """Report groups whose lost messages were sent again only after heartbeats of their writer."""
    for row in _complete_rows(evidence):
        waited, delay_ns = row["waited_heartbeats_p50"], row["resent_after_p50_ns"]
        if row["again_messages"] < FEWEST_AGAIN or waited is None or delay_ns is None:
            continue
        if waited < HEARTBEATS_WAITED:
            continue
        yield Finding(
            Severity.WARNING,
            "heartbeat_bound_recovery",
            evidence.group_names[row["group"]],
            f"{row['again_messages']} of {counted(row['messages'], 'message')} were sent again; half of them waited for "
            f"{waited:g} heartbeat periods, {format_ms(delay_ns)} ms, or longer.",
            "Shorten the writer's heartbeat period: heartbeat_period in a Fast DDS profile, "
            "Internal/HeartbeatInterval of Cyclone DDS.",
            (row["group"],),
        )


def discovery_traffic(evidence: Evidence) -> Iterator[Finding]:
    """Report groups of whose bytes discovery took a large part."""
    for row in _complete_rows(evidence):
        share, rate = row["discovery_share"], row["discovery_bytes_per_minute"]
        if share is None or rate is None:
            continue
        if share <= DISCOVERY_SHARE or rate <= DISCOVERY_BYTES_PER_MINUTE:
            continue
        yield Finding(
            Severity.WARNING,
            "discovery_traffic",
            evidence.group_names[row["group"]],
            f"Discovery took {percent(share, 1)} of the bytes on the wire, {rate / 1000:.0f} KB a minute.",
            "Use a discovery server, fewer participants (nodes in one process) or a longer lease and announcement period.",
            (row["group"],),
        )


def _rows(evidence: Evidence) -> Iterator[_Row]:
    return cast("Iterator[_Row]", evidence.details.wire.iter_rows(named=True))


def _complete_rows(evidence: Evidence) -> Iterator[_Row]:
    return (row for row in _rows(evidence) if row["complete"])
