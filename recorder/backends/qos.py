"""Which pairs of a publisher and a subscription can never match, said in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dds_trace.tracefile.units.durations import INFINITE_NS, spell_duration

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from dds_trace.tracefile import Qos

    from .base import Endpoint

# A publisher must offer at least what a subscription requests (DDS 1.4, section 2.2.3). From weak to strong.
RANKS = {
    "reliability": ("best_effort", "reliable"),
    "durability": ("volatile", "transient_local", "transient", "persistent"),
}

DURATION_POLICIES = ("deadline", "lifespan")


def asked_durations(qos: Qos) -> dict[str, int]:
    """The ns of those of `DURATION_POLICIES` that `qos` asks for; one that is left out is without end."""
    given = {policy: qos.extra.get(f"{policy}_ns") for policy in DURATION_POLICIES}
    return {policy: duration_ns for policy, duration_ns in given.items() if duration_ns is not None}


def duration_extra(durations_ns: Mapping[str, int]) -> dict[str, int]:
    """`Qos.extra` of an endpoint whose middleware tells these: without what has no end, or is 0, ROS 2's word for that."""
    return {
        f"{policy}_ns": duration_ns
        for policy, duration_ns in durations_ns.items()
        if 0 < duration_ns < INFINITE_NS
    }


def mismatches(offered: Qos, requested: Qos) -> list[str]:
    """The policies in which `offered` falls short of `requested`; a value that is unknown is no mismatch.

    A deadline (`Qos.extra`, `deadline_ns`) falls short if it is longer than the requested one or there is none.
    """
    found = []
    for policy, ranks in RANKS.items():
        offers, requests = getattr(offered, policy), getattr(requested, policy)
        if offers in ranks and requests in ranks and ranks.index(offers) < ranks.index(requests):
            found.append(f"{policy} ({offers} offered, {requests} requested)")
    offers_ns, requests_ns = offered.extra.get("deadline_ns"), requested.extra.get("deadline_ns")
    if requests_ns is not None and (offers_ns is None or offers_ns > requests_ns):
        offers = "none" if offers_ns is None else spell_duration(offers_ns)
        found.append(f"deadline ({offers} offered, {spell_duration(requests_ns)} requested)")
    return found


def incompatible_pairs(
    topic: str, publishers: Iterable[Endpoint], subscriptions: Iterable[Endpoint], own_name: str
) -> Iterator[str]:
    """One line for each pair on `topic` that will never match and of which one side is the node `own_name`."""
    held = list(subscriptions)
    for publisher in publishers:
        for subscription in held:
            names = publisher.node_name, subscription.node_name
            if own_name not in names or publisher.qos is None or subscription.qos is None:
                continue
            found = mismatches(publisher.qos, subscription.qos)
            if found:
                yield f"{topic}: publisher of {names[0]} and subscription of {names[1]} differ in {', '.join(found)}"
