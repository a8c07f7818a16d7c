"""Messages a second at `--rate max`: our nodes against ddsperf (`pub`, `sub`) and against iperf3.

    python benchmarks/bench_throughput.py [--rounds 5] [--seconds 3] [--awake] [--csv FILE]

In turn as in `bench_node.py`, each side on a processor of its own. Counted is what was received: by our relay from its first message to its
last one, by ddsperf and iperf3 in the seconds after the first. Both programs on Cyclone DDS are reliable and keep the last
ten messages, or all; both on TCP send without Nagle's delay. `client_bound` counts the rounds with the finding of this name.
"""

from __future__ import annotations

import argparse
import json
import re
import statistics
import sys
import tempfile
from collections import Counter
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from bench_node import (
    CYCLONE,
    DOMAIN_ID,
    PORT,
    Contest,
    Load,
    measure_load,
    output_of,
    print_result,
    program_at,
    record,
    serving,
    write_csv,
)
from timing import awake_cores

from dds_trace.analyzer.pipeline import analyze

if TYPE_CHECKING:
    from bench_node import Measure

SIZES_BYTES = (1_000, 100_000, 1_000_000)
KEEP_ALL = ("--history", "keep_all")
bound: Counter[tuple[str, int]] = Counter()
"""Backend with its further options, and size -> rounds with the finding `client_bound`."""


def ours(backend: str, *more: str) -> Measure:
    """Return what measures the time between two messages that our relay receives."""

    def measure(load: Load, folder: Path) -> float:
        of_ping = ["--size", load.size_bytes, "--rate", "max", "--duration", load.seconds]
        ping = record(backend, more, of_ping, folder)
        analysis = analyze([ping, Path(str(ping).replace("-ping", "-relay"))])
        bound[" ".join((backend, *more[1::2])), load.size_bytes] += any(
            finding.code == "client_bound" for finding in analysis.findings
        )
        return 1e6 / float(analysis.summary["reached_rate_hz"][0])

    return measure


def ddsperf(*history: str) -> Measure:
    """Return what measures ddsperf's subscriber; it prints the rate of each second, the first of which is left out."""

    def measure(load: Load, _folder: Path) -> float:
        common = [program_at("ddsperf"), "-i", DOMAIN_ID, *history, "-D"]
        with serving([*common, 60, "pub", "size", load.size_bytes], r"new \(self\)", CYCLONE):
            printed = output_of([*common, round(load.seconds) + 2, "sub"], CYCLONE)
        rates = [float(text) for text in re.findall(r"delta \d+ lost \d+ rate ([\d.]+) kS/s", printed)]
        return 1e3 / statistics.median(rates[1:])

    return measure


def iperf3(load: Load, _folder: Path) -> float:
    """Measure one stream of iperf3."""
    program = program_at("iperf3")
    place = ["-p", PORT + 4, "--forceflush"]
    with serving([program, "-s", "-1", "-B", "127.0.0.1", *place], "Server listening"):
        how = ["-l", load.size_bytes, "-N", "-t", round(load.seconds), "-O", 1, "--json"]
        received = json.loads(output_of([program, "-c", "127.0.0.1", *place, *how]))["end"]["sum_received"]
    return 1e6 * load.size_bytes * float(received["seconds"]) / float(received["bytes"])


CONTESTS = (
    Contest("cyclonedds", "ddsperf -k 10", ddsperf("-k", "10"), None, "ddsperf", own=ours("cyclonedds")),
    Contest("cyclonedds", "ddsperf", ddsperf(), None, "ddsperf", KEEP_ALL, own=ours("cyclonedds", *KEEP_ALL)),
    Contest("socket", "iperf3", iperf3, None, "iperf3", own=ours("socket")),
)


def main() -> int:
    """Print the rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=3, help="of each program and size")
    parser.add_argument("--awake", action="store_true", help="keep every core awake: for all programs alike")
    parser.add_argument("--csv", type=Path, help="write the results there, for `python scripts/quoted.py`")
    options = parser.parse_args()
    contests = [contest for contest in CONTESTS if contest.needs is None or program_at(contest.needs)]
    results = []
    waking = awake_cores() if options.awake else nullcontext()
    with waking, tempfile.TemporaryDirectory(prefix="dds-trace-bench-") as folder:
        for size_bytes in SIZES_BYTES:
            for result in measure_load(contests, Load(size_bytes, 0, options.seconds), options.rounds, Path(folder)):
                results.append(replace(result, client_bound=bound[result.ours, size_bytes]))
                print_result(results[-1])
            if options.csv and results:
                write_csv(results, options.csv)
    return 0


if __name__ == "__main__":
    sys.exit(main())
