"""Make recordings of known truth, and count in how many `dds-trace bag` says that messages are missing.

Usage: bench_evidence.py [--seeds 200] [--kind NAME] [--csv FILE]. Harmless recordings lost nothing: at most 2 % may be said to. Of the others, with losses
that numbers, stamps or arrival alone can show, as many as possible. `just readme` writes the
tables of docs/explanation/evidence.md from docs/results/evidence.csv. Ends with 1 where a harmless kind has more.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from made_recordings import EVIDENCE, HARMLESS, LOSSES, Made, lossy

from dds_trace.extensions.bags.losses import TopicTimes
from dds_trace.extensions.bags.weighing import Source, weigh

MOST_FALSE = 0.02


def says_missing(made: Made) -> tuple[bool, bool]:
    """Return whether messages are said to be missing (exit code 30), and whether the true number is within the interval."""
    columns = [*made.columns()]
    times = [TopicTimes(*arrays, is_command=is_command) for _, is_command, arrays in columns]
    logged = np.sort(np.concatenate([one.log_ns for one in times]))
    found = weigh(times, [Source(name) for name, _, _ in columns], logged).losses
    low, high = (sum(getattr(loss, end) or 0 for loss in found) for end in ("low", "high"))
    return low > 0, low <= made.lost <= high


def count(kind: str, evidence: str, seeds: Sequence[int]) -> tuple[int, int]:
    """Return how many recordings of a kind exit with 30, and how many intervals contain the truth; `evidence` is of losses."""
    generators = map(np.random.default_rng, seeds)
    made = (lossy(rng, kind, evidence) if evidence else HARMLESS[kind](rng) for rng in generators)
    exit_30, within = zip(*map(says_missing, made), strict=True)
    return sum(exit_30), sum(within)


def rows_of(part: str, seeds: Sequence[int]) -> Iterator[dict[str, object]]:
    """Yield a row for each kind with `part` in its name."""
    kinds = [("harmless", kind, "") for kind in HARMLESS]
    kinds += [("losses", kind, evidence) for kind in LOSSES for evidence in EVIDENCE]
    for table, kind, evidence in kinds:
        if part in kind:
            exit_30, within = count(kind, evidence, seeds)
            counts = {"recordings": len(seeds), "exit_30": exit_30, "within": within}
            yield {"table": table, "kind": kind, "shown_by": evidence, **counts}


def main() -> int:
    """Print both tables, and write their rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--kind", default="", help="only kinds with this in their name")
    parser.add_argument("--csv", type=Path)
    options = parser.parse_args()
    rows = []
    for row in rows_of(options.kind, range(options.seeds)):
        print(*row.values(), sep=", ", flush=True)
        rows.append(row)
    if options.csv:
        with options.csv.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    return int(any(row["table"] == "harmless" and row["exit_30"] > MOST_FALSE * row["recordings"] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
