"""The four campaigns that the page is judged on: a demo, one machine with losses, the study of devices and links, 520 groups.

Latencies follow no real middleware. They grow with the size and the link's speed; what a link cannot carry is lost.
"""

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache

from analyses import EVERY_ANALYSIS, MS, Measured, make_analysis
from kept import kept

from dds_trace import Analysis, Finding, Severity


@dataclass(frozen=True)
class Way:
    """What carries the messages.

    Attributes:
        vendor: of both sides.
        bridge: `none` for the same domain.
        base_ms: latency of an empty message on the fastest device.
        ms_per_mb: what a megabyte adds there.
        bytes_per_s: what it carries at most.
    """

    vendor: str
    bridge: str = "none"
    base_ms: float = 0.4
    ms_per_mb: float = 2.0
    bytes_per_s: float = 1e9


@dataclass(frozen=True)
class Place:
    """Two devices and the link between them, with what they multiply a latency by and carry at most."""

    ping_device: str
    relay_device: str
    connectivity: str
    slowness: float
    bytes_per_s: float


FAST, CYCLONE, ZENOH = (
    Way("fastdds", base_ms=0.42, ms_per_mb=4.6),
    Way("cyclonedds", base_ms=0.42, ms_per_mb=2.4),
    Way("zenoh", base_ms=0.30, ms_per_mb=1.6),
)


def bridged(way: Way, bridge: str, factor: float, bytes_per_s: float = 1e9) -> Way:
    return replace(
        way, bridge=bridge, base_ms=way.base_ms * factor, ms_per_mb=way.ms_per_mb * factor, bytes_per_s=bytes_per_s
    )


DEVICES = {"pi3": (9.0, 9e6), "pi4": (3.0, 30e6), "laptop": (1.0, 80e6)}
"""Device -> slowness against the fastest, bytes a second over its radio."""


def study() -> Analysis:
    """The study's own campaign, 384 groups of three runs each, with losses of large messages over the radio."""
    places = [
        Place(f"{device}-a", f"{device}-b", link, slowness * (1.0 if link == "wired" else 2.0), carried)
        for device, (slowness, radio) in DEVICES.items()
        for link, carried in (("wired", 1e9), ("wireless", radio))
    ]
    ways = [FAST, CYCLONE, bridged(FAST, "builtin", 1.6), bridged(CYCLONE, "builtin", 2.1)]
    sizes, rates = (33_000, 145_000, 1_000_000, 4_000_000), (5.0, 10.0, 20.0, 40.0)
    groups = list(measured(ways, places, [("binary", size) for size in sizes], rates, messages=100))
    return make_analysis(*groups, title="study")


def lossy_machine() -> Analysis:
    """One machine, three middlewares and four bridges: 126 groups of three runs each, two bridges lose what is large.

    A third of its sessions ran on a processor that was full.
    """
    ways = [
        FAST,
        CYCLONE,
        ZENOH,
        bridged(FAST, "builtin", 1.7),
        bridged(FAST, "builtin-zenoh", 2.4),
        bridged(FAST, "zenoh-bridge-dds", 1.3, bytes_per_s=6e6),
        bridged(FAST, "zenoh-bridge-ros2dds", 1.35, bytes_per_s=12e6),
    ]
    sizes = (33_000, 67_000, 145_000, 502_000, 1_000_000, 4_000_000)
    place = Place("vm", "vm", "loopback", 1.0, 1e9)
    groups = measured(ways, [place], [("binary", size) for size in sizes], (5.0, 10.0, 20.0), messages=100)
    analysis = make_analysis(*groups, title="lossy machine")
    busy = [
        Finding(
            Severity.WARNING,
            "cpu_saturated",
            f"session {session.session_id:016x}",
            "In 21 of 30 seconds the machine had less than 0.5 processors free.",
            "Latencies here hold time spent waiting for the processor: lower rate or size, or free the device.",
            effect=0.7,
        )
        for session in analysis.sessions[::3]
    ]
    return replace(analysis, findings=(*busy, *analysis.findings))


def demo() -> Analysis:
    """What `plans/quick.toml` records, six groups: ROS 2 on one machine, its three kinds of data, with and without a bridge."""
    place = Place("vm", "vm", "loopback", 1.0, 1e9)
    data = [("binary", 33_000), ("string", 1405), ("imu", 296)]
    return make_analysis(
        *measured([FAST, bridged(FAST, "builtin", 1.7)], [place], data, (50.0,), messages=100), title="demo"
    )


def measured(
    ways: list[Way], places: list[Place], data: list[tuple[str, int]], rates: tuple[float, ...], messages: int
) -> Iterator[Measured]:
    drawn = random.Random(5)
    for place in places:
        for way in ways:
            for data_type, size in data:
                for rate_hz in rates:
                    carried = min(place.bytes_per_s, way.bytes_per_s) / (size * rate_hz)
                    typical_ms = (way.base_ms + way.ms_per_mb * size / 1e6) * place.slowness
                    if carried < 1:
                        typical_ms *= 1.5
                    yield Measured(
                        [
                            _message(drawn, typical_ms, lost_share=max(0.0, 0.8 * (1 - carried)))
                            for _ in range(messages)
                        ],
                        vendor=way.vendor,
                        relay_vendor=way.vendor,
                        rmw=None,
                        bridge=way.bridge,
                        domain_mode="same" if way.bridge == "none" else "different",
                        data_type=data_type,
                        payload_bytes=size,
                        rate_hz=rate_hz,
                        ping_device=place.ping_device,
                        relay_device=place.relay_device,
                        connectivity=place.connectivity,
                        intermediate_ns=round(80_000 + size * 0.05),
                        runs=3,
                    )


def _message(drawn: random.Random, typical_ms: float, lost_share: float) -> int | str:
    if drawn.random() < lost_share:
        return drawn.choice(("lost_outbound", "lost_return"))
    return round(typical_ms * MS * drawn.lognormvariate(0.0, 0.12))


CAMPAIGNS: dict[str, Callable[[], Analysis]] = {
    "demo": cache(demo),
    "lossy machine": kept(lossy_machine),
    "study": kept(study),
    "500 groups": EVERY_ANALYSIS["500 groups"],
}
"""The four campaigns by name, the smallest first: browser tests and screenshots show these."""
