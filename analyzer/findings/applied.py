"""Checks of what middleware and kernel really did: settings that were not applied, datagrams and fragments that were lost."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

from dds_trace.base.units import counted

from ..model.applied import kernel_counts, kernel_limits, may_be_cut, socket_drops, words_not_applied
from ..model.finding import Finding, Severity
from .evidence import SMALLER_DATAGRAMS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from dds_trace.tracefile.format.descriptions import Session

    from .evidence import Evidence

_ROLES = ("ping", "relay")


def settings_not_applied(evidence: Evidence) -> Iterator[Finding]:
    """Report groups in which a middleware did not use what it was asked for; they are barred from every judgement."""
    words: dict[int, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
    for exchange, group in zip(evidence.grouping.exchanges, evidence.exchange_groups(), strict=True):
        for role, session in zip(_ROLES, (exchange.ping, exchange.relay), strict=True):
            for each in words_not_applied(session) if session else ():
                words[group][each].add(role)
    for group, of_group in sorted(words.items()):
        told = "; ".join(f"{' and '.join(sorted(roles))}: {each}" for each, roles in of_group.items())
        yield Finding(
            Severity.ERROR,
            "not_applied",
            evidence.group_names[group],
            f"What was asked for is not what was measured. {told[0].upper()}{told[1:]}.",
            "No answer, bridge cost, recommendation or gate uses this group: ask for what the middleware can do, and "
            "record again.",
            (group,),
        )


def dropped_datagrams(evidence: Evidence) -> Iterator[Finding]:
    """Report recordings whose own sockets lost datagrams for want of receive buffer."""
    for session, groups in _sessions(evidence):
        count = socket_drops(session)
        if count:
            yield Finding(
                Severity.WARNING,
                "udp_buffer_overflow",
                evidence.session_name(session),
                f"The kernel threw away {counted(count, 'datagram')} at its own sockets for want of receive buffer.",
                "Losses and late large messages are to be expected: raise net.core.rmem_max and net.core.rmem_default, "
                "or record with --tuned.",
                groups,
            )


def lost_fragments(evidence: Evidence) -> Iterator[Finding]:
    """Report hosts whose kernel could not put datagrams together, or take them apart, while messages were under way.

    The kernel counts for all programs of a network namespace. So only groups whose messages were cut into fragments are
    named; of those with a capture the check of its counts says it (`wire.lost_fragments`).
    """
    captured = set(evidence.details.wire["group"])
    for session, cut in _sessions(evidence, may_be_cut):
        groups = tuple(group for group in cut if group not in captured)
        if not groups:
            continue
        rises = kernel_counts(session)
        failed, late = rises.get("ReasmFails", 0), rises.get("ReasmTimeout", 0)
        unsent = rises.get("FragFails", 0)
        said = [
            f"{counted(failed, 'datagram')} could not be put together from IP fragments ({late} of them for a fragment that "
            "never came)"
            if failed
            else "",
            f"{counted(unsent, 'datagram')} could not be cut into fragments" if unsent else "",
        ]
        if failed or unsent:
            yield Finding(
                Severity.WARNING,
                "fragments_lost",
                evidence.session_name(session),
                f"In its network namespace, all programs together, {' and '.join(filter(None, said))}.",
                f"One lost fragment loses its whole datagram{_bounds(session)}: {SMALLER_DATAGRAMS}.",
                groups,
            )


def _bounds(session: Session) -> str:
    limits = kernel_limits(session)
    time_s, thresh = limits.get("net.ipv4.ipfrag_time"), limits.get("net.ipv4.ipfrag_high_thresh")
    if time_s is None or thresh is None:
        return ""
    return f", whose other fragments wait for {time_s} s in at most {thresh:,} B"


def _sessions(
    evidence: Evidence, concerns: Callable[[Session, int], bool] = lambda _session, _payload_bytes: True
) -> list[tuple[Session, tuple[int, ...]]]:
    """Return each session with the groups that it took part in, with messages that concern it or the other side."""
    groups: dict[int, dict[int, None]] = defaultdict(dict)
    for exchange, group in zip(evidence.grouping.exchanges, evidence.exchange_groups(), strict=True):
        sides = [session for session in (exchange.ping, exchange.relay) if session is not None]
        if any(concerns(session, exchange.run.payload_bytes) for session in sides):
            for session in sides:
                groups[session.session_id][group] = None
    return [(each, tuple(groups[each.session_id])) for each in evidence.campaign.sessions.values()]
