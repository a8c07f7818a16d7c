"""How often `dds-analyze compare` errs and finds, by simulation with a known truth: losses, many results, five looks.

    python benchmarks/comparisons.py --quick    a look, some minutes
    python benchmarks/comparisons.py            the tables of docs/results/coverage.md

The bars, each with two standard errors of the simulation: of two equal sides "loses more" or "loses less" is said in at most 7 %,
over 1 to 50 equal results slower or faster is said in at most 5 % and a gate on p99 fails in at most 5 %, with and without
losses, and five looks at growing recordings, each with `--looks 5`, fail a gate at its limit in at most 2.5 %. The exit code is 1
if a bar is missed.
"""

from __future__ import annotations

import argparse
import math
import sys
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from dds_trace.analyzer.run_statistics.change import Verdict, change_of_runs
from dds_trace.analyzer.run_statistics.received import change_of_received
from dds_trace.analyzer.run_statistics.runs import Run, Statistic
from dds_trace.analyzer.statistics.power import confidence_at_each
from dds_trace.analyzer.verdicts.compare import CompareOptions, compare_groups
from dds_trace.analyzer.verdicts.gate import GateOutcome, parse_gates
from dds_trace.analyzer.verdicts.gates import judge_gates
from dds_trace.analyzer.verdicts.matching import MatchedGroup

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    Bools = NDArray[np.bool_]
    DrawLosses = Callable[[np.random.Generator, int, int, float], Bools]

SEED = 20_261_126
MESSAGES = 1000
RUN_SPREAD = 0.05
MOST_FALSE_LOSSES, MOST_FALSE_SENTENCES, MOST_FALSE_GATES = 0.07, 0.05, 0.05
MOST_FALSE_LOOKS = 0.025
LOOKS, RUNS_A_LOOK = 5, 5


def single_losses(generator: np.random.Generator, runs: int, messages: int, share: float) -> Bools:
    """Draw which messages are lost, one by one; shape (runs, messages)."""
    return generator.random((runs, messages)) < share


def unlike_losses(generator: np.random.Generator, runs: int, messages: int, share: float) -> Bools:
    """Draw single losses of runs whose shares vary by half."""
    shares = share * np.exp(0.5 * generator.standard_normal((runs, 1)) - 0.125)
    return generator.random((runs, messages)) < shares


def outages(generator: np.random.Generator, runs: int, messages: int, share: float, together: int) -> Bools:
    """Draw outages of so many messages, which begin at any message."""
    begins = generator.random((runs, messages + together - 1)) < share / together
    seen = np.cumsum(np.pad(begins, ((0, 0), (1, 0))), axis=1)
    return seen[:, together:] > seen[:, :-together]


LOSSES: dict[str, DrawLosses] = {
    "single losses": single_losses,
    "shares +-50 %": unlike_losses,
    **{f"outages of {together}": partial(outages, together=together) for together in (4, 20, 40, 100)},
}


def is_above(count: int, samples: int, bar: float) -> bool:
    """Return whether a share is above its bar by more than two standard errors."""
    return count / samples > bar + 2 * math.sqrt(bar * (1 - bar) / samples)


def losses_table(samples: int, missed: list[str]) -> Iterator[str]:
    """Return lines of Markdown: percent of pairs of sides whose losses are told apart."""
    shares = (0.005, 0.02, 0.05)
    yield f"| losses | runs | {' | '.join(f'equal, {share:.1%}' for share in shares)} | 0.5 % against 5 % |"
    yield "|---|---|---|---|---|---|"
    for name, draw in LOSSES.items():
        for runs in (3, 5, 10):
            generator = np.random.default_rng([SEED, runs])
            cells = []
            for base, new in (*zip(shares, shares, strict=True), (0.005, 0.05)):
                sides = (
                    [list(~draw(generator, runs, MESSAGES, share)) for share in (base, new)] for _ in range(samples)
                )
                told = sum(change_of_received(*pair).verdict() in {Verdict.BETTER, Verdict.WORSE} for pair in sides)
                cells.append(f"{100 * told / samples:.1f}")
                if base == new and is_above(told, samples, MOST_FALSE_LOSSES):
                    missed.append(f"{name}, {runs} runs, {base:.1%}: {told / samples:.1%} false")
            yield f"| {name} | {runs} x {MESSAGES} | {' | '.join(cells)} |"


