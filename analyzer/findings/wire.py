"""Findings about the wire: what a message cost there, and what its repeats say of the settings."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypedDict, cast

from dds_trace.base.units import counted, format_ms

from ..model.applied import may_be_cut
from ..model.finding import Finding, Severity
from .evidence import SMALLER_DATAGRAMS, percent

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .evidence import Evidence

STORM_SHARE = 0.2
"""Share of the bytes on the wire, sent again, above which repeating is a load of its own: a link that was four fifths full
without it is full."""

AGAIN_SHARE = 0.1
"""Share of the messages, sent again, above which p90 and all above it are latencies of repeats."""

HEARTBEATS_WAITED = 2
"""Heartbeat periods after which a repetition came because of the heartbeat, and not of a request at once."""

FEWEST_AGAIN = 5
"""Messages sent again that are enough to speak of their median, and more than the first ones behind a match."""

DISCOVERY_SHARE, DISCOVERY_BYTES = 0.25, 100_000
"""Share above which discovery is out of proportion, of the bytes on the wire or of the payload, whichever is more: payload in
shared memory leaves discovery alone on the wire. And bytes a minute, in the first minute of a run at least, below which no
link feels it: 13 kbit/s. A pair of Fast DDS on one machine announces itself with 64 KB."""


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
    runs: int
    total_bytes: int
    payload_bytes: int
    reassembly_failed: int
    udp_receive_buffer_full: int
    shared_counts: int


def incomplete_captures(evidence: Evidence) -> Iterator[Finding]:
    """Report groups of which the kernel dropped packets: nothing else is said of their wire."""
    for row in _rows(evidence):
        if row["complete"]:
            continue
        failed = row["reassembly_failed"]
        beside = f" The kernel counted {_not_joined(failed)}." if failed else ""
        yield Finding(
            Severity.WARNING,
            "wire_incomplete",
            evidence.group_names[row["group"]],
            f"The capture of the wire missed {counted(row['kernel_drops'], 'packet')} that the kernel dropped: its "
            f"counts are lower bounds, and prove nothing about repeats.{beside}",
            "Record with fewer bytes a second, or on a machine with a processor to spare.",
            (row["group"],),
        )


def shared_counts(evidence: Evidence) -> Iterator[Finding]:
    """Report groups of whose relay nobody knows what its capture counted for them."""
    for row in _rows(evidence):
        if row["shared_counts"]:
            yield Finding(
                Severity.INFO,
                "wire_counts_shared",
                evidence.group_names[row["group"]],
                f"{counted(row['shared_counts'], 'count')} of the relay's capture {'is' if row['shared_counts'] == 1 else 'are'} "
                "of runs of other groups, too: the relay's requests and datagrams that were lost there are left out here.",
                "Leave two seconds without a message between runs, or give each run a relay of its own.",
                (row["group"],),
            )


def retransmission_storms(evidence: Evidence) -> Iterator[Finding]:
    """Report groups of which repeated data were a large part of all bytes, or repeated messages of all messages."""
    for row in _complete_rows(evidence):
        of_bytes = row["again_bytes_share"] or 0.0
        of_messages = row["again_messages"] / row["messages"] if row["messages"] else 0.0
        if of_bytes <= STORM_SHARE and (of_messages <= AGAIN_SHARE or row["again_messages"] < FEWEST_AGAIN):
            continue
        asked = f"; readers asked {counted(row['requests'], 'time')}" if row["requests"] else ""
        yield Finding(
            Severity.WARNING,
            "retransmission_storm",
            evidence.group_names[row["group"]],
            f"{percent(of_bytes, 1)} of the bytes on the wire were sent again, "
            f"{row['again_messages']} of {counted(row['messages'], 'message')}{asked}.",
            f"Repeats take the room of new messages, and latency waits for them: {_remedy(row)}.",
            (row["group"],),
            effect=max(of_bytes, of_messages),
        )


def _remedy(row: _Row) -> str:
    """Tell what to set against repeats, by what the kernels saw."""
    if row["udp_receive_buffer_full"]:
        return (
            f"{counted(row['udp_receive_buffer_full'], 'datagram')} found a full receive buffer, so give the sockets larger "
            "ones (--tuned, net.core.rmem_max)"
        )
    if row["reassembly_failed"]:
        return f"{_not_joined(row['reassembly_failed'])}, so {SMALLER_DATAGRAMS}"
    return (
        "neither kernel counted a lost datagram, so look at the link: lower the rate or --depth, or send best effort where a "
        "lost message may stay lost"
    )


def lost_fragments(evidence: Evidence) -> Iterator[Finding]:
    """Report groups whose datagrams were cut into IP fragments, and could not be put together while they were captured."""
    cut = {
        group
        for exchange, group in zip(evidence.grouping.exchanges, evidence.exchange_groups(), strict=True)
        for session in (exchange.ping, exchange.relay)
        if session is not None and may_be_cut(session, exchange.run.payload_bytes)
    }
    for row in _complete_rows(evidence):
        if row["reassembly_failed"] and row["group"] in cut:
            yield Finding(
                Severity.WARNING,
                "fragments_lost",
                evidence.group_names[row["group"]],
                f"While its messages were under way, the kernels of both sides counted {_not_joined(row['reassembly_failed'])}.",
                f"One lost fragment loses its whole datagram: {SMALLER_DATAGRAMS}.",
                (row["group"],),
            )


def _not_joined(datagrams: int) -> str:
    return f"{counted(datagrams, 'datagram')} that could not be put together from IP fragments"


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
            effect=row["again_messages"] / row["messages"],
        )


def discovery_traffic(evidence: Evidence) -> Iterator[Finding]:
    """Report groups of whose bytes discovery took a large part."""
    for row in _complete_rows(evidence):
        share, rate = row["discovery_share"], row["discovery_bytes_per_minute"]
        if share is None or rate is None:
            continue
        discovery_bytes = share * row["total_bytes"]
        minutes = max(discovery_bytes / rate, row["runs"]) if rate else 0.0
        in_proportion = discovery_bytes <= DISCOVERY_SHARE * max(row["total_bytes"], row["payload_bytes"])
        if in_proportion or discovery_bytes <= DISCOVERY_BYTES * minutes:
            continue
        yield Finding(
            Severity.WARNING,
            "discovery_traffic",
            evidence.group_names[row["group"]],
            f"Discovery took {percent(share, 1)} of the bytes on the wire, {rate / 1000:.0f} KB a minute.",
            "Use a discovery server, fewer participants (nodes in one process) or a longer lease and announcement period.",
            (row["group"],),
            effect=share,
        )


def _rows(evidence: Evidence) -> Iterator[_Row]:
    return cast("Iterator[_Row]", evidence.details.wire.iter_rows(named=True))


def _complete_rows(evidence: Evidence) -> Iterator[_Row]:
    return (row for row in _rows(evidence) if row["complete"])
