"""Twenty recordings of shapes that public bags have, with known deletions."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from card_bags import HEADER, MS, START_NS, blob, write_mcap


@dataclass
class Shape:
    """Times in ms of what was sent, which of it is deleted, and whether its number can be known."""

    sent_ms: np.ndarray
    deleted: np.ndarray
    is_known: bool = True
    frames: list[str] = field(default_factory=lambda: ["a"])
    stamp_ms: np.ndarray | None = None
    sizes: np.ndarray | None = None
    frame_of: np.ndarray | None = None


def timer(
    rate_hz: float, seconds: float, jitter_ms: float, rng: np.random.Generator, *, drift: bool = False
) -> np.ndarray:
    """A timer's messages: late by a jitter of their own, or each counted from the previous one."""
    count = int(rate_hz * seconds)
    late = np.abs(rng.normal(0, jitter_ms, count))
    if drift:
        return np.cumsum(1000 / rate_hz + rng.normal(0, jitter_ms, count))
    return np.arange(count) * 1000 / rate_hz + late


def drop(count: int, share: float, rng: np.random.Generator, *holes: tuple[int, int]) -> np.ndarray:
    """Single losses at random, and holes (start, length); first and last are kept."""
    deleted = rng.random(count) < share
    for start, length in holes:
        deleted[start : start + length] = True
    deleted[[0, -1]] = False
    return deleted


def shapes() -> dict[str, Shape]:
    rng = np.random.default_rng(20)
    made: dict[str, Shape] = {}

    def add(name: str, sent_ms: np.ndarray, share: float, *holes: tuple[int, int], **more: object) -> None:
        made[name] = Shape(sent_ms, drop(len(sent_ms), share, rng, *holes), **more)

    add("camera 30 Hz", timer(30, 120, 1, rng), 0.02, (1200, 80))
    add("camera 20 Hz, whole", timer(20, 60, 0.4, rng), 0)
    add("imu 100 Hz", timer(100, 60, 0.2, rng), 0.01)
    add("imu 400 Hz, jitter 40 %", timer(400, 30, 1, rng), 0.01)
    add("lidar 10 Hz", timer(10, 120, 3, rng), 0.05, (300, 30))
    add("gps 1 Hz", timer(1, 300, 20, rng), 0.03)
    add("joint states 500 Hz", timer(500, 20, 0.1, rng), 0.005, (4000, 1500))
    add("sleeping loop 50 Hz", timer(50, 60, 1.5, rng, drift=True), 0.02)
    add("every tenth lost", timer(50, 60, 1, rng), 0.1)
    add("a third lost", timer(20, 100, 1, rng), 0.33)
    half = timer(15, 60, 1, rng) + 60_000
    add("camera slows down from 30 to 15 Hz", np.concatenate([timer(30, 60, 1, rng), half]), 0.01)
    add(
        "wifi: log late by 200 ms, stamps steady",
        np.sort(timer(20, 60, 60, rng)),
        0.02,
        stamp_ms=np.arange(1200) * 50.0,
    )
    two = [timer(50, 40, 0.2, rng), timer(50, 40, 0.2, rng) + 1]
    order = np.argsort(np.concatenate(two), kind="stable")
    add("two publishers of 50 Hz", np.concatenate(two)[order], 0.01)
    two = [timer(50, 40, 0.2, rng), timer(31, 40, 0.2, rng) + 3]
    order = np.argsort(np.concatenate(two), kind="stable")
    frame_of = np.repeat([0, 1], [len(part) for part in two])[order]
    add("two publishers of 50 and 31 Hz", np.concatenate(two)[order], 0.02, frame_of=frame_of, frames=["odom", "map"])
    two = [timer(100, 40, 0.2, rng), timer(7, 40, 0.2, rng) + 3]
    order = np.argsort(np.concatenate(two), kind="stable")
    sizes = np.repeat([40, 72], [len(part) for part in two])[order]
    add("two publishers by size", np.concatenate(two)[order], 0.02, sizes=sizes)
    batches = (np.arange(100)[:, None] * 200 + np.arange(8) * 0.125).ravel()
    add("batches of eight", batches + rng.normal(0, 0.01, 800).cumsum() * 0, 0.01)
    add("events", np.cumsum(rng.exponential(100, 600)), 0, is_known=False)
    add("latched", np.array([0.0, 5.0]), 0, is_known=False)
    add("button, eight times", np.cumsum(rng.exponential(5000, 8)), 0, is_known=False)
    bursts = np.concatenate([start * 1000 + np.arange(rng.integers(5, 40)) * 10.0 for start in range(0, 60, 5)])
    add("planner while it plans", bursts, 0, is_known=False)
    return made


def write_shape(path: Path, shape: Shape) -> int:
    """Write what is left as MCAP of ROS 2 messages with a header; return the number of deleted messages."""
    messages = []
    for at in np.flatnonzero(~shape.deleted).tolist():
        log_ns = START_NS + int(shape.sent_ms[at] * MS)
        stamp_ns = log_ns if shape.stamp_ms is None else START_NS + int(shape.stamp_ms[at] * MS)
        frame = shape.frames[0 if shape.frame_of is None else shape.frame_of[at]]
        size = 16 if shape.sizes is None else int(shape.sizes[at])
        messages.append(("/topic", log_ns, log_ns, blob(stamp_ns, size, frame)))
    messages.append(("/end", START_NS + int(shape.sent_ms[-1] * MS), 0, messages[-1][-1]))
    write_mcap(path, messages, encoding="cdr", schema=HEADER)
    return int(shape.deleted.sum())