def draw_group(generator: np.random.Generator, runs: int, messages: int, lost: Bools) -> MatchedGroup:
    """Draw a result: log-normal messages, runs that vary by `RUN_SPREAD`."""
    values = np.exp(
        0.5 * generator.standard_normal((runs, messages)) + RUN_SPREAD * generator.standard_normal((runs, 1))
    )
    latency = np.where(lost, np.nan, 1e6 * values).ravel()
    frame = pl.DataFrame(
        {
            "run_id": np.repeat(np.arange(runs), messages),
            "publish_ns": np.arange(runs * messages) * 10_000_000,
            "latency_ns": latency,
            "rtt_ns": 2 * latency,
            "outcome": np.where(lost.ravel(), "lost", "completed"),
        }
    ).with_columns(pl.col("latency_ns", "rtt_ns").fill_nan(None))
    return MatchedGroup(frame)


def results_table(samples: int, missed: list[str]) -> Iterator[str]:
    """Return lines of Markdown: percent of comparisons of equal results that say something, or fail a gate on p99."""
    gates = parse_gates(["latency_p99 > +20%"])
    options = CompareOptions(match=("payload_bytes",))
    yield "| equal results | losses | slower or faster | more or less lost | `latency_p99 > +20%` fails |"
    yield "|---|---|---|---|---|"
    for results in (1, 6, 50):
        for name, draw, share in (
            ("none", single_losses, 0.0),
            ("1 %, single", single_losses, 0.01),
            ("2 %, single", single_losses, 0.02),
            ("2 %, outages of 20", partial(outages, together=20), 0.02),
        ):
            generator = np.random.default_rng([SEED, results])
            said = lost = failed = 0
            repeats = max(50, samples // results)
            for _ in range(repeats):
                sides = [
                    {(size,): draw_group(generator, 5, 300, draw(generator, 5, 300, share)) for size in range(results)}
                    for _ in range(2)
                ]
                comparison = compare_groups(*sides, {"payload_bytes": pl.Int64()}, options)
                said += bool(comparison.rows["verdict"].is_in(["better", "worse"]).any())
                lost += bool(comparison.delivery["verdict"].is_in(["better", "worse"]).any())
                failed += any(
                    result.outcome is GateOutcome.REGRESSED
                    for result in judge_gates(comparison, gates, allow_missing=True)
                )
            counts = ((said, MOST_FALSE_SENTENCES), (lost, MOST_FALSE_LOSSES), (failed, MOST_FALSE_GATES))
            missed += [
                f"{results} results, {name}: {count / repeats:.1%}"
                for count, bar in counts
                if is_above(count, repeats, bar)
            ]
            cells = " | ".join(f"{100 * count / repeats:.1f}" for count, _ in counts)
            yield f"| {results} | {name} | {cells} |"


def looks_table(samples: int, missed: list[str]) -> Iterator[str]:
    """Return lines of Markdown: outcomes of `latency_p50 > +10%` by the last of five looks at five more runs a side each."""
    yield "| true change | spread of runs | `--looks` | regressed | passed | undecided | mean runs a side |"
    yield "|---|---|---|---|---|---|---|"
    for change, spread, looks in (
        (1.1, 0.1, 1),
        (1.1, 0.1, LOOKS),
        (1.0, 0.1, LOOKS),
        (1.2, 0.1, LOOKS),
        (1.2, 0.05, LOOKS),
        (1.0, 0.05, LOOKS),
    ):
        generator = np.random.default_rng([SEED, int(100 * change), int(100 * spread)])
        most = LOOKS * RUNS_A_LOOK
        regressed = passed = runs_in_all = 0
        for _ in range(samples):
            levels = np.exp(spread * generator.standard_normal((2, most)) + [[0.0], [math.log(change)]])
            for look in range(1, LOOKS + 1):
                runs = look * RUNS_A_LOOK
                sides = [[Run(np.array([level])) for level in side[:runs]] for side in levels]
                result = change_of_runs(*sides, Statistic(0.5), confidence_at_each(looks))
                is_over = result.ratio_low is not None and result.ratio_low > 1.1
                is_under = result.ratio_high is not None and result.ratio_high <= 1.1
                if is_over or is_under:
                    break
            regressed, passed, runs_in_all = regressed + is_over, passed + is_under, runs_in_all + runs
        if change == 1.1 and looks > 1 and is_above(regressed, samples, MOST_FALSE_LOOKS):
            missed.append(f"{looks} looks: {regressed / samples:.1%} false")
        shares = [regressed, passed, samples - regressed - passed]
        cells = " | ".join(f"{100 * share / samples:.1f}" for share in shares)
        yield f"| +{100 * change - 100:.0f} % | {spread:.0%} | {looks} | {cells} | {runs_in_all / samples:.1f} |"


def main() -> int:
    """Simulate, print the tables and the bars that are missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a fifth of the samples")
    options = parser.parse_args()
    samples = 200 if options.quick else 1000
    missed: list[str] = []
    for table in (looks_table, losses_table, results_table):
        for line in table(samples, missed):
            print(line, flush=True)
        print()
    print("\n".join(["missed bars:", *missed] if missed else ["every bar holds"]))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
