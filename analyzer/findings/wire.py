"""Traffic on the wire."""

from __future__ import annotations

from collections.abc import Iterator

from dds_trace.base.units import counted, three_digits

from ..model.applied import may_be_cut
from ..model.finding import Severity, Subject
from .evidence import SMALLER_DATAGRAMS, Evidence, Observation, check, percent
from .rows import Row, Rows, in_result

WIRE = Rows(Subject.RESULT, lambda evidence: evidence.details.wire, in_result)


def _complete_rows(evidence: Evidence) -> Iterator[Row]:
    return evidence.details.wire.filter("complete").iter_rows(named=True)


@check(
    "fragments_lost",
    Severity.WARNING,
    Subject.RESULT,
    f"One lost fragment loses its whole datagram: {SMALLER_DATAGRAMS}.",
)
def lost_fragments(evidence: Evidence) -> Iterator[Observation]:
    """A result's datagrams lost IP fragments."""
    cut = {
        group
        for exchange, group in evidence.exchanges_by_group()
        for session in (exchange.ping, exchange.relay)
        if session is not None and may_be_cut(session, exchange.run.payload_bytes)
    }
    for row in _complete_rows(evidence):
        if row["reassembly_failed"] and row["group"] in cut:
            yield evidence.result(
                row["group"],
                f"While its messages were under way, the kernels of both sides counted {_not_joined(row['reassembly_failed'])}.",
            )


def _not_joined(datagrams: int) -> str:
    return f"{counted(datagrams, 'datagram')} that could not be put together from IP fragments"


STORM_SHARE = 0.2
"""Share of repeats in the bytes on the wire: a link four fifths full without them is full."""

AGAIN_SHARE = 0.1
"""Share of repeated messages above which p90 is the latency of a repeat."""

FEWEST_AGAIN = 5
"""Enough for a median, and more than the first ones after a match."""


@check(
    "retransmission_storm",
    Severity.WARNING,
    Subject.RESULT,
    "Repeats take the room of new messages, and latency waits for them: {remedy}.",
)
def retransmission_storms(evidence: Evidence) -> Iterator[Observation]:
    """Much of the traffic is repeats."""
    for row in _complete_rows(evidence):
        byte_share = row["again_bytes_share"] or 0.0
        message_share = row["again_messages"] / row["messages"] if row["messages"] else 0.0
        has_many = message_share > AGAIN_SHARE and row["again_messages"] >= FEWEST_AGAIN
        if byte_share > STORM_SHARE or has_many:
            requests = f"; readers asked {counted(row['requests'], 'time')}" if row["requests"] else ""
            yield evidence.result(
                row["group"],
                f"{percent(byte_share, 1)} of the bytes on the wire were sent again, "
                f"{row['again_messages']} of {counted(row['messages'], 'message')}{requests}.",
                max(byte_share, message_share),
                remedy=_remedy(row),
            )


def _remedy(row: Row) -> str:
    if row["udp_receive_buffer_full"]:
        return (
            f"{counted(row['udp_receive_buffer_full'], 'datagram')} met a full receive buffer, so give the sockets larger "
            "ones (--tuned, net.core.rmem_max)"
        )
    if row["reassembly_failed"]:
        return f"{_not_joined(row['reassembly_failed'])}, so {SMALLER_DATAGRAMS}"
    return (
        "neither kernel counted a lost datagram, so look at the link: a lower rate or --depth may help, or best effort where a "
        "lost message may stay lost"
    )


HEARTBEATS_WAITED = 2
"""Heartbeat periods after which a heartbeat, no request, caused the repeat."""

DISCOVERY_SHARE, DISCOVERY_BYTES = 0.25, 100_000
"""Share of discovery in the larger of wire bytes and payload (which may be in shared memory), and bytes a minute that no
link feels: 13 kbit/s; two Fast DDS participants on one machine announce themselves with 64 KB."""


@check(
    "discovery_traffic",
    Severity.WARNING,
    Subject.RESULT,
    "A discovery server, fewer participants (nodes in one process) or a longer lease and announcement period may help.",
)
def discovery_traffic(evidence: Evidence) -> Iterator[Observation]:
    """Discovery is a large part of the traffic."""
    for row in _complete_rows(evidence):
        share, rate = row["discovery_share"], row["discovery_bytes_per_minute"]
        if share is None or rate is None:
            continue
        discovery_bytes = share * row["total_bytes"]
        minutes = max(discovery_bytes / rate, row["runs"]) if rate else 0.0
        is_large = discovery_bytes > DISCOVERY_SHARE * max(row["total_bytes"], row["payload_bytes"])
        if is_large and discovery_bytes > DISCOVERY_BYTES * minutes:
            yield evidence.result(
                row["group"],
                f"Discovery took {percent(share, 1)} of the bytes on the wire, {three_digits(rate / 1000)} KB a minute.",
                share,
            )
