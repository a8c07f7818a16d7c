"""Quality of service: durations, endpoints that never match, too small a depth."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from dds_trace.base.errors import OptionError
from dds_trace.base.units import INFINITE_NS, spell_duration
from dds_trace.tracefile.format.descriptions import Qos

from ..choices import Durability, History, Reliability
from .node import Endpoint

RANKS: Mapping[str, Sequence[str]] = {
    "reliability": (Reliability.BEST_EFFORT, Reliability.RELIABLE),
    "durability": (Durability.VOLATILE, Durability.TRANSIENT_LOCAL, "transient", "persistent"),
}
"""Values from weak to strong; the offered one must not be weaker (DDS 1.4, 2.2.3)."""

DURATION_POLICIES = ("deadline", "lifespan")
"""`Qos.extra` has them as `deadline_ns` and `lifespan_ns`."""

STALL_S = 0.1
"""How long a side of a busy machine may stall: the default `max_blocking_time` (DDS 1.4, 2.2.3.14)."""


def warn_of_depth(history: str, depth: int, rate_hz: float) -> str | None:
    if math.isinf(rate_hz):
        return None
    needed = math.floor(rate_hz * STALL_S) + 1
    if history != History.KEEP_LAST or depth >= needed:
        return None
    return (
        f"a stall of {depth / rate_hz * 1000:.3g} ms can lose messages, even reliable ones, as each side keeps {depth}; "
        f"--depth {needed} on both sides outlasts {STALL_S * 1000:g} ms"
    )


def requested_durations(qos: Qos) -> dict[str, int]:
    durations_ns = {policy: qos.extra.get(f"{policy}_ns") for policy in DURATION_POLICIES}
    return {policy: duration for policy, duration in durations_ns.items() if isinstance(duration, int)}


def duration_extra(durations_ns: Mapping[str, int]) -> dict[str, int]:
    """Return `Qos.extra` from durations in ns, without infinite ones, which ROS 2 reports as 0."""
    return {
        f"{policy}_ns": duration_ns for policy, duration_ns in durations_ns.items() if 0 < duration_ns < INFINITE_NS
    }


def refuse_policies(backend: str, qos: Qos, keeps_nothing: str) -> None:
    for policy in requested_durations(qos):
        raise OptionError(f"-o {policy}: the backend {backend} has no such quality of service; leave it out")
    if qos.durability != Durability.VOLATILE:
        raise OptionError(f"-o durability={qos.durability}: {keeps_nothing}")


def mismatches(offered: Qos, requested: Qos) -> list[str]:
    """Return a text for each policy in which `offered` falls short; an unknown value never does."""
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
    topic: str, publishers: Iterable[Endpoint], subscriptions: Sequence[Endpoint], own_name: str
) -> Iterator[str]:
    for publisher in publishers:
        for subscription in subscriptions:
            names = publisher.node_name, subscription.node_name
            if own_name not in names or publisher.qos is None or subscription.qos is None:
                continue
            shortfalls = mismatches(publisher.qos, subscription.qos)
            if shortfalls:
                policies = ", ".join(shortfalls)
                yield f"{topic}: publisher of {names[0]} and subscription of {names[1]} differ in {policies}"


def other_definitions(topic: str, infos: Sequence[Any], own_name: str) -> Iterator[str]:
    hashes = [(info, str(getattr(info, "topic_type_hash", ""))) for info in infos]
    hashes = [(info, text) for info, text in hashes if text.startswith("RIHS")]  # other vendors have none
    our_types = {info.topic_type: text for info, text in hashes if info.node_name == own_name}
    for info, text in hashes:
        if text != our_types.get(info.topic_type, text):
            yield f"{topic}: {info.node_name}'s {info.topic_type} has the same name and another definition"
