"""What a tap costs others: latency of another subscriber and CPU of publisher and tap, with and without it in turn.

    python benchmarks/bench_tap.py [--pairs 8] [--seconds 6] [--backend ros2] [--control] [--awake] [--json]

A publisher and a subscriber of ROS 2 run throughout; the tap is started and ended beside them, and its first second does not
count. Each pair of slices gives one ratio, and the pairs an interval of the median (sign test, 95 %). Exit code 1 if a bar is
missed: the subscriber's p50 within 5 %, the tap at most 5 % of a core at 50 Hz. `--control` measures the topic of 50 Hz alone, and a
second plain subscriber of rclpy in turn with tap and nothing, in an order drawn for each round: what any second subscriber costs.
`--awake` keeps every core awake throughout: else a second subscriber makes the first one faster, as cores sleep less.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from math import comb
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import psutil
from timing import awake_cores

if TYPE_CHECKING:
    from collections.abc import Sequence

CASES = ((100_000, 50.0), (1_000_000, 20.0))
"""Bytes and Hz of the topic."""
DOMAIN = 97
MOST_SLOWER, MOST_CORE = 1.05, 0.05
SETTLE_S = 1.0
ENVIRONMENT = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(DOMAIN)}

NODE = """
import sys, time, struct
import rclpy
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image
role, size, rate_hz, path = sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), sys.argv[4]
rclpy.init()
node = rclpy.create_node(role)
if role == "publisher":
    publisher = node.create_publisher(Image, "camera/image", QoSProfile(depth=10))
    message = Image(height=1, width=size, step=size, data=bytes(size))
    start, number = time.monotonic(), 0
    while True:
        number += 1
        time.sleep(max(start + number / rate_hz - time.monotonic(), 0))
        now = time.monotonic_ns()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, 10**9)
        publisher.publish(message)
else:
    from rclpy.experimental import EventsExecutor
    out = open(path, "wb", buffering=0)
    def receive(data):
        now = time.monotonic_ns()
        seconds, nanoseconds = struct.unpack_from("<iI", data, 4)
        out.write(struct.pack("<qq", now, now - seconds * 10**9 - nanoseconds))
    node.create_subscription(Image, "camera/image", receive, QoSProfile(depth=10), raw=True)
    executor = EventsExecutor()
    executor.add_node(node)
    while True:
        executor.spin_once(timeout_sec=0.1)
"""


@dataclass(frozen=True)
class Slice:
    """Seconds of a running topic: the subscriber's median latency, shares of a core of publisher and tap."""

    p50_us: float
    messages: int
    publisher_core: float
    tap_core: float | None


@dataclass(frozen=True)
class Result:
    """One case: medians over slices, and the median ratio of pairs with its interval."""

    payload_bytes: int
    rate_hz: float
    pairs: int
    p50_us_without: float
    p50_us_with: float
    ratio: float
    ratio_low: float
    ratio_high: float
    publisher_core_without: float
    publisher_core_with: float
    tap_core: float
    control: tuple[float, float, float] | None = None
    tap_against_control: tuple[float, float, float] | None = None

    @property
    def of_control(self) -> str:
        """The ratios of the control in words."""
        if self.control is None or self.tap_against_control is None:
            return ""
        plain, tap = ("{:.3f} ({:.3f} to {:.3f})".format(*ratio) for ratio in (self.control, self.tap_against_control))
        return f"; with a plain subscriber {plain}, tap against that {tap}"


def start(role: str, size: int, rate_hz: float, path: Path) -> subprocess.Popen[bytes]:
    """Start publisher or subscriber."""
    command = [sys.executable, "-c", NODE, role, str(size), str(rate_hz), str(path)]
    return subprocess.Popen(command, env=ENVIRONMENT, stderr=subprocess.DEVNULL)


