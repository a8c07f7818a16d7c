"""Count how often a comparison of equal sides errs, with recordings: pairs of disjoint runs of one cell, drawn many times.

    python benchmarks/real_aa.py FOLDER            # a sweep with at least twice as many passes as runs a side
    just real-aa FOLDER

What `benchmarks/coverage.py` simulates is drawn here from runs that were recorded: each pair has two disjoint sets of runs of the
same group, so that every verdict "better" or "worse" and every failed gate is false. Runs are drawn in no order, which
mixes the drift of the machine into both sides, or in the order of time (`early, late`: the first runs against the ones after
them), which no sweep in turns does. The pairs share their runs: a share is an estimate for these recordings.

The exit code is 1 if a share of the verdicts of drawn pairs is above the bar of 8 %.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from dds_trace.analyzer.model.names import group_words
from dds_trace.analyzer.model.parameters import PARAMETER_NAMES
from dds_trace.analyzer.pipeline import analyze
from dds_trace.analyzer.verdicts.setup_runs import SetupRuns
from dds_trace.extensions.gates.compare import CompareOptions, compare_groups
from dds_trace.extensions.gates.gate import GateOutcome, parse_gates
from dds_trace.extensions.gates.gates import judge_gates

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

STATISTICS = ("p50", "p90", "p99")
METRICS = ("latency", "rtt")
MOST_FALSE = 0.08
SEED = 20261121

IN_ORDER = "early, late"
"""Way of making pairs that has no bar: a machine that drifts makes them unlike."""


@dataclass(slots=True)
class Counts:
    """What came of the pairs of one group.

    Attributes:
        pairs: number of pairs.
        verdicts: (metric, statistic) -> verdicts better or worse.
        gates: text of a gate -> times it failed.
    """

    pairs: int = 0
    verdicts: dict[tuple[str, str], int] = field(
        default_factory=lambda: {(metric, name): 0 for metric in METRICS for name in STATISTICS}
    )
    gates: dict[str, int] = field(default_factory=dict)

    @property
    def worst(self) -> float:
        """The largest share of false verdicts."""
        return max(self.verdicts.values()) / self.pairs


def draw_sides(runs: Sequence[int], a_side: int, pairs: int) -> Iterator[tuple[list[int], list[int]]]:
    """Yield pairs of disjoint sets of runs, drawn anew for each pair."""
    generator = np.random.default_rng(SEED)
    for _ in range(pairs):
        drawn = [runs[place] for place in generator.permutation(len(runs))]
        yield drawn[:a_side], drawn[a_side : 2 * a_side]


def neighbouring_sides(runs: Sequence[int], a_side: int) -> Iterator[tuple[list[int], list[int]]]:
    """Yield each stretch of runs against the stretch that follows, in the order of time."""
    for first in range(len(runs) - 2 * a_side + 1):
        middle = first + a_side
        yield list(runs[first:middle]), list(runs[middle : middle + a_side])


def count(rows: pl.DataFrame, sides: Iterator[tuple[list[int], list[int]]], gate_texts: Sequence[str]) -> Counts:
    """Compare pairs of sets of runs of one group."""
    gates = parse_gates(gate_texts)
    options = CompareOptions(metrics=METRICS, statistics=STATISTICS)
    counts = Counts(gates=dict.fromkeys((gate.text for gate in gates), 0))
    key = rows.select(options.match).row(0)
    for base, new in sides:
        groups = [{key: SetupRuns.of(rows.filter(pl.col("run_id").is_in(side)))} for side in (base, new)]
        comparison = compare_groups(*groups, rows.schema, options)
        counts.pairs += 1
        for metric, statistic, verdict in comparison.rows.select("metric", "statistic", "verdict").iter_rows():
            counts.verdicts[metric, statistic] += verdict in {"better", "worse"}
        for result in judge_gates(comparison, gates):
            counts.gates[result.gate.text] += result.outcome is GateOutcome.REGRESSED
    return counts


def table(found: Mapping[tuple[str, str], Counts]) -> Iterator[str]:
    """Return lines of Markdown: percent of the pairs for each group and way of drawing."""
    gates = list(dict.fromkeys(text for counts in found.values() for text in counts.gates))
    verdicts = [f"{metric} {' / '.join(STATISTICS)}" for metric in METRICS]
    yield f"| recordings | pairs | {' | '.join([*verdicts, *(f'`{text}`' for text in gates)])} |"
    yield f"| --- | ---: |{' ---: |' * (len(verdicts) + len(gates))}"
    for (group, drawn), counts in found.items():
        shares = [
            " / ".join(_percent(counts.verdicts[metric, name], counts) for name in STATISTICS) for metric in METRICS
        ]
        shares += [_percent(counts.gates[text], counts) for text in gates]
        yield f"| {group}, {drawn} | {counts.pairs} | {' | '.join(shares)} |"


def _percent(number: int, counts: Counts) -> str:
    return f"{100 * number / counts.pairs:.1f}"


def main() -> int:
    """Draw the pairs of every group, print the table and the bars that are missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="the folder of a sweep, or any folder of traces")
    parser.add_argument("--runs", type=int, default=5, help="runs a side (default: 5)")
    parser.add_argument("--pairs", type=int, default=200, help="pairs drawn of each group (default: 200)")
    parser.add_argument("--gate", action="append", help="a gate to count (default: those of --fail-if default)")
    options = parser.parse_args()
    analysis = analyze(options.folder, details=False)
    roundtrips = analysis.load_messages()
    found: dict[tuple[str, str], Counts] = {}
    for group, rows in enumerate(roundtrips.partition_by(*PARAMETER_NAMES, maintain_order=True)):
        name = group_words(analysis.summary.row(group, named=True), ("vendor", "payload_bytes", "rate_hz"))
        started = rows.group_by("run_id").agg(pl.col("publish_ns").min()).sort("publish_ns")
        runs = started["run_id"].to_list()
        if len(runs) < 2 * options.runs:
            print(f"{name}: {len(runs)} runs are too few for two sides of {options.runs}", file=sys.stderr)
            continue
        gates = options.gate or ["default"]
        drawn = draw_sides(runs, options.runs, options.pairs)
        found[name, f"{options.runs} of {len(runs)} runs drawn"] = count(rows, drawn, gates)
        beside = neighbouring_sides(runs, options.runs)
        found[name, IN_ORDER] = count(rows, beside, gates)
    print("\n".join(table(found)))
    missed = [
        f"{' '.join(of)}: {counts.worst:.1%} false verdicts"
        for of, counts in found.items()
        if of[1] != IN_ORDER and counts.worst > MOST_FALSE
    ]
    print(
        "\n".join(
            ["", "missed bars:", *missed] if missed else ["", f"every share of drawn pairs is at most {MOST_FALSE:.0%}"]
        )
    )
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
