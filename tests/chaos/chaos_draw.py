"""A round of chaos as its seed draws it: a small plan, and what goes wrong while it is recorded."""

import random
from dataclasses import dataclass
from importlib.util import find_spec

from dds_trace.extensions.bridges.base import load_bridge

COMBINATIONS = {
    ("socket", "none"): (),
    ("zenoh", "none"): ("zenoh",),
    ("cyclonedds", "none"): ("cyclonedds",),
    ("ros2", "none"): ("rclpy",),
    ("ros2", "builtin"): ("rclpy",),
    ("ros2", "builtin-zenoh"): ("rclpy", "zenoh"),
    ("ros2", "zenoh-bridge-dds"): ("rclpy",),
    ("cyclonedds", "zenoh-bridge-dds"): ("cyclonedds",),
    ("ros2", "zenoh-bridge-ros2dds"): ("rclpy",),
}
"""Backend and bridge -> Python modules that they need. Connext needs a licence, so it is not here."""

OWN_BRIDGES = ("none", "builtin", "builtin-zenoh")

NETWORKS = {
    "loopback": "",
    "veth": "[network]\nnamespaces = true\n",
    "link": "[link]\nrate_mbit_s = 100\ndelay_ms = 2\nloss_percent = 0.1\n",
}
"""Name of what is between ping and relay -> table of the plan."""

LOADS = (
    'data = "imu"\nrate = 100\n',
    'data = "string"\nsize = 1405\nrate = 50\n',
    'data = "binary"\nsize = "33KB"\nrate = 50\n',
    'data = "binary"\nsize = "200KB"\nrate = 20\n',
)

RUN = "[run]\nmessages = {messages}\nwarmup = 2\nsettle_seconds = 0.1\ncutoff_seconds = 10\nattempts = 3\ndomain = 10\nping_domain = 5\n"

TARGETS = ("ping", "relay", "bridge", "sweep", "any")
SLOW_MS = (5, 20, 100)


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that goes wrong.

    Attributes:
        kind: key of `chaos_faults.FAULTS`.
        target: process of `kill` and `stop`, one of `TARGETS`.
        at_s: seconds after the first ping of the call.
        for_s: seconds that it lasts; 0 if it has no end.
    """

    kind: str
    target: str
    at_s: float
    for_s: float

    def __str__(self) -> str:
        lasting = f"+{self.for_s:.1f}" if self.for_s else ""
        return f"{self.kind}{':' * bool(self.target)}{self.target}@{self.at_s:.1f}{lasting}"


@dataclass(frozen=True, slots=True)
class Round:
    """A plan with its backend and bridge (`combination`), network and number of cells, and the faults of each disturbed call.

    While the disk is slow, a write takes `slow_ms`.
    """

    seed: int
    combination: tuple[str, str]
    network: str
    cells: int
    plan: str
    calls: tuple[tuple[Fault, ...], ...]
    slow_ms: int


def installed_combinations() -> list[tuple[str, str]]:
    return [
        (backend, bridge)
        for (backend, bridge), modules in COMBINATIONS.items()
        if all(find_spec(module) for module in modules)
        and (bridge in OWN_BRIDGES or load_bridge(bridge).find() is not None)
    ]


def draw_round(seed: int, combinations: list[tuple[str, str]]) -> Round:
    draw = random.Random(f"chaos {seed}")
    # One after the other, so that a short time reaches all of them.
    combination = combinations[seed % len(combinations)]
    network = draw.choice(list(NETWORKS))
    loads = draw.sample(LOADS, draw.randint(2, 4))
    messages = draw.choice((40, 100, 200))
    backend, bridge = combination
    axes = f'[axes]\nbackend = "{backend}"\nbridge = "{bridge}"\n'
    matrix = "".join(f"[[matrix]]\n{load}" for load in loads)
    calls = tuple(_draw_faults(draw, bridge) for _ in range(draw.randint(1, 2)))
    return Round(
        seed=seed,
        combination=combination,
        network=network,
        cells=len(loads),
        plan=RUN.format(messages=messages) + NETWORKS[network] + axes + matrix,
        calls=calls,
        slow_ms=draw.choice(SLOW_MS),
    )


def _draw_faults(draw: random.Random, bridge: str) -> tuple[Fault, ...]:
    targets = [target for target in TARGETS if target != "bridge" or bridge != "none"]
    faults = []
    for _ in range(draw.randint(1, 3)):
        kind = draw.choice(("kill", "kill", "stop", "interrupt", "full-disk", "outage", "slow-disk"))
        lasts = {"stop": (0.2, 3.0), "full-disk": (0.2, 5.0), "outage": (0.2, 2.0), "slow-disk": (1.0, 6.0)}
        faults.append(
            Fault(
                kind=kind,
                target=draw.choice(targets) if kind in ("kill", "stop") else "",
                at_s=round(draw.uniform(0.0, 4.0), 1),
                for_s=round(draw.uniform(*lasts[kind]), 1) if kind in lasts else 0.0,
            )
        )
    return tuple(sorted(faults, key=lambda fault: fault.at_s))
