"""The own share of a node: the round trip between `dds-record` ping and relay, beside programs that do nothing else.

    python benchmarks/bench_node.py [--rounds 5] [--seconds 2] [--backend socket] [--awake] [--json]

Against a blocking Python ping-pong and sockperf over TCP, against ddsperf in its waitset mode on Cyclone DDS, and against a
bare rclpy echo. All run in turn, round by round, real processes over loopback; each ratio is the median over the rounds of
ours to theirs, medians of the RTT. sockperf and ddsperf are Debian's (`sockperf`, `cyclonedds-tools`), looked for on PATH and
at SOCKPERF and DDSPERF; what is not there is left out, and said. Exit code 1 if a bar is missed.

Each side has a processor of its own (`taskset`), as two devices have: where the scheduler is free to, it puts two programs that wake each
other on one processor, and then a blocking pair takes 18 us where 155 us are needed to wake another (measured). sockperf spins between two
messages, so its caches are warm and its sending core awake; ddsperf prints half of a round trip, which is doubled here.

`--awake` keeps every core awake for all programs alike, by processes that run only where nothing else wants to: what is left of a ratio is
what the programs do, and not how deep the cores of this machine sleep, on a virtual one whatever its host does then.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dds_trace.recorder.backends.cyclone_settings import cyclone_loopback, cyclone_settings
from dds_trace.recorder.choices import Discovery
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.reading.reader import read_trace

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

RECORD = Path(sys.executable).with_name("dds-record")
PLAIN = Path(__file__).with_name("plain_nodes.py")
SIZES_BYTES = (1_000, 33_000)
RATES_HZ = (100, 1_000)
WARM_UP_S = 0.5
PORT = 21_471
DOMAIN_ID = 71
LOCALHOST = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(DOMAIN_ID)}
CYCLONE = {
    "CYCLONEDDS_URI": ",".join(
        (cyclone_loopback(Discovery.LOCALHOST, {}), cyclone_settings(Discovery.LOCALHOST, tuned=False, environment={}))
    )
}


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


@contextmanager
def awake_cores() -> Iterator[None]:
    """Keep every core awake to the end of the block, by a process each that gives way to any other (sched(7), SCHED_IDLE).

    They end with this process, too, whatever ends it.
    """
    spin = (
        "import os; os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))\n"
        f"while os.getppid() == {os.getpid()}:\n for _ in range(1_000_000): pass"
    )
    with ExitStack() as started:
        for core in sorted(os.sched_getaffinity(0)):
            command = ["taskset", "--cpu-list", str(core), sys.executable, "-S", "-c", spin]
            process = started.enter_context(subprocess.Popen(command))
            started.callback(process.kill)
        yield


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
    """Return the median of the times behind the warm-up, in us."""
    return statistics.median(times_ns[load.warm_up :]) / 1e3


def ours(backend: str, data: str = "binary") -> Callable[[Load, Path], float]:
    """Return the contender that is `dds-record` on a backend."""

    def measure(load: Load, folder: Path) -> float:
        common = [RECORD, "--backend", backend, "--domain", DOMAIN_ID, "--discovery", "localhost", "--force"]
        trace = folder / f"{backend}.mcap"
        relay = [*common, "--role", "relay", "--out", folder / f"{backend}-relay.mcap"]
        ping = [*common, "--role", "ping", "--out", trace, "--data", data, "--size", load.size_bytes]
        ping += ["--rate", load.rate_hz, "--messages", load.messages, "--warmup", load.warm_up]
        with serving(relay, "serves domain"):
            output_of(ping)
        events = read_trace(trace).events
        sent, received = events[Stage.T1], events[Stage.T2]
        _, at, of = np.intersect1d(sent.sequence, received.sequence, return_indices=True)
        return median_us((received.monotonic_ns[of] - sent.monotonic_ns[at]).tolist(), load)

    return measure


def blocking_python(load: Load, _folder: Path) -> float:
    """Measure thirty lines of blocking sockets."""
    with serving([sys.executable, PLAIN, "socket-echo", PORT, load.size_bytes], "ready"):
        count = load.warm_up + load.messages
        ping = [sys.executable, PLAIN, "socket-ping", PORT, load.size_bytes, load.rate_hz, count]
        return median_us(json.loads(output_of(ping)), load)


def bare_rclpy(load: Load, _folder: Path) -> float:
    """Measure serialized messages through rclpy alone, on the middleware that ours chooses."""
    environment = {**LOCALHOST, "RMW_IMPLEMENTATION": os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")}
    with serving([sys.executable, PLAIN, "ros2-echo", load.size_bytes], "ready", environment):
        count = load.warm_up + load.messages
        ping = [sys.executable, PLAIN, "ros2-ping", load.size_bytes, load.rate_hz, count]
        return median_us(json.loads(output_of(ping, environment)), load)


def sockperf(load: Load, _folder: Path) -> float:
    """Measure sockperf over TCP; it has a warm-up of its own."""
    program = program_at("sockperf")
    common = ["--tcp", "-i", "127.0.0.1", "-p", PORT + 1, "-m", load.size_bytes]
    with serving([program, "server", *common], r"LISTEN|listen on"):
        time.sleep(0.3)  # it says so before it listens
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
    """Our node on one backend beside another program.

    Attributes:
        backend: that of ours.
        data: data type that ours sends.
        name: the other program, and what it needs on this machine.
        measure: measures the other program's median RTT in us.
        bar: largest good ratio of ours to theirs; None where it is only stated.
    """

    backend: str
    data: str
    name: str
    measure: Callable[[Load, Path], float]
    bar: float | None
    needs: str | None = None


CONTESTS = (
    Contest("socket", "binary", "blocking Python", blocking_python, 1.2),
    Contest("socket", "binary", "sockperf", sockperf, 1.3, "sockperf"),
    Contest("cyclonedds", "binary", "ddsperf waitset", ddsperf, 1.25, "ddsperf"),
    Contest("ros2", "string", "bare rclpy", bare_rclpy, None),
)


@dataclass(frozen=True, slots=True)
class Result:
    """The ratio of one contest under one load; times are medians over the rounds of the median RTT, in us."""

    backend: str
    against: str
    size_bytes: int
    rate_hz: int
    ours_us: float
    theirs_us: float
    ratio: float
    ratios: tuple[float, ...]
    bar: float | None

    @property
    def holds(self) -> bool:
        """Whether the ratio is good enough."""
        return self.bar is None or self.ratio <= self.bar


def measure_load(contests: Sequence[Contest], load: Load, rounds: int, folder: Path) -> list[Result]:
    """Measure every program once a round, each of ours once for all that it is compared with."""
    own: dict[str, list[float]] = {contest.backend: [] for contest in contests}
    other: dict[str, list[float]] = {contest.name: [] for contest in contests}
    for _ in range(rounds):
        for backend, data in dict.fromkeys((contest.backend, contest.data) for contest in contests):
            own[backend].append(ours(backend, data)(load, folder))
            for contest in contests:
                if contest.backend == backend:
                    other[contest.name].append(contest.measure(load, folder))
    found = []
    for contest in contests:
        ratios = [mine / theirs for mine, theirs in zip(own[contest.backend], other[contest.name], strict=True)]
        found.append(
            Result(
                contest.backend,
                contest.name,
                load.size_bytes,
                load.rate_hz,
                round(statistics.median(own[contest.backend]), 1),
                round(statistics.median(other[contest.name]), 1),
                round(statistics.median(ratios), 3),
                tuple(round(ratio, 3) for ratio in ratios),
                contest.bar,
            )
        )
    return found


def main() -> int:
    """Print the table; the exit code says whether every bar holds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=2, help="of each program and load, warm-up not included")
    parser.add_argument("--backend", action="append", choices=sorted({each.backend for each in CONTESTS}))
    parser.add_argument("--size", type=int, action="append", help=f"bytes (default: {SIZES_BYTES})")
    parser.add_argument("--rate", type=int, action="append", help=f"messages a second (default: {RATES_HZ})")
    parser.add_argument(
        "--unpinned", action="store_true", help="let the scheduler put both sides on one processor, where it likes to"
    )
    parser.add_argument(
        "--awake", action="store_true", help="keep every core awake, as a robot's are not: for all programs alike"
    )
    parser.add_argument("--json", action="store_true")
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
        for rate_hz in options.rate or RATES_HZ:
            for size_bytes in options.size or SIZES_BYTES:
                load = Load(size_bytes, rate_hz, options.seconds)
                for result in measure_load(contests, load, options.rounds, Path(folder)):
                    results.append(result)
                    bar = "stated" if result.bar is None else f"<= {result.bar}"
                    missed = "" if result.holds else "  MISSED"
                    if not options.json:
                        print(
                            f"{result.backend:11}{result.against:16}{size_bytes:>7} B{rate_hz:>6} Hz"
                            f"{result.ours_us:>9.0f} us{result.theirs_us:>9.0f} us{result.ratio:>7.2f}  {bar}{missed}",
                            flush=True,
                        )
    if options.json:
        print(json.dumps([asdict(result) for result in results], indent=2))
    return 0 if all(result.holds for result in results) else 1


if __name__ == "__main__":
    sys.exit(main())
