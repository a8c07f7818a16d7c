"""What each command costs before it does anything: `--help`, an analysis of the smallest sample, a dry run of 5,000 results.

    python benchmarks/bench_startup.py             fifteen rounds: about a minute
    python benchmarks/bench_startup.py --rounds 5
    python benchmarks/bench_startup.py --against DIR --csv benchmarks/speed.csv    the analysis of the checkout in DIR, too

Every round starts each command once, one after the other, beside `python -c pass`; a row has the median of its wall and
CPU time, and the median ratio of its wall time to that of the bare interpreter in the same round. Bytecode is at hand, as pip leaves
it (`PYTHONPYCACHEPREFIX`, filled by a first round): where `PYTHONDONTWRITEBYTECODE` is set and nothing was compiled, each
start compiles all libraries anew and takes about twice as long. The exit code is 1 if a bar is missed.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter

from commands import SpeedRow, keep_row, run_command

BIN = Path(sys.executable).parent
SAMPLE = Path(__file__).parents[1] / "sample_traces" / "losses"
HELP_S, ANALYSIS_S, DRY_RUN_S = 0.2, 0.8, 5.0
BARE = "python -c pass"
ANALYSIS = "dds-analyze sample_traces/losses"
BEFORE = f"{ANALYSIS}, before"
DRY_RUN = "sweep --dry-run of 5,000 results"
PLAN = f"""
[axes]
backend = "socket"
size = {[*range(1000, 11_000, 1000)]}
rate = {[*range(10, 110, 10)]}
depth = {[*range(1, 11)]}
buffer = {[*range(100_000, 600_000, 100_000)]}
"""


@dataclass(frozen=True, slots=True)
class Startup:
    """Medians of one command.

    Attributes:
        times_bare: median over rounds of its wall time over that of the bare interpreter.
        bar_s: most wall time; None for what is only compared with.
    """

    command: str
    wall_s: float
    cpu_s: float
    times_bare: float
    bar_s: float | None

    @property
    def passed(self) -> bool:
        """Whether the median is within the bar."""
        return self.bar_s is None or self.wall_s <= self.bar_s


def commands(folder: Path, against: Path | None) -> dict[str, tuple[list[str], float | None]]:
    """Return name -> (arguments, most seconds) of everything that is started."""
    subcommands = [
        "dds-record",
        "dds-analyze",
        *(f"dds-trace {name}" for name in ("record ping", "sweep", "bridge", "compare", "watch")),
    ]
    plan = folder / "large.toml"
    plan.write_text(PLAN)
    return {
        BARE: ([sys.executable, "-c", "pass"], None),
        "import numpy, polars, pyarrow": ([sys.executable, "-c", "import numpy, polars, pyarrow.parquet"], None),
        **{
            f"{name} --help": ([str(BIN / name.split()[0]), *name.split()[1:], "--help"], HELP_S)
            for name in subcommands
        },
        ANALYSIS: (analysis_of(SAMPLE.parents[1], folder), ANALYSIS_S),
        **({BEFORE: (analysis_of(against, folder), None)} if against else {}),
        DRY_RUN: ([str(BIN / "dds-trace"), "sweep", str(plan), "--dry-run", "--out", str(folder)], DRY_RUN_S),
    }


def analysis_of(checkout: Path, folder: Path) -> list[str]:
    """Return the arguments of an analysis of the smallest sample by a checkout."""
    code = (
        f"import runpy, sys; sys.path.insert(0, {str(checkout / 'src')!r}); sys.argv.insert(1, 'analyze'); "
        "runpy.run_module('dds_trace', run_name='__main__')"
    )
    return [sys.executable, "-c", code, str(SAMPLE), "--out", str(folder / "out")]


def time_start(arguments: list[str], environment: dict[str, str]) -> tuple[float, float]:
    """Run a command to its end; return its wall and CPU seconds."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = perf_counter()
    subprocess.run(arguments, env=environment, check=True, capture_output=True)
    wall_s = perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall_s, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measure(rounds: int, against: Path | None) -> list[Startup]:
    """Start every command in turn, so many rounds, and return the medians."""
    with tempfile.TemporaryDirectory(prefix="bench-startup-") as name:
        started = commands(Path(name), against)
        environment = {**os.environ, "PYTHONPYCACHEPREFIX": str(Path(name) / "bytecode")}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        times: dict[str, list[tuple[float, float]]] = {command: [] for command in started}
        for turn in range(rounds + 1):
            for command, (arguments, _) in started.items():
                taken = time_start(arguments, environment)
                if turn:  # the first round compiles
                    times[command].append(taken)
    return [
        Startup(
            command,
            statistics.median(wall for wall, _ in times[command]),
            statistics.median(cpu for _, cpu in times[command]),
            statistics.median(wall / bare for (wall, _), (bare, _) in zip(times[command], times[BARE], strict=True)),
            most_s,
        )
        for command, (_, most_s) in started.items()
    ]


def main() -> int:
    """Measure, print, and say by the exit code whether every bar is passed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--against", type=Path, metavar="DIR", help="a checkout whose analysis is measured in turn")
    parser.add_argument("--json", action="store_true", help="print JSON in place of the table")
    parser.add_argument("--csv", type=Path, help="keep the row of the analysis there, for `python scripts/quoted.py`")
    options = parser.parse_args()
    startups = measure(options.rounds, options.against)
    by_name = {startup.command: startup for startup in startups}
    if options.csv and BEFORE in by_name:
        with tempfile.TemporaryDirectory(prefix="bench-startup-") as name:
            peak_mb = run_command(analysis_of(SAMPLE.parents[1], Path(name)), {}).peak_bytes / 1e6
        cpu_s, before_s = (by_name[command].cpu_s for command in (ANALYSIS, BEFORE))
        row = "`analyze` of a small folder (`sample_traces/losses`)"
        keep_row(options.csv, SpeedRow(row, cpu_s, peak_mb, "", None, cpu_s / before_s, "over_before=0.6"))
    if options.json:
        print(json.dumps([{**asdict(startup), "passed": startup.passed} for startup in startups], indent=1))
    else:
        print(f"{'command':36}{'wall':>9}{'CPU':>9}{'x python':>10}  bar; load average {os.getloadavg()[0]:.1f}")
        for startup in startups:
            bar = "" if startup.bar_s is None else f"<= {startup.bar_s * 1e3:.0f} ms"
            print(
                f"{startup.command:36}{startup.wall_s * 1e3:6.0f} ms{startup.cpu_s * 1e3:6.0f} ms"
                f"{startup.times_bare:10.1f}  {bar}{'' if startup.passed else '  MISSED'}"
            )
    return 0 if all(startup.passed for startup in startups) else 1


if __name__ == "__main__":
    sys.exit(main())
