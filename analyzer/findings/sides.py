"""Checks of what stands side by side: the two sides of a run, and runs of one device at the same time."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

from dds_trace.base.units import counted

from ..clocks.boots import share_boot
from ..model.finding import Finding, Severity
from ..pairing.flows import find_overlaps
from .evidence import percent, some

if TYPE_CHECKING:
    from collections.abc import Iterator

    from dds_trace.tracefile.format.descriptions import Session

    from ..pairing.exchanges import Exchange
    from ..pairing.flows import Overlap
    from .evidence import Evidence


def overlapping_pings(evidence: Evidence) -> Iterator[Finding]:
    """Report groups whose pings ran on one machine at the same time: each was the other's load.

    Runs of one group in the middle of each other are flows that were meant to be, and `flows` in the setting of their group
    counts them. Nothing is estimated here, so that honest recordings, one after the other, have no such finding.
    """
    exchanges = evidence.grouping.exchanges
    group_of_run: dict[int, int] = {}
    for exchange, group in zip(exchanges, evidence.exchange_groups(), strict=True):
        group_of_run.setdefault(exchange.run.run_id, group)
    shared: dict[tuple[int, int], list[Overlap]] = defaultdict(list)
    for overlap in find_overlaps(exchange.span() for exchange in exchanges):
        one, other = sorted((group_of_run[overlap.one], group_of_run[overlap.other]))
        if one != other or not overlap.is_mutual:
            shared[one, other].append(overlap)
    names = evidence.group_names
    for groups, overlaps in sorted(shared.items()):
        pairs = counted(len(overlaps), "pair of runs", "pairs of runs")
        of = "of this group" if groups[0] == groups[1] else "of the two groups"
        worst = max(overlaps, key=lambda overlap: overlap.share)
        yield Finding(
            Severity.WARNING,
            "overlapping_pings",
            "; ".join(names[group] for group in dict.fromkeys(groups)),
            f"{pairs} {of} went on at the same time on one machine, such as {evidence.run_name(worst.one)} and "
            f"{evidence.run_name(worst.other)} for {percent(worst.share, 1)} of the shorter one.",
            "Each was the other's load: record one after the other, or read both as measured under load.",
            tuple(dict.fromkeys(groups)),
            effect=worst.share,
        )


def unlike_versions(evidence: Evidence) -> Iterator[Finding]:
    """Report a ping and a relay that ran unlike versions of dds-trace, or of one library of the middleware."""
    unlike: dict[tuple[str, str, str], dict[int, None]] = defaultdict(dict)
    for exchange, group in zip(evidence.grouping.exchanges, evidence.exchange_groups(), strict=True):
        if exchange.relay is None:
            continue
        of_ping, of_relay = _versions(exchange.ping), _versions(exchange.relay)
        listed = [
            f"{name} {of_ping[name]} and {of_relay[name]}"
            for name in sorted(of_ping.keys() & of_relay.keys())
            if of_ping[name] != of_relay[name]
        ]
        if listed:
            where = (exchange.ping.device, exchange.relay.device, some(listed, 5))
            unlike[where][group] = None
    for (ping_device, relay_device, listed_versions), groups in unlike.items():
        yield Finding(
            Severity.WARNING,
            "unlike_versions",
            f"ping on {ping_device}, relay on {relay_device}",
            f"The ping and the relay ran unlike versions: {listed_versions}.",
            "Latency here is neither version's: install one version on both devices, unless the pair is the question.",
            tuple(groups),
        )


def _versions(session: Session) -> dict[str, str]:
    """Return the versions that a session tells, by name."""
    told = session.host.get("versions")
    versions = {name: str(version) for name, version in told.items()} if isinstance(told, dict) else {}
    recorder = session.extra.get("recorder_version")
    return versions | ({"dds-trace": recorder} if isinstance(recorder, str) else {})


def wireless_on_one_machine(evidence: Evidence) -> Iterator[Finding]:
    """Report groups whose link is called wireless though both sides ran on one machine: no message was on the air."""
    fits = evidence.details.clock_fits.filter(evidence.details.clock_fits["same_clock"])
    one_clock = set(fits.select("ping_device", "relay_device").iter_rows())
    groups: dict[int, str] = {}
    for exchange, group in zip(evidence.grouping.exchanges, evidence.exchange_groups(), strict=True):
        if exchange.ping.connectivity == "wireless" and _on_one_machine(exchange, one_clock):
            groups[group] = exchange.ping.device
    for group, device in groups.items():
        yield Finding(
            Severity.WARNING,
            "wireless_on_one_machine",
            evidence.group_names[group],
            f"The link is called wireless, but the ping and the relay ran on one machine ({device}): no message was on the air.",
            "Give --connectivity loopback, or run the relay on the other device.",
            (group,),
        )


def _on_one_machine(exchange: Exchange, one_clock: set[tuple[str, str]]) -> bool:
    """Return whether both sides share a boot; where no boot id tells, one clock (`ClockFit.same_clock`)."""
    if exchange.relay is None:
        return False
    shared = share_boot(exchange.ping, exchange.relay)
    return (exchange.ping.device, exchange.relay.device) in one_clock if shared is None else shared
