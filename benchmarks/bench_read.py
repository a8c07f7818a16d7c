"""Reading a trace to columns, against the public readers, against unpacking alone, and in memory.

    python benchmarks/bench_read.py            1 M events, all bars: about five minutes
    python benchmarks/bench_read.py --large    20 M events too; the public readers' times are taken from 1 M times 20

Every bar is the median of the ratios of several rounds, in each of which both sides are timed one after the other. The
exit code is 1 if a bar is missed. Two threads on a machine whose cores are busy with other work cannot show what they
can do: the load average is printed for that. Nothing that is timed touches memory for the first time
(`timing.keep_freed_memory`), but for the row "first read", which has no bar: a new process, as a user's first analysis is one.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from time import perf_counter, sleep
from typing import TYPE_CHECKING, Any

import lz4.frame
import zstandard
from event_traces import write_event_trace
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from rosbags.rosbag2 import Reader as RosbagsReader
from timing import keep_freed_memory, packed_chunks, seconds, unpack_job

from dds_trace.tracefile.reading.reader import read_trace

if TYPE_CHECKING:
    from collections.abc import Callable

EVENTS, LARGE = 1_000_000, 20_000_000
WARM_PROCESSES = 3  # where the kernel has put a process's memory makes a fifth of the time
SAMPLING_S = 7.0  # of each: rounds against unpacking alone, which are short
LEAST_ROUNDS = 5
PUBLIC_ROUNDS = 3  # the public readers take seconds each
FIRST_ROUNDS = 3
GIVEN_BACK_S = 3.0  # after that a virtual machine has given freed memory back to its host
CODECS = ("zstd", "lz4", "")
UNPACKERS: dict[str, Callable[[bytes, int], bytes]] = {
    "zstd": lambda packed, size: zstandard.ZstdDecompressor().decompress(packed, max_output_size=size),
    "lz4": lambda packed, _size: lz4.frame.decompress(packed),
}
MOST_TIMES_UNPACKING = {"zstd": 1.15, "lz4": 1.5}
LEAST_TIMES_FASTER = {"make_reader": 50.0, "StreamReader": 20.0, "rosbags raw": 15.0}
MOST_RSS_ABOVE_RESULT = 100e6

# A process of its own, and the kernel's figure for it alone: `ru_maxrss` would begin with that of its parent.
READ_AND_TELL = """
import json, re, sys
from pathlib import Path
from dds_trace.tracefile.format.events import EVENT_DTYPE
from dds_trace.tracefile.reading.reader import read_trace
trace = read_trace(Path(sys.argv[1]))
peak = re.search("VmHWM: *([0-9]+) kB", Path("/proc/self/status").read_text().replace("\\t", " "))
print(json.dumps([int(peak[1]) * 1024, trace.event_count * EVENT_DTYPE.itemsize]))
"""


@dataclass(frozen=True, slots=True)
class Bar:
    """One figure with the bar it has to pass.

    Attributes:
        value: measured; a ratio, or MB.
        bar: the most it may be if `at_most`, else the least; None for a figure without a bar.
    """

    codec: str
    events: int
    name: str
    value: float
    bar: float | None
    at_most: bool

    @property
    def passed(self) -> bool:
        """Whether the value is on the right side of the bar."""
        if self.bar is None:
            return True
        return self.value <= self.bar if self.at_most else self.value >= self.bar


def read_with_make_reader(path: Path) -> int:
    """Messages that python mcap's reader hands out."""
    with path.open("rb") as stream:
        return sum(1 for _ in make_reader(stream).iter_messages())


def read_with_stream_reader(path: Path) -> int:
    """Count the records that python mcap's StreamReader yields."""
    with path.open("rb") as stream:
        return sum(1 for _ in StreamReader(stream).records)


def read_with_rosbags(path: Path) -> int:
    """Messages that rosbags hands out, not deserialized."""
    with RosbagsReader(path) as reader:
        return sum(1 for _ in reader.messages())


PUBLIC_READERS = {
    "make_reader": read_with_make_reader,
    "StreamReader": read_with_stream_reader,
    "rosbags raw": read_with_rosbags,
}


def side_by_side(
    path: Path, theirs: Callable[[], object], rounds: int, at_least_s: float = 0.0
) -> list[tuple[float, float]]:
    """Seconds of our reader and of theirs, timed in turn: at least so many rounds, over at least so long."""
    read_trace(path)  # touches the memory
    times: list[tuple[float, float]] = []
    until = perf_counter() + at_least_s
    while len(times) < rounds or perf_counter() < until:
        times.append((seconds(partial(read_trace, path)), seconds(theirs)))
    return times


def in_new_process(job: str, path: Path, codec: str) -> Any:
    """Return what a new process says of a file, told to do one thing by an option of this program."""
    command = [sys.executable, __file__, "--codec", codec, f"--{job}", str(path)]
    return json.loads(subprocess.run(command, check=True, capture_output=True).stdout)


def memory_bar(path: Path, codec: str, events: int) -> Bar:
    """Peak memory of a process that reads the trace, the result's size taken off, in MB."""
    said = subprocess.run([sys.executable, "-c", READ_AND_TELL, str(path)], check=True, capture_output=True)
    peak_bytes, result_bytes = json.loads(said.stdout)
    above = (peak_bytes - result_bytes) / 1e6
    return Bar(codec, events, "RSS above the result, MB", above, MOST_RSS_ABOVE_RESULT / 1e6, at_most=True)


