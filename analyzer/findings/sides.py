"""Both sides of a run, and simultaneous runs of one device."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

from dds_trace.base.units import counted
from dds_trace.tracefile.format.descriptions import Session

from ..clocks.boots import share_boot
from ..model.applied import interface_bytes, maps_foreign_memory, maps_memory
from ..model.environment import middleware_version, versions_of
from ..model.finding import Subject
from ..model.setting import flows_of
from ..pairing.exchanges import Overlap, find_overlaps
from ..verdicts.judgements import Claim, Reason
from .evidence import Evidence, Observation, percent, some, warning


@warning(
    "overlapping_pings",
    Subject.RESULT,
    "Each was the other's load: record one after the other, or read both as measured under load.",
)
def overlapping_pings(evidence: Evidence) -> Iterator[Observation]:
    """Runs went on at the same time on one machine.

    Flows (runs of one result in the middle of each other, `[[flows]]` of a plan) are in their setting instead.
    """
    settings = evidence.grouping.parameters["setting"].to_list()
    group_of_run: dict[int, int] = {}
    for exchange, group in evidence.exchanges_by_group():
        group_of_run.setdefault(exchange.run.run_id, group)
    shared: dict[tuple[int, int], list[Overlap]] = defaultdict(list)
    for overlap in find_overlaps(exchange.span() for exchange in evidence.grouping.exchanges):
        first, other = sorted((group_of_run[overlap.one], group_of_run[overlap.other]))
        (flow, own_with), (other_flow, other_with) = flows_of(settings[first]), flows_of(settings[other])
        is_planned = flow in other_with and other_flow in own_with
        if (first != other or not overlap.is_mutual) and not is_planned:
            shared[first, other].append(overlap)
    for pair, overlaps in sorted(shared.items()):
        groups = tuple(dict.fromkeys(pair))
        count = counted(len(overlaps), "pair of runs", "pairs of runs")
        owner = "of this result" if len(groups) == 1 else "of the two results"
        worst = max(overlaps, key=lambda overlap: overlap.share)
        yield Observation(
            "; ".join(evidence.group_names[group] for group in groups),
            f"{count} {owner} went on at the same time on one machine, such as {evidence.run_name(worst.one)} and "
            f"{evidence.run_name(worst.other)} for {percent(worst.share, 1)} of the shorter one.",
            groups,
            worst.share,
        )


@warning(
    "recorded_in_sequence",
    Subject.RESULT,
    "Record the setups in turn (dds-trace sweep does, with repeats), or compare them as they are with --trust-order.",
)
def recorded_in_sequence(evidence: Evidence) -> Iterator[Observation]:
    """Setups were recorded one after the other."""
    answers = [answer for answer in evidence.details.answers if not answer.interleaved]
    groups = sorted({group for answer in answers for setup in answer.contenders for group in setup.groups})
    if groups:
        drifts = [answer.drift_ratio - 1 for answer in answers if answer.drift_ratio is not None]
        tests = f": a drift of {100 * min(drifts):.3g} % between them passes for a difference" if drifts else ""
        yield Observation(
            some(evidence.group_names[group] for group in groups),
            f"With {counted(len(answers), 'kind')} of message, nearly all runs of one setup preceded all runs of another, so a "
            f"machine that changes looks like a difference between setups{tests}.",
            tuple(groups),
        )


@warning(
    "dependent_passes",
    Subject.RESULT,
    "A pause between the passes, a restart of what runs on between them, or more passes may help.",
)
def dependent_passes(evidence: Evidence) -> Iterator[Observation]:
    """Passes depend on each other."""
    rows = [row for answer in evidence.details.answers for row in answer.of_claim(Claim.FASTEST, "latency_p50")]
    groups = sorted({row.group for row in rows if row.reason == Reason.DEPENDENT.value and row.group is not None})
    if groups:
        yield Observation(
            some(evidence.group_names[group] for group in groups),
            f"With {counted(len(groups), 'kind')} of message, passes that follow each other are more alike than distant ones, so they "
            "show less than as many independent ones, and no setup is called the fastest; `compare --paired` counts each by itself.",
            tuple(groups),
        )


@warning(
    "unlike_versions",
    Subject.DEVICE,
    "Latency here is neither version's: install one version on both devices, unless you want to test the pair.",
)
def unlike_versions(evidence: Evidence) -> Iterator[Observation]:
    """Ping and relay ran different versions."""
    different: dict[tuple[str, str, str], dict[int, None]] = defaultdict(dict)
    for exchange, group in evidence.exchanges_by_group():
        if exchange.relay is None:
            continue
        ping, relay = _versions(exchange.ping), _versions(exchange.relay)
        listed = [
            f"{name} {ping[name]} and {relay[name]}"
            for name in sorted(ping.keys() & relay.keys())
            if ping[name] != relay[name]
        ]
        if listed:
            different[exchange.ping.device, exchange.relay.device, some(listed, 5)][group] = None
    for (ping_device, relay_device, versions), groups in different.items():
        yield Observation(
            f"ping on {ping_device}, relay on {relay_device}",
            f"The ping and the relay ran different versions: {versions}.",
            tuple(groups),
        )


@warning(
    "mixed_versions",
    Subject.RESULT,
    "One ROS 2 distribution on both sides gives them shared memory; where that is not possible, --tuned on both sides may help.",
)
def mixed_versions(evidence: Evidence) -> Iterator[Observation]:
    """Two generations of Fast DDS on one machine share no memory."""
    for group, members in enumerate(evidence.grouping.members()):
        for exchange in (evidence.grouping.exchanges[member] for member in members[:1]):
            sides = [session for session in (exchange.ping, exchange.relay) if session and session.vendor == "fastdds"]
            versions = [middleware_version(session) for session in sides]
            if len({version.partition(".")[0] for version in versions if version}) < 2 or not share_boot(*sides):
                continue
            if not all(maps_memory(side) and maps_foreign_memory(side) is False for side in sides):
                continue
            payload_bytes = 2 * exchange.counts[0] * exchange.run.payload_bytes
            sent_bytes = interface_bytes(exchange.ping).get("lo", 0)
            times = (
                f"; loopback carried {sent_bytes / payload_bytes:.2g} times their bytes"
                if sent_bytes > payload_bytes
                else ""
            )
            yield evidence.result(
                group,
                f"Ping and relay are on one machine with Fast DDS {' and '.join(versions)}, which name their shared memory "
                f"differently: neither mapped the other's, so every message went over UDP{times}.",
            )


def _versions(session: Session) -> dict[str, str]:
    recorder = session.extra.get("recorder_version")
    return versions_of(session) | ({"dds-trace": recorder} if isinstance(recorder, str) else {})


@warning(
    "wireless_on_one_machine", Subject.RESULT, "Give -o connectivity=loopback, or run the relay on the other device."
)
def wireless_on_one_machine(evidence: Evidence) -> Iterator[Observation]:
    """A link called wireless was within one machine."""
    fits = evidence.details.clock_fits.filter(evidence.details.clock_fits["same_clock"])
    one_clock = set(fits.select("ping_device", "relay_device").iter_rows())
    devices: dict[int, str] = {}
    for exchange, group in evidence.exchanges_by_group():
        if exchange.ping.connectivity != "wireless" or exchange.relay is None:
            continue
        is_shared = share_boot(exchange.ping, exchange.relay)
        if is_shared is None:  # without boot ids, one clock (`ClockFit.same_clock`)
            is_shared = (exchange.ping.device, exchange.relay.device) in one_clock
        if is_shared:
            devices[group] = exchange.ping.device
    for group, device in devices.items():
        yield evidence.result(
            group,
            f"The link is called wireless, but the ping and the relay ran on one machine ({device}): no message was on the air.",
        )
