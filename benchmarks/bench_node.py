"""The own share of a node: the round trip between `dds-record` ping and relay, and of programs that do nothing else.

    python benchmarks/bench_node.py [--rounds 5] [--seconds 2] [--backend socket] [--awake] [--json] [--csv FILE]

Sockets against a blocking Python ping-pong, against C and against sockperf over TCP; zenoh against twenty lines of zenoh-python that return a message
as it came, and that write into it, as a relay does (two more copies);
Cyclone DDS against ddsperf in its waitset mode; ROS 2 against a bare rclpy echo on the default and on the events executor. All
run in turn, round by round and each second round backwards, real processes over loopback; each ratio is the median over the
rounds of ours to theirs, medians of the RTT. sockperf and ddsperf are Debian's (`sockperf`, `cyclonedds-tools`), looked for on
PATH and at SOCKPERF and DDSPERF; what is not there is left out, and said. Exit code 1 if a bar is missed.

Each side has a processor of its own (`taskset`), as two devices have: where the scheduler is free to, it puts two programs that wake each
other on one processor, and then a blocking pair takes 18 us where 155 us are needed to wake another (measured). sockperf spins between two
messages, so its caches are warm and its sending core awake; ddsperf prints half of a round trip, which is doubled here.

`--awake` keeps every core awake for all programs alike, by processes that run only where nothing else wants to: what is left of a ratio is
what the programs do, and not how deep the cores of this machine sleep, on a virtual one whatever its host does then.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from timing import awake_cores

from dds_trace.recorder.backends.cyclone_settings import cyclone_settings
from dds_trace.recorder.choices import Discovery
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.reading.reader import read_trace

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    Measure: TypeAlias = "Callable[[Load, Path], float]"

RECORD = Path(sys.executable).with_name("dds-record")
PLAIN = Path(__file__).with_name("plain_nodes.py")
TCP_PEER = Path(__file__).with_name("tcp_peer.c")
SIZES_BYTES = (64, 1_000, 33_000, 145_000, 502_000, 1_000_000, 4_000_000)
MOST_BYTE_S = 33_000_000
"""Most payload bytes a second at a rate of `RATES_HZ`; larger messages are sent at `LARGE_HZ`."""
RATES_HZ = (100, 1_000)
LARGE_HZ = 10
WARM_UP_S = 0.5
PORT = 21_471
DOMAIN_ID = 71
LOCALHOST = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(DOMAIN_ID)}
CYCLONE = {"CYCLONEDDS_URI": cyclone_settings(Discovery.LOCALHOST, tuned=False, environment={}, on_loopback=True)}


@dataclass(frozen=True, slots=True)
class Load:
    """One load: message size, rate, and how long it runs."""

    size_bytes: int
    rate_hz: int
    seconds: float

    @property
    def warm_up(self) -> int:
        """Number of messages that do not count."""
        return round(WARM_UP_S * self.rate_hz)

    @property
    def messages(self) -> int:
        """Number of messages that count."""
        return round(self.seconds * self.rate_hz)


is_pinning = True
"""Whether each side is kept on a processor of its own; `--unpinned` leaves it to the scheduler."""


def on_processor(place: int) -> tuple[str, ...]:
    """Return the words that keep a program on one processor of those that this process may use."""
    usable = sorted(os.sched_getaffinity(0)) if is_pinning else []
    return ("taskset", "--cpu-list", str(usable[place])) if len(usable) > place else ()


@contextmanager
def serving(command: Sequence[object], ready: str, environment: Mapping[str, str] | None = None) -> Iterator[None]:
    """Run a process from its line that matches `ready` to the end of the block."""
    process = subprocess.Popen(
        [*on_processor(1), *(str(word) for word in command)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, **(environment or {})},
    )
    try:
        assert process.stdout is not None
        said = []
        for line in process.stdout:
            said.append(line)
            if re.search(ready, line):
                break
        else:
            raise RuntimeError(f"{command[0]} ended: {''.join(said)}")
        yield
    finally:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.communicate(timeout=5)
        process.kill()
        process.communicate()


def output_of(command: Sequence[object], environment: Mapping[str, str] | None = None) -> str:
    """Return what a process prints."""
    done = subprocess.run(
        [*on_processor(0), *(str(word) for word in command)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env={**os.environ, **(environment or {})},
    )
    if done.returncode:
        raise RuntimeError(f"{command[0]}: {done.stdout}{done.stderr}")
    return done.stdout


def median_us(times_ns: Sequence[int], load: Load) -> float:
    """Return the median of the times after the warm-up, in us."""
    return statistics.median(times_ns[load.warm_up :]) / 1e3


def times_in(printed: str) -> list[int]:
    """Return the times of the last line; a middleware may print before it."""
    times: list[int] = json.loads(printed.splitlines()[-1])
    return times


def record(backend: str, more: Sequence[object], of_ping: Sequence[object], folder: Path) -> Path:
    """Record a ping of binary data and its relay; return the ping's trace, which is next to the relay's."""
    common = [RECORD, "--backend", backend, "--domain", DOMAIN_ID, "--discovery", "localhost", "--force", *more]
    relay, ping = (folder / f"{backend}-{role}.mcap" for role in ("relay", "ping"))
    with serving([*common, "--role", "relay", "--out", relay], "serves domain"):
        output_of([*common, "--role", "ping", "--out", ping, "--data", "binary", *of_ping])
    return ping


def ours(backend: str, *more: str) -> Measure:
    """Return the contender that is `dds-record` on a backend, with `more` options."""

    def measure(load: Load, folder: Path) -> float:
        counts = ["--rate", load.rate_hz, "--messages", load.messages, "--warmup", load.warm_up]
        events = read_trace(record(backend, more, ["--size", load.size_bytes, *counts], folder)).events
        sent, received = events[Stage.T1], events[Stage.T2]
        _, at, of = np.intersect1d(sent.sequence, received.sequence, return_indices=True)
        return median_us((received.monotonic_ns[of] - sent.monotonic_ns[at]).tolist(), load)

    return measure


def plain(program: str, *first: object, environment: Mapping[str, str] | None = None) -> Measure:
    """Return the contender that is a pair of `plain_nodes.py`; `first` are its first words."""

    def measure(load: Load, _folder: Path) -> float:
        words = [sys.executable, PLAIN]
        with serving([*words, f"{program}-echo", *first, load.size_bytes], "ready", environment):
            numbers = (load.size_bytes, load.rate_hz, load.warm_up + load.messages)
            return median_us(times_in(output_of([*words, f"{program}-ping", *first, *numbers], environment)), load)

    return measure


def tcp_in_c(load: Load, folder: Path) -> float:
    """Measure a blocking ping-pong in C, which is compiled once."""
    program = folder / "tcp_peer"
    if not program.exists():
        subprocess.run([program_at("cc") or "cc", "-O2", "-o", program, TCP_PEER], check=True)
    with serving([program, "echo", PORT, load.size_bytes], "ready"):
        ping = [program, "ping", PORT, load.size_bytes, load.rate_hz, load.warm_up + load.messages]
        return median_us(times_in(output_of(ping)), load)


def sockperf(load: Load, _folder: Path) -> float:
    """Measure sockperf over TCP; it has a warm-up of its own."""
    program = program_at("sockperf")
    common = ["--tcp", "-i", "127.0.0.1", "-p", PORT + 1, "-m", load.size_bytes]
    with serving([program, "server", *common], r"LISTEN|listen on"):
        while (
            f":{PORT + 1:04X} 00000000:0000 0A" not in Path("/proc/net/tcp").read_text()
        ):  # it says so before it listens
            time.sleep(0.01)
        ping = [program, "ping-pong", *common, "--mps", load.rate_hz, "-t", load.seconds + WARM_UP_S, "--full-rtt"]
        printed = output_of(ping)
    found = re.search(r"percentile 50\.000 =\s+([\d.]+)", printed)
    assert found, printed
    return float(found[1])


def ddsperf(load: Load, _folder: Path) -> float:
    """Measure ddsperf's waitset mode; it prints the median of each second, the first of which is left out."""
    program = program_at("ddsperf")
    common = [program, "-i", DOMAIN_ID, "-D"]
    seconds = max(round(load.seconds + WARM_UP_S), 2) + 1
    with serving([*common, 60, "pong", "waitset"], r"new \(self\)", CYCLONE):
        printed = output_of(
            [*common, seconds, "ping", f"{load.rate_hz}Hz", "size", load.size_bytes, "waitset"], CYCLONE
        )
    halves = [float(text) for text in re.findall(r"size \d+ mean .* 50% ([\d.]+)us", printed)]
    return 2 * statistics.median(halves[1:] or halves)


