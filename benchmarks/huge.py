"""A billion events through `dds-trace analyze`: rate, memory, and the floor of unpacking and writing alone.

    python benchmarks/huge.py                          1,000 M events in files of 10 M: 35 GB of traces, removed at the end
    python benchmarks/huge.py --events 100000000       a tenth of it
    python benchmarks/huge.py --folder /mnt/large      where there is room

The traces are made first, on all cores (about half a minute a core for each file); the command then runs once, as a user
starts it, without the cache, its temporary files in the same folder. Before anything is made, one pair of files is analyzed to learn
how many bytes an event takes on the disk; without room for all of them, the benchmark ends and says how many fit.

The floor is what nobody can leave out, on one thread: unpacking every chunk and writing the same rows, measured on that one
pair and multiplied. The exit code is 1 if the rate, or the memory, misses its bar.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import pyarrow.parquet as pq
import zstandard
from commands import Ran, run_command
from event_traces import write_event_trace
from timing import packed_chunks, read_rows, seconds, unpack_job

from dds_trace.analyzer.pairing.parquet import roundtrips_writer

EVENTS, EVENTS_OF_FILE = 1_000_000_000, 10_000_000
RUNS_OF_FILE, GROUPS = 20, 50
PERIOD_NS = 1_000_000
LEAST_RATE_HZ = 1e9 / 300
"""Events a second: a billion in five minutes."""

MOST_RSS_BYTES = 4e9
"""Peak memory, whatever the number of events."""

STORED_BYTES = 30
"""Most bytes of an event in the temporary files of an analysis that does not fit into memory."""

SPARE = 1.1


@dataclass(frozen=True, slots=True)
class Floor:
    """What one pair of files costs.

    Attributes:
        unpack_s: unpacking its chunks on one thread, the files in memory.
        write_s: writing its rows, which are in memory.
        disk_bytes: traces, rows and temporary files together.
    """

    unpack_s: float
    write_s: float
    disk_bytes: int


def write_file(folder: Path, events: int, number: int) -> Path:
    """Write trace `number`: even numbers are pings, odd ones the relays of the ping before."""
    pair, is_relay = divmod(number, 2)
    return write_event_trace(
        folder / f"{'relay' if is_relay else 'ping'}{pair:04}.mcap",
        events,
        "zstd",
        runs=RUNS_OF_FILE,
        seed=1 + number,
        relay=bool(is_relay),
        first_run=pair * RUNS_OF_FILE,
        groups=GROUPS,
        period_ns=PERIOD_NS,
        first_ns=pair * (events // 2 + 1000) * PERIOD_NS,
    )


def analyze_folder(folder: Path, out: Path) -> Ran:
    """Run `dds-trace analyze` on a folder to its end.

    Raises:
        SystemExit: it failed.
    """
    program = str(Path(sys.executable).with_name("dds-analyze"))
    options = ["--out", str(out), "--report", "json"]
    return run_command([program, str(folder), *options], {"TMPDIR": str(out.parent)})


def measure_floor(folder: Path, events: int) -> Floor:
    """Write and analyze one pair of files, then unpack it and write its rows alone."""
    traces = [write_file(folder / "pair", events, number) for number in (0, 1)]
    analyze_folder(folder / "pair", folder / "pair_out")
    rows = folder / "pair_out" / "roundtrips.parquet"
    table = read_rows(rows)

    def write() -> None:
        with roundtrips_writer(folder / "again.parquet") as write_table:
            write_table(table)

    decompress = zstandard.ZstdDecompressor().decompress
    chunks = [chunk for trace in traces for chunk in packed_chunks(trace)]
    unpack = unpack_job(chunks, lambda packed, size: decompress(packed, max_output_size=size))
    unpack()
    write()
    files_bytes = sum(path.stat().st_size for path in (*traces, rows))
    return Floor(seconds(unpack), seconds(write), files_bytes + 2 * events * STORED_BYTES)


def main() -> int:
    """Make the traces, analyze them, print, and say by the exit code whether every bar is passed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--events", type=int, default=EVENTS)
    parser.add_argument("--events-of-file", type=int, default=EVENTS_OF_FILE, help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help="on a disk with room; a folder for temporary files if left out")
    parser.add_argument("--json", action="store_true", help="print JSON in place of the table")
    options = parser.parse_args()
    pairs = max(1, options.events // (2 * options.events_of_file))
    with tempfile.TemporaryDirectory(prefix="bench-huge-", dir=options.folder) as name:
        folder = Path(name)
        (folder / "runs").mkdir()
        (folder / "pair").mkdir()
        floor = measure_floor(folder, options.events_of_file)
        room_bytes = shutil.disk_usage(folder).free
        if pairs * floor.disk_bytes * SPARE > room_bytes:
            fits = int(room_bytes / floor.disk_bytes / SPARE) * 2 * options.events_of_file
            raise SystemExit(
                f"{folder.parent} has room for {fits / 1e6:.0f} M events ({room_bytes / 1e9:.0f} GB free); "
                "give --events or another --folder"
            )
        write = partial(write_file, folder / "runs", options.events_of_file)
        with ProcessPoolExecutor(len(os.sched_getaffinity(0))) as pool:
            traces = list(pool.map(write, range(2 * pairs)))
        traces_bytes = sum(trace.stat().st_size for trace in traces)
        analysis = analyze_folder(folder / "runs", folder / "out")
        rows = pq.read_metadata(folder / "out" / "roundtrips.parquet").num_rows
    events = 2 * pairs * options.events_of_file
    if rows != events // 4:
        raise SystemExit(f"{rows} rows of {events} events")
    floor_s = pairs * (floor.unpack_s + floor.write_s)
    rate_hz = events / analysis.wall_s
    passed = rate_hz >= LEAST_RATE_HZ and analysis.peak_bytes <= MOST_RSS_BYTES
    if options.json:
        figures = {"events": events, "traces_bytes": traces_bytes, "floor_s": floor_s, **asdict(analysis)}
        print(json.dumps({**figures, "rate_hz": rate_hz, "passed": passed}, indent=1))
    else:
        print(
            f"{events / 1e6:.0f} M events, {len(traces)} files, {traces_bytes / 1e9:.1f} GB: {analysis.wall_s:.1f} s, "
            f"{rate_hz / 1e6:.2f} M events/s (goal {LEAST_RATE_HZ / 1e6:.2f}), "
            f"{analysis.cpu_s / analysis.wall_s:.2f} of {os.cpu_count()} cores\n"
            f"floor on one thread: unpacking {pairs * floor.unpack_s:.1f} s, writing {pairs * floor.write_s:.1f} s; "
            f"{analysis.wall_s / floor_s:.2f} times that\n"
            f"peak RSS {analysis.peak_bytes / 1e9:.2f} GB (at most {MOST_RSS_BYTES / 1e9:.0f})"
            f"{'' if passed else '  MISSED'}"
        )
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
