"""An analysis by workers of Dask against the same analysis by this process: wall and CPU time, bytes compared.

    python benchmarks/cluster.py                     20 M events in 8 files; 1, 2 and 4 workers: about six minutes
    python benchmarks/cluster.py --workers 1 2 --rounds 5

Scheduler and workers run on this machine, each worker with one thread. Every round analyzes the same campaign here and then with
each number of workers; the figures are medians, and the ratios are taken within a round. Wherever the rows differ in one byte
from those of the local analysis, the benchmark ends with an error; where a bar is missed, the exit code is 1.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import threading
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from time import perf_counter, process_time
from typing import TYPE_CHECKING

import psutil
from campaigns import Shape, write_campaign

from dds_trace.analyzer.pipeline import analyze

if TYPE_CHECKING:
    from collections.abc import Iterator

CAMPAIGN = Shape("20 M events in 8 files", 20_000_000, runs=500, pairs=4, groups=500, rate_hz=1000)
SMALL = Shape("what is analyzed first", 80_000, runs=4, pairs=4, groups=4, rate_hz=1000)
ROUNDS = 3
WORKERS = (1, 2, 4)
ONE_THREAD = dict.fromkeys(("POLARS_MAX_THREADS", "OPENBLAS_NUM_THREADS"), "1")
"""Without it a worker of one thread computes on all cores: each library has threads of its own."""

LEAST_GAIN_OF_TWO = 1.6
MOST_TIMES_LOCAL = 1.2


@dataclass(frozen=True, slots=True)
class Timing:
    """One analysis.

    Attributes:
        here_s: CPU time of this process, which plans, merges and writes.
        others_s: CPU time of scheduler and workers together; 0 of a local analysis.
    """

    wall_s: float
    here_s: float
    others_s: float


@contextmanager
def dask_process(module: str, until: str, *arguments: str) -> Iterator[tuple[psutil.Process, str]]:
    """Run a process of Dask on loopback; yield it and the line that has `until` in it."""
    command = [sys.executable, "-m", module, *arguments, "--no-dashboard", "--host", "127.0.0.1"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=os.environ | ONE_THREAD)
    try:
        assert process.stderr is not None
        line = next(line for line in process.stderr if until in line)
        threading.Thread(target=process.stderr.read, daemon=True).start()
        yield psutil.Process(process.pid), line
    finally:
        process.kill()
        process.wait()


def time_analysis(runs: Path, out: Path, workers: int) -> Timing:
    """Analyze a folder with so many workers, started and warmed up before; 0 is this process alone."""
    with ExitStack() as started:
        processes, address = [], None
        if workers:
            scheduler, line = started.enter_context(
                dask_process("distributed.cli.dask_scheduler", "Scheduler at:", "--port", "0")
            )
            address = line.split()[-1]
            single = (address, "--no-nanny", "--nthreads", "1", "--local-directory", str(out.parent))
            joined = [
                started.enter_context(dask_process("distributed.cli.dask_worker", "Registered to:", *single))
                for _ in range(workers)
            ]
            processes = [scheduler, *(worker for worker, _ in joined)]
        analyze(runs.parent / "small", cluster=address)  # imports are not what is measured
        before = [sum(process.cpu_times()[:2]) for process in processes]
        here_s, start = process_time(), perf_counter()
        analyze(runs, out=out, cluster=address)
        wall_s, here_s = perf_counter() - start, process_time() - here_s
        after = [sum(process.cpu_times()[:2]) for process in processes]
        return Timing(wall_s, here_s, sum(after) - sum(before))


def main() -> int:
    """Measure, print, and say by the exit code whether every bar is passed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=float, default=1.0, help="size of the campaign, in 20 M events")
    parser.add_argument("--workers", type=int, nargs="+", default=WORKERS)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    options = parser.parse_args()
    sides = [0, *options.workers]
    timings: dict[int, list[Timing]] = {side: [] for side in sides}
    with tempfile.TemporaryDirectory(prefix="bench-cluster-") as name:
        folder = Path(name)
        write_campaign(folder / "runs", CAMPAIGN.times(options.times))
        write_campaign(folder / "small", SMALL)
        for _ in range(options.rounds):
            for side in sides:
                timings[side].append(time_analysis(folder / "runs", folder / f"out{side}", side))
            rows = {(folder / f"out{side}" / "roundtrips.parquet").read_bytes() for side in sides}
            if len(rows) > 1:
                raise SystemExit("the rows differ from those of the local analysis")
    print(f"{'workers':8}{'wall':>8}{'here':>8}{'others':>8}{'x local':>9}")
    times_local: dict[int, float] = {}
    for side, taken in timings.items():
        pairs = zip(taken, timings[0], strict=True)
        times_local[side] = median(timing.wall_s / local.wall_s for timing, local in pairs)
        print(
            f"{side or 'local':<8}{median(t.wall_s for t in taken):6.1f} s{median(t.here_s for t in taken):6.1f} s"
            f"{median(t.others_s for t in taken):6.1f} s{times_local[side]:9.2f}"
        )
    if not {1, 2} <= set(sides):
        return 0
    gain = times_local[1] / times_local[2]
    passed = gain >= LEAST_GAIN_OF_TWO and times_local[2] <= MOST_TIMES_LOCAL
    print(
        f"two workers {gain:.2f} times as fast as one (at least {LEAST_GAIN_OF_TWO}), "
        f"{times_local[2]:.2f} times the local analysis (at most {MOST_TIMES_LOCAL}){'' if passed else '  MISSED'}"
    )
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
