"""Chains of topics, by the header stamps that messages take over from their sources, and what each hop takes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ..clocks.lines import Int64
from ..model.metrics import frame_schema
from .device_clocks import Machine
from .join import Delivery

HOP_SCHEMA = frame_schema(
    "chain:u32 hop:u32 topic:str next_topic:str from_event:str to_event:str ping_device:str relay_device:str messages:u64 "
    "p50_ns:f64 p99_ns:f64 max_ns:f64 bound_ns:i64"
)
"""By hop: `stamp` to `publish`, `publish` to `receive`, `receive` to the next topic's `publish`."""

LEAST_CHAINED = 0.5
"""Share of messages with a header stamp of an earlier topic, if made of its messages."""

_QUANTILES = {"p50": (0.5, 1), "p90": (0.9, 10), "p99": (0.99, 100), "max": (1.0, 1)}
"""Statistic -> quantile, and the values that it takes."""


def quantile(values: Int64, statistic: str) -> float | None:
    share, needs = _QUANTILES[statistic]
    return float(np.quantile(values, share)) if len(values) >= needs else None


def origin_name(delivery: Delivery) -> str:
    return "unknown" if delivery.origin is None else delivery.origin.device


def find_sources(deliveries: Sequence[Delivery]) -> dict[int, int]:
    """Return for each delivery, by index, the one that it was made of: the last one received before it."""
    sources = {}
    for number, later in enumerate(deliveries):
        earlier_ones = []
        for other, earlier in enumerate(deliveries):
            is_here = later.origin is not None and earlier.heard.machine == later.origin
            if earlier.heard.topic == later.heard.topic or not is_here:
                continue
            times = _processing_ns(earlier, later)
            if len(times) and len(times) >= LEAST_CHAINED * len(later.messages) and np.median(times) >= 0:
                earlier_ones.append((float(np.median(times)), other))
        if earlier_ones:
            sources[number] = min(earlier_ones)[1]
    return sources


def _path_to(number: int, sources: Mapping[int, int]) -> list[int]:
    path = [number]
    while (earlier := sources.get(path[0])) is not None and earlier not in path:
        path.insert(0, earlier)
    return path


def stamper(number: int, deliveries: Sequence[Delivery], sources: Mapping[int, int]) -> Machine:
    """Return the machine that stamped the messages of a delivery by its clock: the one at which its chain begins."""
    first = deliveries[_path_to(number, sources)[0]]
    return first.heard.machine if first.origin is None else first.origin


def hop_rows(deliveries: Sequence[Delivery], sources: Mapping[int, int]) -> Iterator[dict[str, object]]:
    """Yield rows of `HOP_SCHEMA`, by chain: one for each delivery with ages that is on the way to no other."""
    has_age = [delivery.messages["age_ns"].null_count() < len(delivery.messages) for delivery in deliveries]
    ends = [number for number, is_aged in enumerate(has_age) if is_aged and number not in sources.values()]
    for chain, end in enumerate(ends):
        path = [deliveries[number] for number in _path_to(end, sources)]
        for hop, row in enumerate(_hops(path)):
            yield {"chain": chain, "hop": hop, **row}


def _hops(path: Sequence[Delivery]) -> Iterator[dict[str, object]]:
    for number, hop in enumerate(path):
        topic, origin, device = hop.heard.topic, origin_name(hop), hop.heard.session.device
        if number:
            times = _processing_ns(path[number - 1], hop)
            yield _hop((path[number - 1].heard.topic, topic), ("receive", "publish"), (origin, origin), times)
        else:
            times = hop.messages["stamp_to_publish_ns"].drop_nulls().to_numpy()
            yield _hop((topic, topic), ("stamp", "publish"), (origin, origin), times)
        times, bound_ns = hop.messages["one_way_ns"].drop_nulls().to_numpy(), hop.messages["bound_ns"].max()
        yield {**_hop((topic, topic), ("publish", "receive"), (origin, device), times), "bound_ns": bound_ns}


def _hop(topics: tuple[str, str], events: tuple[str, str], devices: tuple[str, str], times: Int64) -> dict[str, object]:
    names = ("topic", "next_topic", "from_event", "to_event", "ping_device", "relay_device")
    statistics = {f"{name}_ns": quantile(times, name) for name in ("p50", "p99", "max")}
    return {**dict(zip(names, (*topics, *events, *devices), strict=True)), "messages": len(times), **statistics}


def _processing_ns(earlier: Delivery, later: Delivery) -> Int64:
    received = earlier.messages.select("header_ns", "relay_in_ns").drop_nulls().unique("header_ns")
    published = later.messages.select("header_ns", "publish_ns").drop_nulls().unique("header_ns")
    joined = received.join(published, on="header_ns")
    times: Int64 = (joined["publish_ns"] - joined["relay_in_ns"]).to_numpy()
    return times
