"""Campaigns drawn at random: places, ways, flows, rates, losses, relays without a trace, and tails that differ more than medians."""

import random
from collections.abc import Iterator

from analyses import BRIDGED, MS, ZENOH, Measured, make_analysis

from dds_trace import Analysis

SOCKET = {"vendor": "socket", "relay_vendor": "socket", "backend": "socket", "rmw": None}
SIDES = (
    {},
    ZENOH,
    {"vendor": "cyclonedds", "relay_vendor": "cyclonedds"},
    BRIDGED,
    {"setting": "queue_depth=1"},
    SOCKET,
)
FLOWS = ("flow=camera", "flow=camera,flows=2,with=imu", "flow=imu,flows=2,with=camera", "flow=imu")


def drawn_campaign(seed: int) -> Analysis:
    chance = random.Random(seed)
    sides = chance.sample(SIDES, chance.choice((1, 2, 2, 3)))
    places = chance.sample(("wired", "wireless", "loopback"), chance.choice((1, 1, 2)))
    sizes, rates = (
        chance.sample([1000, 33_000, 502_000], chance.choice((1, 2))),
        [10.0, 50.0][: chance.choice((1, 1, 2))],
    )
    count = chance.choice((20, 60, 400))
    measured = []
    for place in places:
        relay = chance.choice(("pi-two", "pi-two", "pi-two", None))
        for side in sides:
            for size in sizes if chance.random() < 0.8 else sizes[:1]:
                for rate_hz in rates:
                    messages = list(_messages(chance, count))
                    given = {"payload_bytes": size, "rate_hz": rate_hz, "connectivity": place, "relay_device": relay}
                    unsent = chance.choice((0, 0, 0, 7))
                    measured.append(Measured(messages, **given, unsent=unsent, **side))
    if seed % 4 == 0:
        measured += [
            Measured(list(_messages(chance, count)), setting=flow, **chance.choice(({}, ZENOH))) for flow in FLOWS
        ]
    return make_analysis(*measured, title=f"drawn by {seed}")


def _messages(chance: random.Random, count: int) -> Iterator[int | str]:
    typical_ns, lost = chance.choice((1, 1, 1.5, 4)) * MS, chance.choice((0, 0, 0, 0.01, 0.2))
    slow = chance.choice((1, 1, 8))  # of one message in thirty
    for _ in range(count):
        ns = typical_ns * chance.lognormvariate(0, 0.05) * (slow if chance.random() < 1 / 30 else 1)
        yield "lost_return" if chance.random() < lost else round(ns)
