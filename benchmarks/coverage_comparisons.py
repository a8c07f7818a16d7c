"""How often `dds-trace compare` errs and finds, by simulation with a known truth: losses, 1 to 50 results, five looks."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from functools import partial
from statistics import NormalDist
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
from simulated import (
    LOSSES,
    SEED,
    Table,
    draw_pareto,
    draw_values,
    estimate_of,
    outages,
    percent,
    round_trips,
    single_losses,
    unlike_losses,
)

from dds_trace.analyzer.groups.host_samples import HOST_SAMPLE_SCHEMA
from dds_trace.analyzer.run_statistics.change import Verdict, change_of_estimates
from dds_trace.analyzer.run_statistics.received import change_of_received
from dds_trace.analyzer.statistics.power import confidence_at_each
from dds_trace.extensions.gates.compare import CompareOptions, Comparison, compare, compare_roundtrips
from dds_trace.extensions.gates.gate import GateOutcome, parse_gates
from dds_trace.extensions.gates.gates import judge_gates, options_for, overall_outcome
from dds_trace.extensions.gates.info import comparison_info

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from simulated import DrawLosses, Float64

MOST_FALSE_LOSSES, MOST_FALSE_SENTENCES, MOST_FALSE_GATES, MOST_FALSE_LOOKS = 0.07, 0.05, 0.05, 0.025
LOOKS, RUNS_A_LOOK = 5, 5
RATE_HZ, PAUSE_SECONDS = 100, 2


def losses_table(samples: int) -> Table:
    """Count pairs of sides whose losses are called different."""
    shares = (0.005, 0.02, 0.05)
    equal = tuple(f"equal, {share:.1%}" for share in shares)
    table = Table("losses", ("losses", "runs", *equal, "0.5 % against 5 %"))
    for name, draw in LOSSES.items():
        for runs in (3, 5, 10):
            generator = np.random.default_rng([SEED, runs])
            cells = []
            for base, new in (*zip(shares, shares, strict=True), (0.005, 0.05)):
                sides = ([list(~draw(generator, runs, 1000, share)) for share in (base, new)] for _ in range(samples))
                called = sum(change_of_received(*pair).verdict() in {Verdict.BETTER, Verdict.WORSE} for pair in sides)
                bar = MOST_FALSE_LOSSES if base == new else 1.0
                cells.append(table.at_most(bar, called, samples, f"{name}, {runs} runs, {base:.1%}"))
            table.rows.append((name, f"{runs} x 1000", *cells))
    return table


@dataclass(frozen=True)
class Side:
    """One side of a comparison, as `compare` reads it."""

    rows: pl.DataFrame
    sessions: tuple[()] = ()
    runs: tuple[()] = ()
    findings: tuple[()] = ()

    @property
    def details(self) -> SimpleNamespace:
        """No sample of the host."""
        return SimpleNamespace(host_samples=pl.DataFrame(schema=HOST_SAMPLE_SCHEMA))

    @property
    def summary(self) -> pl.DataFrame:
        """One row for each result."""
        return self.rows.unique("payload_bytes", maintain_order=True)

    @property
    def barred_groups(self) -> pl.DataFrame:
        """None."""
        return self.rows.head(0)

    @property
    def topic_messages(self) -> pl.DataFrame:
        """None."""
        return self.rows.head(0)

    def load_messages(self) -> pl.DataFrame:
        """All messages."""
        return self.rows


EQUAL_RESULTS: tuple[tuple[str, DrawLosses | None, float, int, int], ...] = (
    ("none", None, 0.0, 5, 300),
    ("1 %, single", single_losses, 0.01, 5, 300),
    ("2 %, single", single_losses, 0.02, 5, 300),
    ("1 %, shares +-50 %", unlike_losses, 0.01, 5, 300),
    ("2 %, outages of 20", partial(outages, together=20), 0.02, 5, 300),
    ("1 %, outages of 4", partial(outages, together=4), 0.01, 10, 300),
)
"""Losses, their share, runs a side, messages of a run."""

NUMBERS = {1: 1, 6: 2, 50: 5}
"""Results of a comparison -> part of the samples."""


BLOCK = 25
"""Comparisons with one seed."""

P99_GATE = parse_gates(["latency_p99 > +20%"])
LATENCY = CompareOptions(metrics=("latency",))
"""Round trips are twice as long, so they are judged the same."""


def count_equal(
    results: int, draw: DrawLosses | None, share: float, runs: int, messages: int, number: int
) -> tuple[int, int, int]:
    """Compare equal results: of a block how many first sentences say slower or faster, or more is lost, and failed gates."""
    generator = np.random.default_rng([SEED, results, runs, int(1000 * share), number])
    said = lost = failed = 0
    for _ in range(BLOCK):
        sides = []
        for _ in range(2):
            times = draw_values(generator, results * runs, messages, 0.05)
            if draw is not None:
                times[draw(generator, results * runs, messages, share)] = math.inf
            sides.append(Side(round_trips(times.reshape(results, runs, messages))))
        comparison = compare(*sides, LATENCY)
        sentence = comparison_info(comparison).said
        said += "othing is shown to be slower" not in sentence or " faster" in sentence
        lost += "ore is lost" in sentence
        outcomes = (result.outcome for result in judge_gates(comparison, P99_GATE, allow_missing=True))
        failed += GateOutcome.REGRESSED in outcomes
    return said, lost, failed


def results_table(samples: int) -> Table:
    """Count comparisons of equal results, through `compare` and its first sentence, that say something or fail a gate."""
    table = Table("comparisons", COMPARISON_COLUMNS)
    for results, part in NUMBERS.items():
        blocks = max(1, samples // part // BLOCK)
        for name, *design in EQUAL_RESULTS:
            counts = [count_equal(results, *design, number) for number in range(blocks)]
            add_comparisons(table, results, name, design[-2:], counts)
    return table


COMPARISON_COLUMNS = (
    "equal results",
    "losses",
    "runs x messages",
    "comparisons",
    "slower or faster",
    "more is lost",
    "`latency_p99 > +20%` fails",
)


def add_comparisons(
    table: Table, results: int, name: str, size: Sequence[object], counts: Sequence[tuple[int, int, int]]
) -> None:
    """Append the row of some blocks."""
    comparisons, where = BLOCK * len(counts), f"{results} results, {name}"
    said, lost, failed = (sum(count) for count in zip(*counts, strict=True))
    table.rows.append(
        (
            str(results),
            name,
            " x ".join(map(str, size)),
            str(comparisons),
            table.at_most(MOST_FALSE_SENTENCES, said, comparisons, where),
            table.at_most(MOST_FALSE_LOSSES, lost, comparisons, f"{where}, losses"),
            table.at_most(MOST_FALSE_GATES, failed, comparisons, f"{where}, gate"),
        )
    )


LEAST_NAMED, MOST_NAMED = 0.75, 0.90
NAMED: dict[str, tuple[int, Callable[[np.random.Generator, int], Float64]]] = {
    "log-normal 0.5, runs +-5 %": (1, lambda generator, runs: draw_values(generator, runs, 1000, 0.05)),
    "log-normal 0.5, runs +-10 %": (1, lambda generator, runs: draw_values(generator, runs, 1000, 0.1)),
    "log-normal 1, runs +-5 %": (1, lambda generator, runs: draw_values(generator, runs, 1000, 0.05, 1.0)),
    "Pareto 1.5, runs +-5 %": (1, lambda generator, runs: draw_pareto(generator, runs, 1000)),
    "log-normal 0.5, one of six": (6, lambda generator, runs: draw_values(generator, runs, 1000, 0.05)),
}
NAMED_GATES = {"p50": parse_gates(["latency_p50 > +10%"]), "p99": P99_GATE}


def count_named(name: str, number: int) -> dict[str, bool]:
    """Return by statistic whether the change of one result that equal sides of five runs name is found, by its verdict and by a gate."""
    results, draw = NAMED[name]
    generator = np.random.default_rng([SEED, number])

    def compared(changed: int = 0, ratio: float = 1.0) -> Comparison:
        sides = [draw(generator, 5 * results).reshape(results, 5, -1) for _ in range(2)]
        sides[1][changed] *= ratio
        return compare(*(Side(round_trips(side)) for side in sides))

    equal, found = compared(), {}
    for sight in equal.sights():
        if (
            sight.metric == "latency"
            and sight.statistic in NAMED_GATES
            and sight.smallest_ratio
            and sight.most_result is not None
        ):
            rows = compared(sight.most_result, sight.smallest_ratio).rows
            changed = rows.filter(metric="latency", statistic=sight.statistic)["verdict"]
            found[sight.statistic] = changed[sight.most_result] == Verdict.WORSE.value
    for statistic, gates in NAMED_GATES.items():
        ratio = judge_gates(equal, gates)[0].found_from or 1.0
        found[f"gate {statistic}"] = judge_gates(compared(0, ratio), gates)[0].outcome is GateOutcome.REGRESSED
    return found


def named_table(samples: int) -> Table:
    """Count changes that equal sides name as found in 80 of 100 comparisons and that further sides find."""
    table = Table("named", ("messages", "p50", "p99", "gate p50", "gate p99"))
    for name in NAMED:
        found = [count_named(name, number) for number in range(samples)]
        cells = []
        for column in table.columns[1:]:
            count = sum(one[column] for one in found)
            table.at_most(MOST_NAMED, count, samples, f"{name}, {column}")
            cells.append(table.at_least(LEAST_NAMED, count, samples, f"{name}, {column}"))
        table.rows.append((name, *cells))
    return table


DEFAULT_GATES = parse_gates(["default"])
DEFAULT_OPTIONS = options_for(DEFAULT_GATES, CompareOptions(metrics=(), statistics=(), paired=True))
LEAST_FOUND = 0.80
DEFAULT_DESIGNS = (
    *(
        (results, *runs)
        for results in (1, 6)
        for runs in ((3, 0.05, 0.0), (3, 0.05, 0.01), (3, 0.1, 0.0), (5, 0.05, 0.0))
    ),
    (50, 3, 0.05, 0.01),
    (50, 3, 0.1, 0.0),
)
"""Results, interleaved repeats of 200 messages, spread of the runs, share of single losses; a repeat moves both sides by 10 %."""


def count_default(
    generator: np.random.Generator, samples: int, design: tuple[int, int, float, float], ratio: float, changed: int
) -> Counter[GateOutcome]:
    """Judge campaigns by `--fail-if default` of which some results take so many times as long on the new side."""
    results, repeats, spread, share = design
    passes = {run: run % repeats for run in range(results * repeats)}
    outcomes: Counter[GateOutcome] = Counter()
    for _ in range(samples):
        moved = np.exp(0.1 * generator.standard_normal((results, repeats, 1)))
        sides = []
        for change in (1.0, ratio):
            times = draw_values(generator, results * repeats, 200, spread)
            times[single_losses(generator, *times.shape, share)] = math.inf
            times = times.reshape(results, repeats, -1) * moved
            times[:changed] *= change
            sides.append(round_trips(times))
        comparison = compare_roundtrips(*sides, DEFAULT_OPTIONS, passes)
        outcomes[overall_outcome(result.outcome for result in judge_gates(comparison, DEFAULT_GATES))] += 1
    return outcomes


def default_table(samples: int) -> Table:
    """Count campaigns that `--fail-if default` fails: of one commit on both sides, and of one or all results that changed."""
    columns = ("results", "repeats", "runs vary by", "lost", "campaigns", "equal: fail", "equal: undecided")
    table = Table("default", (*columns, "+50 % of one: fail", "+50 % of all: fail", "+100 % of one: fail"))
    for design in DEFAULT_DESIGNS:
        results, repeats, spread, share = design
        generator = np.random.default_rng([SEED, results, repeats, int(1000 * spread), int(1000 * share)])
        where = f"{results} results, {repeats} repeats, {spread:.0%}, {share:.0%} lost"
        equal = count_default(generator, samples, design, 1.0, 0)
        cells = [
            table.at_most(MOST_FALSE_GATES, equal[GateOutcome.REGRESSED], samples, where),
            percent(equal[GateOutcome.INCONCLUSIVE], samples),
        ]
        for ratio, changed, bar in ((1.5, 1, LEAST_FOUND), (1.5, results, LEAST_FOUND), (2.0, 1, 0.0)):
            if results > 6:  # minutes each
                cells.append("-")
                continue
            found = count_default(generator, samples, design, ratio, changed)[GateOutcome.REGRESSED]
            cells.append(table.at_least(bar, found, samples, f"{where}, {ratio:g} x of {changed}"))
        table.rows.append(
            (str(results), str(repeats), f"{100 * spread:.0f} %", f"{100 * share:.0f} %", str(samples), *cells)
        )
    return table


GATES = (("p50", 0.5, 200, 1.1), ("p90", 0.9, 500, 1.1), ("p99", 0.99, 1000, 1.2))
"""Percentile, messages of a run, and limit of a gate."""


def looks_table(samples: int) -> Table:
    """Count outcomes of a gate by the last of up to five looks at five more runs a side each."""
    table = Table(
        "looks",
        (
            "gate",
            "true change",
            "spread of runs",
            "`--looks`",
            "regressed",
            "passed",
            "undecided",
            "runs a side",
            "minutes",
        ),
    )
    for percentile, quantile, messages, limit in GATES:
        density = NormalDist().pdf(NormalDist().inv_cdf(quantile))
        minutes_a_run = 2 * (messages / RATE_HZ + PAUSE_SECONDS) / 60
        for change, spread, looks in (
            (limit, 0.1, 1),
            (limit, 0.1, LOOKS),
            (1.0, 0.05, LOOKS),
            (1.0, 0.1, LOOKS),
            (limit + 0.1, 0.05, LOOKS),
            (limit + 0.1, 0.1, LOOKS),
        ):
            generator = np.random.default_rng([SEED, messages, int(100 * change), int(100 * spread)])
            regressed = passed = runs_in_all = 0
            deviation = math.hypot(spread, 0.5 * math.sqrt(quantile * (1 - quantile) / messages) / density)
            for _ in range(samples):
                base, new = np.exp(deviation * generator.standard_normal((2, LOOKS * RUNS_A_LOOK)))
                for runs in range(RUNS_A_LOOK, len(base) + 1, RUNS_A_LOOK):
                    sides = (estimate_of(side[:runs], confidence_at_each(looks)) for side in (base, change * new))
                    result = change_of_estimates(*sides)
                    is_over = result.ratio_low is not None and result.ratio_low > limit
                    is_under = result.ratio_high is not None and result.ratio_high <= limit
                    if is_over or is_under:
                        break
                regressed, passed, runs_in_all = regressed + is_over, passed + is_under, runs_in_all + runs
            gate = f"`latency_{percentile} > +{100 * (limit - 1):.0f}%`"
            bar = MOST_FALSE_LOOKS if change == limit and looks > 1 else 1.0
            table.rows.append(
                (
                    gate,
                    f"+{100 * (change - 1):.0f} %",
                    f"{100 * spread:.0f} %",
                    str(looks),
                    table.at_most(bar, regressed, samples, f"{gate}, {looks} looks"),
                    percent(passed, samples),
                    percent(samples - regressed - passed, samples),
                    f"{runs_in_all / samples:.1f}",
                    f"{minutes_a_run * runs_in_all / samples:.1f}",
                )
            )
    return table
