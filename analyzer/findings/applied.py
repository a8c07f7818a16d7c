"""Settings not applied, and datagrams that the kernel lost."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

from dds_trace.base.units import counted

from ..model.applied import interface_bytes, kernel_counts, kernel_limits, may_be_cut, words_not_applied
from ..model.finding import Severity, Subject
from .evidence import SMALLER_DATAGRAMS, Evidence, Observation, check


@check(
    "not_applied",
    Severity.ERROR,
    Subject.RESULT,
    "No answer, bridge cost, recommendation or gate uses this result: request what the middleware can do, and record again.",
)
def settings_not_applied(evidence: Evidence) -> Iterator[Observation]:
    """The middleware did not apply a requested setting."""
    roles: dict[int, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
    for exchange, group in evidence.exchanges_by_group():
        for role, session in (("ping", exchange.ping), ("relay", exchange.relay)):
            for words in words_not_applied(session) if session else ():
                roles[group][words].add(role)
    for group, by_words in sorted(roles.items()):
        listed = "; ".join(f"{' and '.join(sorted(sides))}: {words}" for words, sides in by_words.items())
        yield evidence.result(group, f"What was requested is not what was measured. {listed[0].upper()}{listed[1:]}.")


@check(
    "fragments_lost",
    Severity.WARNING,
    Subject.RECORDING,
    f"One lost fragment loses its whole datagram{{limits}}: {SMALLER_DATAGRAMS}.",
)
def lost_fragments(evidence: Evidence) -> Iterator[Observation]:
    """A host lost IP fragments while messages were under way.

    The kernel counts for a whole network namespace: only results with cut messages are named.
    """
    captured = set(evidence.details.wire["group"])
    cut = evidence.groups_by_session(may_be_cut)
    for session in evidence.campaign.sessions.values():
        groups = tuple(group for group in cut.get(session.session_id, ()) if group not in captured)
        if not groups:
            continue
        rises = kernel_counts(session)
        failed, late = rises.get("ReasmFails", 0), rises.get("ReasmTimeout", 0)
        limits = kernel_limits(session)
        time_s, thresh = limits.get("net.ipv4.ipfrag_time"), limits.get("net.ipv4.ipfrag_high_thresh")
        has_limits = time_s is not None and thresh is not None
        if failed:
            yield Observation(
                evidence.session_name(session),
                f"In its network namespace, all programs together, {counted(failed, 'datagram')} could not be put together from "
                f"IP fragments ({late} of them for a fragment that never came).",
                groups,
                blanks={
                    "limits": f", whose other fragments wait for {time_s} s in at most {thresh:,} B"
                    if has_limits
                    else ""
                },
            )


@check(
    "fragments_lost",
    Severity.WARNING,
    Subject.RECORDING,
    "The interface's queue was full: leave larger send buffers out (sendBufferSize, net.core.wmem_default), or let the queue take "
    "a whole burst (tc qdisc, txqueuelen).",
)
def unsent_fragments(evidence: Evidence) -> Iterator[Observation]:
    """A host dropped IP fragments before they were sent."""
    cut = evidence.groups_by_session(may_be_cut)
    for session in evidence.campaign.sessions.values():
        unsent = kernel_counts(session).get("FragFails", 0)
        groups = cut.get(session.session_id, ())
        if unsent and groups:
            yield Observation(
                evidence.session_name(session),
                f"In its network namespace, all programs together, {counted(unsent, 'datagram')} could not be sent as IP fragments.",
                groups,
            )


_SENT_SHARE, _LEAST_PAYLOAD_BYTES = 0.9, 2_000_000
"""Share of the payload that a carrying interface sends, and payload larger than discovery."""


@check(
    "several_networks",
    Severity.WARNING,
    Subject.RECORDING,
    "Name one interface on both sides: NetworkInterface in CYCLONEDDS_URI, interfaceWhiteList in a Fast DDS profile.",
)
def several_networks(evidence: Evidence) -> Iterator[Observation]:
    """Messages went over several networks at once.

    Interfaces within each other (bridge, bond) count alike.
    """
    payload_bytes: dict[int, dict[int, int]] = defaultdict(dict)
    for exchange, _, counts in evidence.counts_by_exchange():
        run = exchange.run
        payload_bytes[exchange.ping.session_id][run.run_id] = counts["with_warmup"] * run.payload_bytes
        if exchange.relay is not None:
            payload_bytes[exchange.relay.session_id][run.run_id] = counts["reached"] * run.payload_bytes
    for session_id, by_run in payload_bytes.items():
        session, payload = evidence.campaign.sessions[session_id], sum(by_run.values())
        names = [name for name, sent in interface_bytes(session).items() if sent >= _SENT_SHARE * payload]
        if len(names) > 1 and payload >= _LEAST_PAYLOAD_BYTES:
            yield evidence.recording(
                session, f"Each of {' and '.join(names)} sent as many bytes as all its messages have ({payload:,} B)."
            )
