"""Checks of what stands side by side: the two sides of a run, and runs of one device at the same time."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

from dds_trace.tracefile.units.counts import counted

from ..clocks.boots import boot_id_of, share_boot
from ..model.finding import Finding, Severity
from .evidence import some

if TYPE_CHECKING:
    from collections.abc import Iterator

    from dds_trace.tracefile import Session

    from ..pairing.exchanges import Exchange
    from .evidence import Evidence

_OVERLAP_NS = 1_000_000_000
"""Time that two runs must share: less is one run's drain beside the next one's first messages, and NTP slews the wall clocks
by which runs of two sessions are laid side by side."""


def overlapping_pings(evidence: Evidence) -> Iterator[Finding]:
    """Report pairs of groups whose pings ran on one device at the same time: each is the other's load.

    Runs of one group at the same time are flows that were meant to be. Nothing is estimated here, so that honest
    recordings, one after the other, have no such finding.
    """
    runs: dict[str, list[tuple[int, int, int, int]]] = defaultdict(list)
    of_exchange = evidence.summary.of_exchange["publish_span_ns"].to_list()
    seen: set[int] = set()
    for exchange, group, span_ns in zip(
        evidence.grouping.exchanges, evidence.exchange_groups(), of_exchange, strict=True
    ):
        if exchange.run.run_id not in seen:
            seen.add(exchange.run.run_id)
            machine = boot_id_of(exchange.ping) or exchange.ping.device
            end_ns = exchange.start_ns + (span_ns or 0)
            runs[machine].append((exchange.start_ns, end_ns, group, exchange.run.run_id))
    shared: dict[tuple[int, int], list[tuple[int, float]]] = defaultdict(list)
    for of_machine in runs.values():
        going_on: list[tuple[int, int, int, int]] = []
        for run in sorted(of_machine):
            start_ns, end_ns, group, run_id = run
            going_on = [other for other in going_on if other[1] - start_ns >= _OVERLAP_NS]
            for _, other_end_ns, other_group, _ in going_on:
                common_ns = min(end_ns, other_end_ns) - start_ns
                if other_group != group and common_ns >= _OVERLAP_NS:
                    pair = (min(group, other_group), max(group, other_group))
                    shared[pair].append((run_id, common_ns / max(end_ns - start_ns, 1)))
            going_on.append(run)
    names = evidence.group_names
    for (one, other), overlaps in sorted(shared.items()):
        yield Finding(
            Severity.WARNING,
            "overlapping_pings",
            f"{names[one]}; {names[other]}",
            f"{counted(len(overlaps), 'run')} of one went on at the same time as a run of the other on the same device, such as "
            f"{evidence.run_name(overlaps[0][0])}.",
            "Each was the other's load: record one after the other, or read both as measured under load.",
            (one, other),
            effect=min(max(share for _, share in overlaps), 1.0),
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
