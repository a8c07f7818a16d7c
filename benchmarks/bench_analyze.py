"""What a user waits for who types `dds-trace analyze FOLDER --report json`, against unpacking the traces and writing the rows.

    python benchmarks/bench_analyze.py            the campaigns at a tenth of their size: a quick look, held against no bar
    python benchmarks/bench_analyze.py --full     at full size, which the bars are for
    python benchmarks/bench_analyze.py --full --against DIR    in turn with the checkout in DIR, without its cache (`--csv`: `just bench-speed DIR`)
    python benchmarks/bench_analyze.py --huge     peak memory of 200 M events in 200 files, too
    python benchmarks/bench_analyze.py --growth   500 runs in 1,000 files and 10,000 groups, and a quarter and a sixteenth of each

The campaigns are `campaigns.SHAPES`.

- *analysis* is the whole command as a process of its own, from its start to its end: memory that nobody has touched yet, reading
  (files in the page cache), details, findings, rows and report.
- *floor* is what nobody can leave out, on one thread: unpacking every chunk with one zstandard context (they are in memory
  already, no CRC is checked), and writing the same rows, an Arrow table in memory, by the very encoder of the analysis. For its
  ratio, what the command takes for a campaign of four messages, its start-up, is taken off.
- *peak* is memory, of several processes of their sum, looked at 20 times a second (what they share counts once).

All are taken in turn, round after round, and the median of the rounds' ratios counts. The exit code is 1 if a bar is missed.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import shutil
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

import numpy as np
import zstandard
from campaigns import MANY_GROUPS, SHAPES, SHORT_RUNS, Shape, write_campaign
from commands import Ran, SpeedRow, keep_row, run_command
from timing import packed_chunks, read_rows, seconds, unpack_job

from dds_trace.analyzer.clocks.fit import RelayedMessages, fit_clocks
from dds_trace.analyzer.pairing.parquet import roundtrips_writer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

HERE = Path(__file__).parents[1]
ROUNDS = 3
QUICK_PART = 0.1
MOST_TIMES_FLOOR = {"study": 3.0, "one_run": 2.5}
MOST_TIMES_BEFORE = 1.15
ASKED = {
    "study": "over_peer=1.8 over_before=0.5 peak_mb=450",
    "one_run": "over_peer=1.5 peak_mb=900",
    "two_files": "over_before=0.4",
    "short_runs": "over_before=0.5",
}
"""Against 413bda57 and the floor, by campaign."""
MOST_BYTES = {"one_run": 2e9, "short_runs": 1.4e9}
MOST_BYTES_OF_OTHERS, MOST_BYTES_OF_HUGE = 1e9, 3e9
MOST_CLOCK_MS = 15.0
MOST_TIMES_LINEAR = 1.25
HUGE = Shape("200 M events in 200 files", 200_000_000, runs=1_000, pairs=100, groups=200, rate_hz=1_000)
TINY = Shape("tiny", 16, runs=1, pairs=1, groups=1, rate_hz=10)
GROWTH = (1, 4, 16)
CLOCK_ROUNDS = 9


@dataclass(frozen=True, slots=True)
class Bar:
    """One figure and the most that it may be."""

    name: str
    value: float
    bar: float

    @property
    def passed(self) -> bool:
        """Whether it is no more than that."""
        return self.value <= self.bar


def analyze(folder: Path, out: Path, checkout: Path = HERE) -> Ran:
    """Run `dds-trace analyze FOLDER --report json` of a checkout, without its cache if it has one.

    Raises:
        SystemExit: the command fails.
    """
    command = [
        sys.executable,
        "-m",
        "dds_trace",
        "analyze",
        os.fspath(folder),
        "--report",
        "json",
        "--out",
        os.fspath(out),
    ]
    if "--no-cache" in (checkout / "cli" / "analyze.py").read_text():
        command.append("--no-cache")
    return run_command(command, {"PYTHONPATH": os.fspath(checkout / "src")})


def floor_job(traces: Sequence[Path], rows: Path, again: Path) -> Callable[[], None]:
    """Return the job that unpacks the traces and writes the rows of `rows` once more.

    Raises:
        SystemExit: what it writes is not the same, or not of the same size.
    """
    table = read_rows(rows)
    chunks = [chunk for path in traces for chunk in packed_chunks(path)]
    decompress = zstandard.ZstdDecompressor().decompress
    unpack_all = unpack_job(chunks, lambda packed, size: decompress(packed, max_output_size=size))

    def write() -> None:
        with roundtrips_writer(again) as write_table:
            write_table(table)

    write()
    sizes = [path.stat().st_size for path in (rows, again)]
    if not read_rows(again).equals(table):
        raise SystemExit("the other side writes something else")
    if abs(sizes[0] - sizes[1]) > 0.05 * sizes[0]:
        raise SystemExit(f"the analysis writes {sizes[0]} bytes, the other side {sizes[1]}")

    def unpack_and_write() -> None:
        unpack_all()
        write()

    return unpack_and_write


def time_shape(
    folder: Path, key: str, shape: Shape, rounds: int, against: Path | None, stored: Path | None, *, is_full: bool
) -> Iterator[Bar]:
    """Yield the figures of one campaign; bars hold at full size only."""
    traces = write_campaign(folder / "runs", shape)
    write_campaign(folder / "tiny", TINY)
    floors, over_before, cpu_over_before, peaks = [], [], [], []
    job: Callable[[], None] | None = None
    for _ in range(rounds):
        start_up_s = min(analyze(folder / "tiny", folder / "tiny_out").wall_s for _ in range(2))
        before = None if against is None else analyze(folder / "runs", folder / "before", against)
        ran = analyze(folder / "runs", folder / "out")
        if job is None:
            job = floor_job(traces, folder / "out" / "roundtrips.parquet", folder / "again.parquet")
        floor_s = seconds(job)
        floors.append((ran.wall_s - start_up_s) / floor_s)
        peaks.append(ran.peak_bytes / 1e9)
        of_before = ""
        if before is not None:
            over_before.append(ran.wall_s / before.wall_s)
            cpu_over_before.append(ran.cpu_s / before.cpu_s)
            of_before = (
                f"before {before.wall_s:.2f} s, {before.cpu_s:.2f} s of a core, {before.peak_bytes / 1e9:.2f} GB; "
            )
        print(
            f"{shape.name}, {shape.events} events: {of_before}analysis {ran.wall_s:.2f} s (start-up {start_up_s:.2f} s), "
            f"{ran.cpu_s:.2f} s of a core, {ran.peak_bytes / 1e9:.2f} GB; floor {floor_s:.2f} s",
            file=sys.stderr,
        )

    def bar(most: float) -> float:
        return most if is_full else math.inf

    if key in ASKED and is_full:
        name = f"`analyze`, {shape.name}: {shape.events:,} events"
        peer = ("the floor, wall time", median(floors)) if "over_peer" in ASKED[key] else ("", None)
        before_ratio = median(cpu_over_before) if cpu_over_before else None
        keep_row(stored, SpeedRow(name, ran.cpu_s, max(peaks) * 1e3, *peer, before_ratio, ASKED[key]))
    yield Bar(f"{shape.name}: times the floor", median(floors), bar(MOST_TIMES_FLOOR.get(key, math.inf)))
    if over_before:
        yield Bar(f"{shape.name}: times before", median(over_before), bar(MOST_TIMES_BEFORE))
        yield Bar(f"{shape.name}: processor times before", median(cpu_over_before), bar(MOST_TIMES_BEFORE))
    yield Bar(f"{shape.name}: peak, GB", max(peaks), bar(MOST_BYTES.get(key, MOST_BYTES_OF_OTHERS) / 1e9))


def clock_bar(*, is_full: bool) -> Bar:
    """Return what the clocks of one hour at 100 Hz take, in four runs with drift and exponential delays."""
    random = np.random.default_rng(0)
    count = 3600 * 100 // 4
    runs = []
    for number in range(4):
        publish_ns = number * 1_000_000_000_000 + np.arange(count, dtype=np.int64) * 10_000_000
        there, back = (100_000 + random.exponential(200_000, count).astype(np.int64) for _ in range(2))
        relay_in_ns = publish_ns + there
        ahead_ns = 5_000_000 + relay_in_ns * 2 // 1_000_000
        runs.append(
            RelayedMessages(
                publish_ns, relay_in_ns + ahead_ns, relay_in_ns + ahead_ns + 100_000, relay_in_ns + 100_000 + back
            )
        )
    taken_s = [seconds(lambda: fit_clocks(runs)) for _ in range(CLOCK_ROUNDS)]
    return Bar("clocks of an hour at 100 Hz, ms", median(taken_s) * 1e3, MOST_CLOCK_MS if is_full else math.inf)


def growth_bars(folder: Path) -> list[Bar]:
    """Return how much more processor time 16 times as many runs, or groups, take than 16 times one part."""
    write_campaign(folder / "tiny", TINY)
    bars = []
    for shape in (SHORT_RUNS.times(1 / 4), MANY_GROUPS):
        part = shape.times(1 / GROWTH[-1])
        times = []
        for factor in GROWTH:
            write_campaign(folder / "runs", part.times(factor))
            start_up = analyze(folder / "tiny", folder / "tiny_out").cpu_s
            times.append(analyze(folder / "runs", folder / "out").cpu_s - start_up)
            shutil.rmtree(folder / "runs")
            grown = part.times(factor)
            print(
                f"{factor}x: {grown.runs} runs, {2 * grown.pairs} files, {grown.groups} groups: {times[-1]:.2f} s of a core",
                file=sys.stderr,
            )
        linear = times[-1] / times[0] / GROWTH[-1]
        bars.append(Bar(f"{shape.groups} groups of {shape.runs} runs: 16x over 16 times 1x", linear, MOST_TIMES_LINEAR))
    return bars


def huge_bar(folder: Path) -> Bar:
    """Return the peak memory of 200 M events."""
    write_campaign(folder / "runs", HUGE)
    ran = analyze(folder / "runs", folder / "out")
    print(f"{HUGE.name}: {ran.wall_s:.0f} s, {ran.cpu_s / ran.wall_s:.2f} of {os.cpu_count()} cores", file=sys.stderr)
    return Bar(f"{HUGE.name}: peak, GB", ran.peak_bytes / 1e9, MOST_BYTES_OF_HUGE / 1e9)


def main() -> int:
    """Measure, print, and say by the exit code whether every bar is passed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true", help="campaigns of full size")
    parser.add_argument("--against", type=Path, metavar="DIR", help="a checkout to measure in turn with this one")
    parser.add_argument("--only", choices=SHAPES, help="one of the campaigns")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="rounds of each campaign")
    parser.add_argument("--huge", action="store_true", help="check memory with 200 M events, too")
    parser.add_argument("--growth", action="store_true", help="show the growth with runs and groups instead")
    parser.add_argument("--json", action="store_true", help="print JSON in place of the table")
    parser.add_argument("--csv", type=Path, help="keep the rows of full size there, for `python scripts/quoted.py`")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="bench-analyze-") as name:
        if options.growth:
            bars = growth_bars(Path(name))
        else:
            bars = [clock_bar(is_full=options.full)]
            for key in [options.only] if options.only else SHAPES:
                shape = SHAPES[key] if options.full else SHAPES[key].times(QUICK_PART)
                folder, others = Path(name) / key, (options.rounds, options.against, options.csv)
                bars += time_shape(folder, key, shape, *others, is_full=options.full)
                shutil.rmtree(Path(name) / key)
            if options.huge:
                bars.append(huge_bar(Path(name) / "huge"))
    if options.json:
        print(
            json.dumps(
                [
                    {**asdict(bar), "bar": bar.bar if math.isfinite(bar.bar) else None, "passed": bar.passed}
                    for bar in bars
                ],
                indent=1,
            )
        )
    else:
        for bar in bars:
            held = f"<= {bar.bar:g}" if math.isfinite(bar.bar) else ""
            print(f"{bar.name:60}{bar.value:8.2f}  {held}{'' if bar.passed else '  MISSED'}")
    return 0 if all(bar.passed for bar in bars) else 1


if __name__ == "__main__":
    sys.exit(main())