def program_at(name: str) -> str | None:
    """Return the path of a program of the system, None if it is not there."""
    return shutil.which(os.environ.get(name.upper(), name))


@dataclass(frozen=True, slots=True)
class Contest:
    """Our node on one backend and another program.

    Attributes:
        more: further options of ours.
        name: the other program; `needs` on this machine.
        measure: measures the other program's median RTT in us.
        bar: largest good ratio of ours to theirs; None where it is only stated.
        most_bytes: largest message that the other program sends.
        own: measures ours, None for the median RTT.
    """

    backend: str
    name: str
    measure: Measure
    bar: float | None
    needs: str | None = None
    more: tuple[str, ...] = ()
    most_bytes: int = 4_000_000
    own: Measure | None = None

    @property
    def label(self) -> str:
        """Return the name of ours."""
        return " ".join((self.backend, *self.more[1::2]))


RCLPY = {**LOCALHOST, "RMW_IMPLEMENTATION": os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")}
"""Bare rclpy on the middleware that ours chooses."""

CONTESTS = (
    Contest("socket", "blocking Python", plain("socket", PORT), 1.2),
    Contest("socket", "C over TCP", tcp_in_c, None, "cc"),
    Contest("socket", "sockperf", sockperf, 1.3, "sockperf", most_bytes=65_000),
    Contest("zenoh", "bare zenoh", plain("zenoh", PORT + 2), 1.2),
    Contest("zenoh", "zenoh, writing", plain("zenoh-write", PORT + 3), 1.2),
    Contest("cyclonedds", "ddsperf waitset", ddsperf, 1.25, "ddsperf"),
    Contest("ros2", "bare rclpy", plain("ros2", environment=RCLPY), None),
    Contest("ros2", "rclpy, events", plain("ros2-events", environment=RCLPY), None),
    Contest("ros2", "bare rclpy", plain("ros2", environment=RCLPY), None, more=("--executor", "single")),
)


@dataclass(frozen=True, slots=True)
class Result:
    """The ratio of one contest under one load; times are medians over the rounds of the median RTT, in us.

    At rate 0 (as fast as it goes) of the time between two messages, and the ratio is of messages a second.
    """

    ours: str
    against: str
    size_bytes: int
    rate_hz: int
    ours_us: float
    theirs_us: float
    ratio: float
    ratios: tuple[float, ...]
    bar: float | None
    client_bound: int | None = None
    """Rounds in which ours found that a throughput is our ping's or relay's."""

    @property
    def holds(self) -> bool:
        """Whether the ratio is good enough."""
        return self.bar is None or self.ratio <= self.bar


def measured_or_nan(measure: Measure, load: Load, folder: Path) -> float:
    """Return NaN, and print why, where a program did not get through."""
    try:
        return measure(load, folder)
    except (RuntimeError, ValueError, IndexError, subprocess.TimeoutExpired) as error:
        print(f"{load}: {str(error)[-300:]}", file=sys.stderr)
        return math.nan


def measure_load(contests: Sequence[Contest], load: Load, rounds: int, folder: Path) -> list[Result]:
    """Measure every program once a round, each of ours once for all that it is compared with, every second round backwards."""
    contenders: dict[str, Measure] = {}
    for contest in contests:
        contenders[contest.label] = contest.own or ours(contest.backend, *contest.more)
        contenders[f"against {contest.name}"] = contest.measure
    times_us: dict[str, list[float]] = {name: [] for name in contenders}
    for number in range(rounds):
        for name, measure in list(contenders.items())[:: -1 if number % 2 else 1]:
            times_us[name].append(measured_or_nan(measure, load, folder))
    results = []
    for contest in contests:
        own, other = times_us[contest.label], times_us[f"against {contest.name}"]
        pairs = [pair for pair in zip(own, other, strict=True) if not math.isnan(sum(pair))]
        if pairs:
            ratios = [mine / theirs if load.rate_hz else theirs / mine for mine, theirs in pairs]
            medians_us = [round(statistics.median(times), 1) for times in zip(*pairs, strict=True)]
            sizes = load.size_bytes, load.rate_hz, *medians_us
            rounded = tuple(round(ratio, 3) for ratio in ratios)
            results.append(
                Result(contest.label, contest.name, *sizes, round(statistics.median(ratios), 3), rounded, contest.bar)
            )
    return results


def print_result(result: Result) -> None:
    """Print one line of the table."""
    bar = "stated" if result.bar is None else f"<= {result.bar}"
    missed = "" if result.holds else "  MISSED"
    print(
        f"{result.ours:13}{result.against:16}{result.size_bytes:>8} B{result.rate_hz:>6} Hz"
        f"{result.ours_us:>9.0f} us{result.theirs_us:>9.0f} us{result.ratio:>7.2f}  {bar}{missed}",
        flush=True,
    )


def loads_of(sizes: Sequence[int], rates: Sequence[int] | None) -> list[tuple[int, int]]:
    """Return sizes and rates: both of `RATES_HZ`, for large messages a lower one."""
    return [
        (size, rate)
        for size in sizes
        for rate in rates or [hz for hz in RATES_HZ if size * hz <= MOST_BYTE_S] or [LARGE_HZ]
    ]


def write_csv(results: Sequence[Result], path: Path) -> None:
    """Write a row for each result, all its rounds in one field; contests that did not run keep their rows."""
    rows = [{**asdict(result), "ratios": " ".join(map(str, result.ratios))} for result in results]
    measured = {(row["ours"], row["against"]) for row in rows}
    if path.exists():
        with path.open(encoding="utf-8", newline="") as file:
            rows += [row for row in csv.DictReader(file) if (row["ours"], row["against"]) not in measured]
    order = {(contest.label, contest.name): place for place, contest in enumerate(CONTESTS)}
    last = len(order)
    rows.sort(
        key=lambda row: (order.get((row["ours"], row["against"]), last), int(row["size_bytes"]), int(row["rate_hz"]))
    )
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, rows[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def main() -> int:
    """Print the table; the exit code says whether every bar holds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=2, help="of each program and load, warm-up not included")
    parser.add_argument("--backend", action="append", choices=sorted({contest.backend for contest in CONTESTS}))
    parser.add_argument("--size", type=int, action="append", help=f"bytes (default: {SIZES_BYTES})")
    parser.add_argument("--rate", type=int, action="append", help=f"messages a second (default: {RATES_HZ})")
    parser.add_argument(
        "--unpinned", action="store_true", help="let the scheduler put both sides on one processor, where it likes to"
    )
    parser.add_argument(
        "--awake", action="store_true", help="keep every core awake, as a robot's are not: for all programs alike"
    )
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--csv", type=Path, help="write the results there, for `python scripts/quoted.py`")
    options = parser.parse_args()
    global is_pinning  # noqa: PLW0603 - a setting of this program
    is_pinning = not options.unpinned
    contests = []
    for contest in CONTESTS:
        if options.backend and contest.backend not in options.backend:
            continue
        if contest.needs and program_at(contest.needs) is None:
            print(f"not measured: {contest.needs} is not on this machine", file=sys.stderr)
            continue
        contests.append(contest)
    results = []
    waking = awake_cores() if options.awake else nullcontext()
    with waking, tempfile.TemporaryDirectory(prefix="dds-trace-bench-") as folder:
        for size_bytes, rate_hz in loads_of(options.size or SIZES_BYTES, options.rate):
            load = Load(size_bytes, rate_hz, options.seconds)
            fitting = [contest for contest in contests if size_bytes <= contest.most_bytes]
            for result in measure_load(fitting, load, options.rounds, Path(folder)):
                results.append(result)
                if not options.json:
                    print_result(result)
            if options.csv and results:  # an interrupted run keeps what it measured
                write_csv(results, options.csv)
    if options.json:
        print(json.dumps([asdict(result) for result in results], indent=2))
    return 0 if all(result.holds for result in results) else 1


if __name__ == "__main__":
    sys.exit(main())