def warm_rounds(path: Path, codec: str) -> list[tuple[float, float]]:
    """Seconds of this process to read a trace and to unpack it alone, round by round."""
    unpack = unpack_job(packed_chunks(path), UNPACKERS[codec])
    keep_freed_memory()  # from here on: what holds the packed chunks is in nobody's way
    unpack()
    return side_by_side(path, unpack, LEAST_ROUNDS, SAMPLING_S)


def first_read_ratio(path: Path, codec: str) -> float:
    """Return how many times as long as unpacking alone this process takes to read a trace, the first that it reads."""
    first_s = seconds(lambda: read_trace(path))
    return first_s / seconds(unpack_job(packed_chunks(path), UNPACKERS[codec]))


def first_read_bar(path: Path, codec: str, events: int) -> Bar:
    """Return the median over new processes, each begun when freed memory is no longer at hand."""
    ratios = []
    for _ in range(FIRST_ROUNDS):
        sleep(GIVEN_BACK_S)
        ratios.append(in_new_process("first-read", path, codec))
    name = "times unpacking alone, first read"
    return Bar(codec, events, name, statistics.median(ratios), None, at_most=True)


def bars_of(folder: Path, codec: str, events: int, public: dict[str, float]) -> list[Bar]:
    """All bars of one file; `public` keeps the public readers' times on `EVENTS` events for the larger ones."""
    path = write_event_trace(folder / f"{codec or 'none'}_{events}.mcap", events, codec)
    bars, ours_s, says = [], list[float](), list[str]()
    if codec in UNPACKERS:
        rounds = [of_round for _ in range(WARM_PROCESSES) for of_round in in_new_process("warm-read", path, codec)]
        ratio = statistics.median(ours / theirs for ours, theirs in rounds)
        bars.append(Bar(codec, events, "times unpacking alone", ratio, MOST_TIMES_UNPACKING[codec], at_most=True))
        bars.append(first_read_bar(path, codec, events))
        ours_s += [ours for ours, _ in rounds]
        says.append(f"unpacking alone {statistics.median(theirs for _, theirs in rounds):.3f} s")
    for name, read_publicly in PUBLIC_READERS.items():
        if events == EVENTS:
            rounds = side_by_side(path, partial(read_publicly, path), PUBLIC_ROUNDS)
            ratio = statistics.median(theirs / ours for ours, theirs in rounds)
            public[name] = statistics.median(theirs for _, theirs in rounds)
            ours_s += [ours for ours, _ in rounds]
        else:
            ours_s = ours_s or [ours for ours, _ in side_by_side(path, lambda: None, LEAST_ROUNDS)]
            ratio = events / EVENTS * public[name] / statistics.median(ours_s)
        bars.append(Bar(codec, events, f"times faster than {name}", ratio, LEAST_TIMES_FASTER[name], at_most=False))
        says.append(f"{name} {public[name] * events / EVENTS:.1f} s")
    median_s = statistics.median(ours_s)
    print(
        f"{codec or 'none':5} {events:>9} events: read_trace {median_s:.3f} s "
        f"({events / median_s / 1e6:.1f} M events/s), {', '.join(says)}; "
        f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores",
        file=sys.stderr,
    )
    bars.append(memory_bar(path, codec, events))
    path.unlink()
    return bars


def main() -> int:
    """Measure, print, and say by the exit code whether every bar is passed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--large", action="store_true", help="20 M events too")
    parser.add_argument("--codec", choices=["zstd", "lz4", "none"], help="only this one")
    parser.add_argument("--json", action="store_true", help="print JSON in place of the table")
    parser.add_argument("--first-read", type=Path, metavar="FILE", help="print this ratio of one file alone")
    parser.add_argument("--warm-read", type=Path, metavar="FILE", help="print the rounds of one file alone")
    options = parser.parse_args()
    if options.first_read:
        print(first_read_ratio(options.first_read, options.codec))
        return 0
    if options.warm_read:
        print(json.dumps(warm_rounds(options.warm_read, options.codec)))
        return 0
    keep_freed_memory()
    codecs = [codec for codec in CODECS if options.codec in {None, codec or "none"}]
    bars: list[Bar] = []
    with tempfile.TemporaryDirectory(prefix="bench-read-") as folder:
        for codec in codecs:
            public: dict[str, float] = {}
            for events in [EVENTS, LARGE] if options.large else [EVENTS]:
                bars += bars_of(Path(folder), codec, events, public)
    if options.json:
        print(json.dumps([{**asdict(bar), "passed": bar.passed} for bar in bars], indent=1))
    else:
        print(f"{'codec':6}{'events':>10}  {'figure':34}{'value':>8}  bar")
        for bar in bars:
            most = "" if bar.bar is None else f"{'<=' if bar.at_most else '>='} {bar.bar:g}"
            verdict = "" if bar.passed else "  MISSED"
            print(f"{bar.codec or 'none':6}{bar.events:>10}  {bar.name:34}{bar.value:8.2f}  {most}{verdict}")
    return 0 if all(bar.passed for bar in bars) else 1


if __name__ == "__main__":
    sys.exit(main())