def start_tap(folder: Path, backend: str) -> subprocess.Popen[str]:
    """Start a tap and wait until it has joined."""
    out = folder / f"tap{time.monotonic_ns()}.mcap"
    words = ("--role", "tap", "--topics", "/camera/image", "--backend", backend, "--no-own-cost", "--out", str(out))
    tap = subprocess.Popen(
        [str(Path(sys.executable).with_name("dds-record")), *words],
        env=ENVIRONMENT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert tap.stderr is not None
    for line in tap.stderr:
        if "joined" in line:
            return tap
    raise RuntimeError("the tap did not join the topic")


def start_plain(folder: Path, size: int, rate_hz: float) -> subprocess.Popen[bytes]:
    """Start another subscriber and wait until it hears the topic."""
    heard = folder / f"plain{time.monotonic_ns()}"
    plain = start("subscriber", size, rate_hz, heard)
    while not (heard.exists() and heard.stat().st_size):
        time.sleep(0.1)
    return plain


def end(process: subprocess.Popen) -> None:  # type: ignore[type-arg]
    """End a process of ours."""
    process.send_signal(signal.SIGINT)
    try:
        process.wait(10)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def cpu_s(pid: int) -> float:
    """Return the processor time of a process so far."""
    times = psutil.Process(pid).cpu_times()
    return float(times.user + times.system)


def measure(seconds: float, latencies: Path, publisher: int, tap: int | None) -> Slice:
    """Measure one slice."""
    time.sleep(SETTLE_S)
    begin_ns, before = time.monotonic_ns(), [cpu_s(pid) for pid in (publisher, tap) if pid]
    time.sleep(seconds)
    end_ns, after = time.monotonic_ns(), [cpu_s(pid) for pid in (publisher, tap) if pid]
    cores = [(later - earlier) * 1e9 / (end_ns - begin_ns) for earlier, later in zip(before, after, strict=True)]
    content = latencies.read_bytes()
    rows = np.frombuffer(content[: len(content) // 16 * 16], "<i8").reshape(-1, 2)
    rows = rows[(rows[:, 0] >= begin_ns) & (rows[:, 0] < end_ns)]
    return Slice(float(np.median(rows[:, 1])) / 1000, len(rows), cores[0], cores[1] if tap else None)


def median_interval(values: Sequence[float]) -> tuple[float, float]:
    """Return the distribution-free 95 % interval of a median, all values if there are too few."""
    ordered, count = sorted(values), len(values)
    first, tail = 0, 0.0
    for position in range(count // 2):
        tail += comb(count, position) / 2**count
        if tail > 0.025:
            break
        first = position
    return ordered[first], ordered[count - 1 - first]


def ratio_of(slices: Sequence[Slice], base: Sequence[Slice]) -> tuple[float, float, float]:
    """Return the median ratio of p50 of neighbouring slices, and its interval."""
    ratios = [one.p50_us / other.p50_us for one, other in zip(slices, base, strict=True)]
    return statistics.median(ratios), *median_interval(ratios)


def run_case(size: int, rate_hz: float, pairs: int, seconds: float, backend: str, *, control: bool) -> Result:
    """Measure one topic."""
    kinds = ("nothing", "tap", "plain") if control else ("nothing", "tap")
    slices: dict[str, list[Slice]] = {kind: [] for kind in kinds}
    with tempfile.TemporaryDirectory(prefix="bench-tap-") as name:
        folder = Path(name)
        latencies = folder / "latencies"
        processes = [start(role, size, rate_hz, latencies) for role in ("subscriber", "publisher")]
        try:
            deadline = time.monotonic() + 30
            while not (latencies.exists() and latencies.stat().st_size > 1600) and time.monotonic() < deadline:
                time.sleep(0.2)
            order = random.Random(pairs)
            for _ in range(pairs):
                for kind in order.sample(kinds, len(kinds)):
                    other: subprocess.Popen[str] | subprocess.Popen[bytes] | None = None
                    if kind != "nothing":
                        other = start_tap(folder, backend) if kind == "tap" else start_plain(folder, size, rate_hz)
                    slices[kind].append(measure(seconds, latencies, processes[1].pid, other.pid if other else None))
                    if other is not None:
                        end(other)
        finally:
            for process in processes:
                end(process)
    without, with_tap = slices["nothing"], slices["tap"]
    ratio, low, high = ratio_of(with_tap, without)
    middle = statistics.median
    return Result(
        payload_bytes=size,
        rate_hz=rate_hz,
        pairs=pairs,
        p50_us_without=middle(part.p50_us for part in without),
        p50_us_with=middle(part.p50_us for part in with_tap),
        ratio=ratio,
        ratio_low=low,
        ratio_high=high,
        publisher_core_without=middle(part.publisher_core for part in without),
        publisher_core_with=middle(part.publisher_core for part in with_tap),
        tap_core=middle(part.tap_core or 0.0 for part in with_tap),
        control=ratio_of(slices["plain"], without) if control else None,
        tap_against_control=ratio_of(with_tap, slices["plain"]) if control else None,
    )


def main() -> int:
    """Print a row for each case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--backend", default="ros2")
    parser.add_argument("--control", action="store_true")
    parser.add_argument("--awake", action="store_true", help="keep every core awake")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    results = []
    for size, rate_hz in CASES[:1] if arguments.control else CASES:
        with awake_cores() if arguments.awake else nullcontext():
            result = run_case(
                size, rate_hz, arguments.pairs, arguments.seconds, arguments.backend, control=arguments.control
            )
        results.append(result)
        if not arguments.json:
            print(
                f"{size / 1000:.0f} KB at {rate_hz:g} Hz: p50 {result.p50_us_without:.0f} us without, {result.p50_us_with:.0f} us "
                f"with a tap, ratio {result.ratio:.3f} ({result.ratio_low:.3f} to {result.ratio_high:.3f}); publisher "
                f"{result.publisher_core_without:.1%} -> {result.publisher_core_with:.1%} of a core, tap {result.tap_core:.1%}"
                f"{result.of_control}",
                flush=True,
            )
    if arguments.json:
        print(json.dumps([asdict(result) for result in results]))
    missed = [one for one in results if one.ratio > MOST_SLOWER or (one.rate_hz == 50 and one.tap_core > MOST_CORE)]
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
