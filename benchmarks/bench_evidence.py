"""Make recordings of known truth, and count in how many `dds-trace bag` says that messages are missing.

Usage: bench_evidence.py [--seeds 200] [--kind NAME]. Harmless recordings lost nothing: at most 2 % may be said to. Of the others, with losses
that numbers, stamps or arrival alone can show, as many as possible. Ends with 1 where a bound of `BOUNDS` is missed.
"""

from __future__ import annotations

import argparse
import sys
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


def share_false(kind: str, seeds: range) -> float:
    """Return the share of harmless recordings of a kind that are said to lack messages."""
    return float(np.mean([says_missing(HARMLESS[kind](np.random.default_rng(seed)))[0] for seed in seeds]))


def shares_found(loss: str, evidence: str, seeds: range) -> tuple[float, float]:
    """Return the share of recordings in which losses are found, and in which the interval contains their number."""
    return tuple(np.mean([says_missing(lossy(np.random.default_rng(seed), loss, evidence)) for seed in seeds], axis=0))


def main() -> int:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--kind", default="", help="only kinds with this in their name")
    options = parser.parse_args()
    seeds, failed = range(options.seeds), False
    print("| harmless recordings | exit 30 |\n|---|---:|")
    for kind in HARMLESS:
        if options.kind in kind:
            share = share_false(kind, seeds)
            failed |= share > MOST_FALSE
            print(f"| {kind} | {share:.1%} |", flush=True)
    print("\n| losses | shown by | found | interval right |\n|---|---|---:|---:|")
    for loss in LOSSES:
        for evidence in EVIDENCE if options.kind in loss else ():
            found, within = shares_found(loss, evidence, seeds)
            print(f"| {loss} | {evidence} | {found:.1%} | {within:.1%} |", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
