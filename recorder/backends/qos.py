"""Quality of service: the durations it asks for, and the pairs of a publisher and a subscription that can never match."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from dds_trace.base.errors import OptionError
from dds_trace.base.units import INFINITE_NS, spell_duration

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from dds_trace.tracefile.format.descriptions import Qos

    from .node import Endpoint

# A publisher must offer at least what a subscription requests (DDS 1.4, section 2.2.3). From weak to strong.
RANKS = {
    "reliability": ("best_effort", "reliable"),
    "durability": ("volatile", "transient_local", "transient", "persistent"),
}

DURATION_POLICIES = ("deadline", "lifespan")
"""Policies that are durations; `Qos.extra` has them as `deadline_ns` and `lifespan_ns`."""

STALL_S = 0.1
"""Time for which a side of a busy machine takes no message now and then, in seconds: what a reliable writer may block by default
(`max_blocking_time`, DDS 1.4, section 2.2.3.14). Two relays that were stopped for 50 ms four times in 3000 messages at 1 kHz lost
74 (Fast DDS) and 120 (Cyclone DDS) with a depth of 10, and none with 1000."""


def warn_of_depth(history: str, depth: int, rate_hz: float) -> str | None:
    """Return a warning about a history that holds less than `STALL_S` of messages, None if it holds that long.

    Args:
        history: `keep_last` or `keep_all`.
        depth: messages that `keep_last` keeps.
        rate_hz: messages a second.
    """
    needed = math.ceil(rate_hz * STALL_S)
    if history != "keep_last" or depth >= needed:
        return None
    return (
        f"--depth {depth} keeps {depth / rate_hz * 1000:.3g} ms of messages at {rate_hz:g} Hz: where a side is held up for "
        f"longer some are lost, reliable or not; --depth {needed} on both sides keeps {STALL_S * 1000:g} ms"
    )


def requested_durations(qos: Qos) -> dict[str, int]:
    """Return policy -> ns for those of `DURATION_POLICIES` that `qos` asks for; one that is left out is infinite."""
    given = {policy: qos.extra.get(f"{policy}_ns") for policy in DURATION_POLICIES}
    return {policy: duration_ns for policy, duration_ns in given.items() if isinstance(duration_ns, int)}


def duration_extra(durations_ns: Mapping[str, int]) -> dict[str, int]:
    """Return `Qos.extra` from reported durations in ns; infinite ones, and 0 (ROS 2's infinite), are left out."""
    return {
        f"{policy}_ns": duration_ns
        for policy, duration_ns in durations_ns.items()
        if 0 < duration_ns < INFINITE_NS
    }


def refuse_durations(backend: str, qos: Qos) -> None:
    """Refuse a deadline and a lifespan, which DDS alone has.

    Raises:
        OptionError: `qos` asks for one.
    """
    for policy in requested_durations(qos):
        raise OptionError(f"--{policy}: the backend {backend} has no such quality of service; leave it out")


def mismatches(offered: Qos, requested: Qos) -> list[str]:
    """Return a text for each policy in which `offered` falls short of `requested`; an unknown value never does.

    A deadline (`Qos.extra`, `deadline_ns`) falls short if it is longer than the requested one or there is none.
    """
    shortfalls = []
    for policy, ranks in RANKS.items():
        offers, requests = getattr(offered, policy), getattr(requested, policy)
        if offers in ranks and requests in ranks and ranks.index(offers) < ranks.index(requests):
            shortfalls.append(f"{policy} ({offers} offered, {requests} requested)")
    offers_ns, requests_ns = (requested_durations(qos).get("deadline") for qos in (offered, requested))
    if requests_ns is not None and (offers_ns is None or offers_ns > requests_ns):
        offers = "none" if offers_ns is None else spell_duration(offers_ns, digits=6)
        shortfalls.append(f"deadline ({offers} offered, {spell_duration(requests_ns, digits=6)} requested)")
    return shortfalls


def incompatible_pairs(
    topic: str, publishers: Iterable[Endpoint], subscriptions: Iterable[Endpoint], own_name: str
) -> Iterator[str]:
    """Yield a line for each pair on `topic` that can never match and of which one side is the node `own_name`."""
    subscriptions = list(subscriptions)
    for publisher in publishers:
        for subscription in subscriptions:
            names = publisher.node_name, subscription.node_name
            if own_name not in names or publisher.qos is None or subscription.qos is None:
                continue
            shortfalls = mismatches(publisher.qos, subscription.qos)
            if shortfalls:
                policies = ", ".join(shortfalls)
                yield f"{topic}: publisher of {names[0]} and subscription of {names[1]} differ in {policies}"
