"""From traces to `roundtrips.parquet` and `summary.parquet`, against decompressing plus writing; and its memory.

    python benchmarks/bench_analyze.py               2 M events, 50 runs: a quick look, not held against the bar
    python benchmarks/bench_analyze.py --full        20 M events, 500 runs: what the bar is for
    python benchmarks/bench_analyze.py --files 200   200 files of 1 M events too: peak memory, all runs one group

What is on either side of the ratio, in wall time; both are taken in turn, and the median of the rounds' ratios counts:

- ours is a whole `analyze(details=False)`, from a folder to `roundtrips.parquet` and `summary.parquet`: finding and reading
  the files (in the page cache), checking CRCs, unpacking, pairing, statistics, findings, encoding and writing, on as many
  cores as it likes;
- the other is what nobody can leave out, on one thread: unpacking every chunk with one zstandard context (they are in
  memory already, no CRC is checked), and then writing the same rows, which are an Arrow table in memory already, texts as
  dictionaries, through the very writer of the analysis. That the two files hold the same and are of one size is checked.

Memory for the events is at hand when the analysis begins (`timing.WarmMemory`). The exit code is 1 if a bar is missed.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

import pyarrow.parquet as pq
import zstandard
from event_traces import write_event_trace
from timing import WarmMemory, packed_chunks, seconds, unpack_job

from dds_trace.analyzer import analyze
from dds_trace.analyzer.pairing.parquet import roundtrips_writer
from dds_trace.tracefile import EVENT_DTYPE

EVENTS, RUNS, REPEATS = 2_000_000, 50, 7
FULL_EVENTS, FULL_RUNS, FULL_REPEATS = 20_000_000, 500, 7
EVENTS_OF_FILE = 1_000_000
MOST_TIMES_UNPACK_AND_WRITE = 1.8
MOST_RSS_BYTES = 4e9

ANALYZE_AND_TELL = """
import json, re, sys
from pathlib import Path
from dds_trace.analyzer import analyze
analysis = analyze(sys.argv[1], out=sys.argv[2], details=False)
peak = re.search("VmHWM: *([0-9]+) kB", Path("/proc/self/status").read_text().replace("\\t", " "))
print(json.dumps([int(peak[1]) * 1024, int(analysis.summary["published"].sum())]))
"""


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


def write_campaign(folder: Path, events: int, runs: int, *, pairs: int = 4, groups: int) -> list[Path]:
    """Traces of `pairs` pings and as many relays, `events` in all."""
    folder.mkdir()
    of_file = events // pairs // 2
    return [
        write_event_trace(
            folder / f"{'relay' if relay else 'ping'}{pair}.mcap",
            of_file,
            "zstd",
            runs=runs // pairs,
            seed=1 + 2 * pair + relay,
            relay=relay,
            first_run=pair * 10_000,
            groups=groups,
        )
        for pair in range(pairs)
        for relay in (False, True)
    ]


def time_bars(folder: Path, events: int, runs: int, repeats: int) -> list[Bar]:
    """Analyzing against unpacking and writing, and how many cores took part."""
    traces = write_campaign(folder / "runs", events, runs, groups=runs)
    out = folder / "out"
    outputs = analyze(folder / "runs", out=out, details=False).outputs
    names = pq.read_schema(outputs["roundtrips"])
    texts = [field.name for field in names if field.type == "string"]
    table = pq.read_table(outputs["roundtrips"], read_dictionary=texts)

    def write() -> None:
        with roundtrips_writer(folder / "again.parquet") as write_table:
            write_table(table)

    write()
    sizes = [path.stat().st_size for path in (outputs["roundtrips"], folder / "again.parquet")]
    if not pq.read_table(folder / "again.parquet", read_dictionary=texts).equals(table):
        raise SystemExit("the other side writes something else")
    if abs(sizes[0] - sizes[1]) > 0.02 * sizes[0]:
        raise SystemExit(f"the analysis writes {sizes[0]} bytes, the other side {sizes[1]}")
    chunks = [chunk for path in traces for chunk in packed_chunks(path)]
    decompress = zstandard.ZstdDecompressor().decompress
    unpack_all = unpack_job(chunks, lambda packed, size: decompress(packed, max_output_size=size))
    warm = WarmMemory(events * EVENT_DTYPE.itemsize)
    ours, unpacking, writing, cores = [], [], [], []
    for _ in range(repeats):
        before = os.times()
        ours.append(warm.seconds(lambda: analyze(folder / "runs", out=out, details=False)))
        after = os.times()
        cores.append((after.user + after.system - before.user - before.system) / ours[-1])
        unpacking.append(seconds(unpack_all))
        writing.append(seconds(write))
    print(
        f"{events} events, {runs} runs, {len(traces)} files: analyze {median(ours):.2f} s, unpacking alone "
        f"{median(unpacking):.2f} s, writing alone {median(writing):.2f} s ({sizes[0] / 1e6:.1f} MB); "
        f"{median(cores):.2f} of {os.cpu_count()} cores used",
        file=sys.stderr,
    )
    ratios = [
        all_of_it / (one + other) for all_of_it, one, other in zip(ours, unpacking, writing, strict=True)
    ]
    print(f"ratios of the rounds: {', '.join(f'{ratio:.2f}' for ratio in sorted(ratios))}", file=sys.stderr)
    bar = MOST_TIMES_UNPACK_AND_WRITE if events >= FULL_EVENTS else math.inf
    return [Bar(f"{events} events: times unpacking and writing", median(ratios), bar)]


def memory_bar(folder: Path, files: int) -> Bar:
    """Peak memory of a process that analyzes many files; all their runs are one group, the hardest case."""
    write_campaign(folder / "many", files * EVENTS_OF_FILE, files * 5, pairs=files // 2, groups=1)
    said = subprocess.run(
        [sys.executable, "-c", ANALYZE_AND_TELL, str(folder / "many"), str(folder / "out_of_many")],
        check=True,
        capture_output=True,
    )
    peak_bytes, published = json.loads(said.stdout)
    print(f"{files} files of {EVENTS_OF_FILE} events: {published} messages", file=sys.stderr)
    return Bar(f"{files} files of 1 M events: peak RSS, GB", peak_bytes / 1e9, MOST_RSS_BYTES / 1e9)


def main() -> int:
    """Measure, print, and say by the exit code whether every bar is passed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--full", action="store_true", help="20 M events and 500 runs")
    parser.add_argument("--files", type=int, default=0, help="check memory with so many files of 1 M events")
    parser.add_argument("--json", action="store_true", help="print JSON in place of the table")
    options = parser.parse_args()
    size = (FULL_EVENTS, FULL_RUNS, FULL_REPEATS) if options.full else (EVENTS, RUNS, REPEATS)
    with tempfile.TemporaryDirectory(prefix="bench-analyze-") as name:
        bars = time_bars(Path(name), *size)
        if options.files:
            bars.append(memory_bar(Path(name), options.files))
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
            held = f"<= {bar.bar:g}" if math.isfinite(bar.bar) else "(the bar is for --full)"
            print(f"{bar.name:48}{bar.value:8.2f}  {held}{'' if bar.passed else '  MISSED'}")
    return 0 if all(bar.passed for bar in bars) else 1


if __name__ == "__main__":
    sys.exit(main())
