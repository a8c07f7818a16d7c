"""Traffic on the wire."""

from __future__ import annotations

from collections.abc import Iterator

import polars as pl

from dds_trace.analyzer.findings.evidence import SMALLER_DATAGRAMS, Evidence, Observation, percent, warning
from dds_trace.analyzer.findings.rows import Row, Rows, in_result
from dds_trace.analyzer.model.applied import may_be_cut
from dds_trace.analyzer.model.environment import middleware_version
from dds_trace.analyzer.model.finding import Subject
from dds_trace.base.units import counted, three_digits
from dds_trace.recorder.backends.ros2.installation import FAST_DDS_2, FAST_DDS_3
from dds_trace.tracefile.format.descriptions import Session

_HEARTBEATS = {"fastdds": "{} in a Fast DDS profile", "cyclonedds": "Internal/HeartbeatInterval of Cyclone DDS"}


def _heartbeat_setting(session: Session) -> str:
    facts = FAST_DDS_2 if middleware_version(session).startswith("2.") else FAST_DDS_3
    return _HEARTBEATS.get(session.vendor, "the one of its settings").format(facts.times[0])


def _wire(evidence: Evidence) -> pl.DataFrame:
    settings = {group: _heartbeat_setting(exchange.ping) for exchange, group in evidence.exchanges_by_group()}
    heartbeat = pl.col("group").replace_strict(settings, default="", return_dtype=pl.String)
    return evidence.details.wire.with_columns(heartbeat=heartbeat)


WIRE = Rows(Subject.RESULT, _wire, in_result)


def _complete_rows(evidence: Evidence) -> Iterator[Row]:
    return evidence.details.wire.filter("complete").iter_rows(named=True)


@warning("fragments_lost", Subject.RESULT, f"One lost fragment loses its whole datagram: {SMALLER_DATAGRAMS}.")
def lost_fragments(evidence: Evidence) -> Iterator[Observation]:
    """A result's datagrams lost IP fragments."""
    cut = _cut(evidence)
    for row in _complete_rows(evidence):
        if row["reassembly_failed"] and row["group"] in cut:
            yield evidence.result(
                row["group"],
                f"While its messages were under way, the kernels of both sides counted {_not_joined(row['reassembly_failed'])}.",
            )


def _cut(evidence: Evidence) -> set[int]:
    """Return the groups with messages that may be sent as IP fragments."""
    return {
        group
        for exchange, group in evidence.exchanges_by_group()
        for session in (exchange.ping, exchange.relay)
        if session is not None and may_be_cut(session, exchange.run.payload_bytes)
    }


def _not_joined(datagrams: int) -> str:
    return f"{counted(datagrams, 'datagram')} that could not be put together from IP fragments"


STORM_SHARE = 0.2
"""Share of repeats in the bytes on the wire: a link four fifths full without them is full."""

AGAIN_SHARE = 0.1
"""Share of repeated messages above which p90 is the latency of a repeat."""

FEWEST_AGAIN = 5
"""Enough for a median, and more than the first ones after a match."""


@warning(
    "retransmission_storm",
    Subject.RESULT,
    "Repeats take the room of new messages, and latency waits for them: {remedy}.",
)
def retransmission_storms(evidence: Evidence) -> Iterator[Observation]:
    """Much of the traffic is repeats."""
    cut = _cut(evidence)
    for row in _complete_rows(evidence):
        byte_share = row["again_bytes_share"] or 0.0
        message_share = row["again_messages"] / row["messages"] if row["messages"] else 0.0
        has_many = message_share > AGAIN_SHARE and row["again_messages"] >= FEWEST_AGAIN
        if byte_share > STORM_SHARE or has_many:
            requests = f"; readers asked {counted(row['requests'], 'time')}" if row["requests"] else ""
            yield evidence.result(
                row["group"],
                f"{percent(byte_share, 1)} of the bytes on the wire were sent again, "
                f"{row['again_messages']:,} of {counted(row['messages'], 'message')}{requests}.",
                max(byte_share, message_share),
                remedy=_remedy(row, is_cut=row["group"] in cut),
            )


def _remedy(row: Row, *, is_cut: bool) -> str:
    if row["udp_receive_buffer_full"]:
        return (
            f"{counted(row['udp_receive_buffer_full'], 'datagram')} met a full receive buffer, so give the sockets larger "
            "ones (--tuned, net.core.rmem_max)"
        )
    if row["reassembly_failed"] and is_cut:
        return f"{_not_joined(row['reassembly_failed'])}, so {SMALLER_DATAGRAMS}"
    return (
        f"{'no message of this size is cut' if row['reassembly_failed'] else 'neither kernel counted a lost datagram'}, so look at the link: a lower rate or --depth may help, or best effort where a "
        "lost message may stay lost"
    )


HEARTBEATS_WAITED = 2
"""Heartbeat periods after which a heartbeat, no request, caused the repeat."""

DISCOVERY_SHARE, DISCOVERY_BYTES = 0.25, 100_000
"""Share of discovery in the larger of wire bytes and payload (which may be in shared memory), and bytes a minute that no
link feels: 13 kbit/s; two Fast DDS participants on one machine announce themselves with 64 KB."""


@warning(
    "discovery_traffic",
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


CHECKS = {
    "several_networks": (
        WIRE.warning(
            "wire_incomplete",
            "The capture of the wire missed packets",
            ~pl.col("complete"),
            "The capture of the wire missed {kernel_drops:# packet} that the kernel dropped: its counts are lower bounds, and prove nothing "
            "about repeats.[ The kernel counted {reassembly_failed:# datagram} that could not be put together from IP fragments.]",
            "Fewer bytes a second, or a machine with a processor to spare, may help.",
        ),
        WIRE.warning(
            "carried_twice",
            "Messages left on two interfaces at once",
            pl.col("carried_twice") > 0,
            "{carried_twice} of {messages:# message} ({carried_twice:share of {messages}}), or their replies, left on more than one interface.",
            "The slower of the two takes part of every message: one interface on both sides (NetworkInterface in CYCLONEDDS_URI, "
            "interfaceWhiteList in a Fast DDS profile), or the other one switched off, may help.",
            effect=pl.col("carried_twice") / pl.col("messages"),
        ),
        lost_fragments,
        retransmission_storms,
        WIRE.warning(
            "heartbeat_bound_recovery",
            "Lost messages waited for a heartbeat",
            pl.col("complete")
            & (pl.col("waited_heartbeats_p50") >= HEARTBEATS_WAITED)
            & (pl.col("again_messages") >= FEWEST_AGAIN),
            "{again_messages} of {messages:# message} were sent again; half of them waited for {waited_heartbeats_p50:digits} heartbeat "
            "periods, {resent_after_p50_ns:duration}, or longer.",
            "A shorter heartbeat period of the writer may help: {heartbeat}.",
            pl.col("again_messages") / pl.col("messages"),
        ),
        discovery_traffic,
    ),
    "slewed": (
        WIRE.note(
            "wire_counts_shared",
            "Counts of the relay's capture are of several results",
            pl.col("shared_counts") > 0,
            "{shared_counts:# count} of the relay's capture {shared_counts:is|are} of runs of other results, too: the relay's requests "
            "and lost datagrams are left out here.",
            "Two seconds without a message between runs, or a relay for each run, may help.",
        ),
    ),
}
"""Code of the check of the main house after which they are in its order -> the checks."""
