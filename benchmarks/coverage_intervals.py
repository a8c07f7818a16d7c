"""How often intervals hold the truth and verdicts are false, by simulation with a known truth.

A sample is a group of runs. Messages are log-normal (deviation of the logarithm 0.5) with one of four troubles: neighbours
that correlate, runs that differ, bursts of slow messages (five times slower), outages in which every message is lost.
One run is judged by its own truth, several by that of the distribution they come from.

First table, for p50, p90, p99 and the received ratio: how many of the two-sided intervals hold the truth; in brackets the
samples that have a two-sided interval and, of all samples, those with a wrong end. The two differ where few samples
have both ends: those are the lucky ones, in which the tail looks better than it is. Second table: verdicts of two
equal sides that say "better" or "worse", gates `> +10%` that fail between equal sides, and how often a side that is
10 % or 20 % slower is found.

The bars, each with two standard errors of the simulation: intervals hold in 92 to 98 % (from 90 % where there are bursts or
outages), at most 7 % of A/A verdicts are false and 3 % of the gates, +20 % is found in 80 % with five runs of 1000 messages a
side that spread by 5 %. Two kinds of cells are shown and not held against the bars of intervals: those with fewer than three bursts or outages on
average, because one in twenty of their samples and more has none at all and is a sample of independent messages, and
figures of which less than one sample in twenty has both ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np
from simulated import SEED, Table

from dds_trace.analyzer.run_statistics.between_runs import estimates_of_runs, interval_of_runs
from dds_trace.analyzer.run_statistics.change import Verdict, change_of_estimates
from dds_trace.analyzer.run_statistics.received import received_interval
from dds_trace.analyzer.run_statistics.runs import Run, Statistic
from dds_trace.analyzer.statistics.intervals import MIN_RUNS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from dds_trace.analyzer.run_statistics.change import Change
    from dds_trace.analyzer.statistics.intervals import Interval

    Float64 = NDArray[np.float64]
    Bools = NDArray[np.bool_]

SAMPLES_AT_ONCE = 50
DEVIATION = 0.5
SLOWER = 5.0
QUANTILES = (0.5, 0.9, 0.99)
SIZES = ((1, 1000), (1, 2000), (1, 5000), (3, 1000), (5, 1000), (10, 1000), (20, 1000))
GATE = 1.1

HOLD_FROM, HOLD_FROM_IN_BURSTS, HOLD_TO = 0.92, 0.90, 0.98
MOST_FALSE_VERDICTS, MOST_FALSE_GATES = 0.07, 0.03
LEAST_FOUND = 0.80
LEAST_PRINTED = 0.05
"""Share of samples with both ends from which on they are held against the bars. Bursts that were all too short to be seen are
rarer than that from three on average."""

LEAST_EPISODES = 3
"""Mean number of bursts or outages from which on a cell is held against the bars: exp(-3) of its samples, 5 %, have none."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """A distribution of runs.

    Attributes:
        correlation: of neighbouring messages' logarithms.
        run_spread: deviation of the logarithms of the runs' levels.
        burst_share: messages in bursts, in which they are `SLOWER`.
        loss_share: messages that are lost.
        together: messages of a burst or an outage, on average (geometric); 1 for single losses.
        loss_spread: deviation of the logarithms of the runs' loss shares.
    """

    name: str
    correlation: float = 0.0
    run_spread: float = 0.0
    burst_share: float = 0.0
    loss_share: float = 0.0
    together: float = 1.0
    loss_spread: float = 0.0

    @property
    def hold_from(self) -> float:
        """The least share of intervals that hold the truth."""
        return HOLD_FROM_IN_BURSTS if self.together > 1 else HOLD_FROM

    def episodes(self, messages: int) -> float:
        """Return the mean number of bursts or outages in a number of messages; infinite in a scenario without any."""
        share = self.burst_share + self.loss_share
        return messages * share / self.together if self.together > 1 else math.inf

    def draw(self, generator: np.random.Generator, runs: int, messages: int, is_own_truth: bool) -> Float64:
        """Draw runs, without their own level if each is judged by its own truth; shape (runs, messages)."""
        values = DEVIATION * _correlated(generator, runs, messages, self.correlation)
        if not is_own_truth:
            values += self.run_spread * generator.standard_normal((runs, 1))
        values = np.exp(values)
        if self.burst_share:
            values[_episodes(generator, runs, messages, self.burst_share, self.together)] *= SLOWER
        if self.loss_share:
            apart = self.loss_spread * generator.standard_normal((runs, 1)) * (not is_own_truth)
            shares = self.loss_share * np.exp(apart - self.loss_spread**2 / 2 * (not is_own_truth))
            if self.together > 1:
                lost = _episodes(generator, runs, messages, self.loss_share, self.together)
            else:
                lost = generator.random((runs, messages)) < shares
            values[lost] = math.inf
        return values

    def truth(self, quantile: float) -> float:
        """Return the quantile of the messages of a run of the middle level; infinite beyond the share that arrives."""
        of_received = quantile / (1 - self.loss_share)
        if of_received >= 1:
            return math.inf
        normal = NormalDist(0, DEVIATION)
        low, high = -5.0, 5.0
        for _ in range(80):
            middle = (low + high) / 2
            slow = normal.cdf(middle - math.log(SLOWER))
            below = normal.cdf(middle) + self.burst_share * (slow - normal.cdf(middle))
            low, high = (middle, high) if below < of_received else (low, middle)
        return math.exp(low)


SCENARIOS = (
    Scenario("independent"),
    Scenario("independent, runs +-5 %", run_spread=0.05),
    Scenario("independent, runs +-10 %", run_spread=0.10),
    Scenario("AR(1) 0.5, runs +-5 %", correlation=0.5, run_spread=0.05),
    Scenario("AR(1) 0.8", correlation=0.8),
    Scenario("AR(1) 0.8, runs +-5 %", correlation=0.8, run_spread=0.05),
    Scenario("AR(1) 0.95", correlation=0.95),
    Scenario("AR(1) 0.95, runs +-5 %", correlation=0.95, run_spread=0.05),
    *(
        Scenario(
            f"bursts of {together}, {share:.0%}, runs +-5 %".replace("%,", " %,"), 0.0, 0.05, share, together=together
        )
        for together in (5, 20, 50, 100, 200)
        for share in (0.05, 0.02)
    ),
    Scenario("losses 0.5 %", loss_share=0.005),
    Scenario("losses 3 %, shares +-50 %", loss_share=0.03, loss_spread=0.5),
    Scenario("outages of 20, 5 %, runs +-5 %", run_spread=0.05, loss_share=0.05, together=20),
    Scenario("outages of 20, 2 %", loss_share=0.02, together=20),
    Scenario("outages of 100, 2 %", loss_share=0.02, together=100),
)


def _correlated(generator: np.random.Generator, runs: int, messages: int, correlation: float) -> Float64:
    """Draw standard normal values, message by message over all runs at once."""
    values = generator.standard_normal((messages, runs))
    if correlation:
        for place in range(1, messages):
            values[place] = correlation * values[place - 1] + math.sqrt(1 - correlation**2) * values[place]
    return values.T


def _episodes(generator: np.random.Generator, runs: int, messages: int, share: float, together: float) -> Bools:
    """Draw which messages are in an episode: a chain of two states that begins in its long-run shares."""
    begins = share / (1 - share) / together
    draws = generator.random((messages, runs))
    inside = np.empty((messages, runs), np.bool_)
    state = generator.random(runs) < share
    for place in range(messages):
        state = np.where(state, draws[place] >= 1 / together, draws[place] < begins)
        inside[place] = state
    return inside.T


@dataclass(slots=True)
class Intervals:
    """What came of the intervals of one figure."""

    samples: int = 0
    printed: int = 0
    held: int = 0
    wrong: int = 0

    def add(self, interval: Interval, truth: float) -> None:
        """Count one interval."""
        is_held = (interval.lower is None or interval.lower <= truth) and (
            interval.upper is None or truth <= interval.upper
        )
        self.samples += 1
        self.wrong += not is_held
        self.printed += interval.is_two_sided
        self.held += interval.is_two_sided and is_held

    def words(self) -> str:
        """Return in percent: held of those with both ends (with both ends of all, wrong of all)."""
        held = f"{100 * self.held / self.printed:.0f}" if self.printed else "-"
        return f"{held} ({100 * self.printed / self.samples:.0f}, {100 * self.wrong / self.samples:.0f})"


@dataclass(slots=True)
class Verdicts:
    """What came of comparing two equal sides by one quantile, and if one is made slower."""

    pairs: int = 0
    false_verdicts: int = 0
    false_gates: int = 0
    found: dict[float, int] = field(default_factory=lambda: {1.1: 0, 1.2: 0})

    def add(self, change: Change) -> None:
        """Count one change; a side that is slower by a factor has the ratio and its ends times that factor."""
        self.pairs += 1
        self.false_verdicts += change.verdict(0.0) in {Verdict.BETTER, Verdict.WORSE}
        if change.ratio_low is not None:
            self.false_gates += change.ratio_low > GATE
            for factor in self.found:
                self.found[factor] += change.ratio_low * factor > 1


@dataclass(frozen=True, slots=True)
class Cell:
    """One scenario at one size."""

    scenario: Scenario
    runs: int
    messages: int
    intervals: dict[float, Intervals]
    received: Intervals
    verdicts: dict[float, Verdicts]

    @property
    def name(self) -> str:
        """The scenario and the size."""
        return f"{self.scenario.name}, {self.runs} x {self.messages}"

    @property
    def bursts(self) -> float:
        """Mean number of bursts or outages in all runs; infinite in a scenario without any."""
        return self.scenario.episodes(self.runs * self.messages)

    def missed(self) -> Iterator[str]:
        """Return the bars that the cell misses, in words."""
        if self.bursts >= LEAST_EPISODES:
            figures = [(f"p{100 * q:g}", found) for q, found in self.intervals.items()]
            for figure, found in [*figures, ("received ratio", self.received)]:
                yield from _missed_interval(figure, found, self.scenario)
        for quantile, found in self.verdicts.items():
            yield from _missed_verdict(f"p{100 * quantile:g}", found, self)


def _missed_interval(figure: str, found: Intervals, scenario: Scenario) -> Iterator[str]:
    if not found.samples or found.printed < LEAST_PRINTED * found.samples:
        return
    share = found.held / found.printed
    errors = 2 * math.sqrt(share * (1 - share) / found.printed)
    if share + errors < scenario.hold_from:
        yield f"{figure} held in {share:.1%}"
    # A value that is infinite has an interval up to infinity, which holds it for certain.
    is_certain = math.isinf(scenario.truth(0.99)) and figure == "p99"
    if share - errors > HOLD_TO and not is_certain:
        yield f"{figure} held in {share:.1%}, too wide"


def _missed_verdict(figure: str, found: Verdicts, cell: Cell) -> Iterator[str]:
    def above(count: int, bar: float) -> bool:
        return count / found.pairs > bar + 2 * math.sqrt(bar * (1 - bar) / found.pairs)

    if above(found.false_verdicts, MOST_FALSE_VERDICTS):
        yield f"{figure}: {found.false_verdicts / found.pairs:.1%} false verdicts"
    if above(found.false_gates, MOST_FALSE_GATES):
        yield f"{figure}: {found.false_gates / found.pairs:.1%} false gates"
    is_barred = (cell.scenario.name, cell.runs) == ("independent, runs +-5 %", 5)
    if is_barred and above(found.pairs - found.found[1.2], 1 - LEAST_FOUND):
        yield f"{figure}: +20 % found in {found.found[1.2] / found.pairs:.1%}"


def measure(scenario: Scenario, runs: int, messages: int, samples: int) -> Cell:
    """Draw groups of runs and count what is said of them; each two neighbours are a pair of equal sides."""
    generator = np.random.default_rng([SEED, runs, messages])
    intervals = {quantile: Intervals() for quantile in QUANTILES}
    verdicts = {quantile: Verdicts() for quantile in QUANTILES} if runs >= MIN_RUNS else {}
    cell = Cell(scenario, runs, messages, intervals, Intervals(), verdicts)
    truths = {quantile: scenario.truth(quantile) for quantile in QUANTILES}
    for _ in range(0, samples, SAMPLES_AT_ONCE):
        drawn = scenario.draw(generator, runs * SAMPLES_AT_ONCE, messages, runs < MIN_RUNS)
        groups = [[Run(values) for values in group] for group in drawn.reshape(SAMPLES_AT_ONCE, runs, messages)]
        for quantile, found in intervals.items():
            for interval in _intervals(groups, quantile, verdicts.get(quantile)):
                found.add(interval, truths[quantile])
        if scenario.loss_share:
            _judge_received(cell, groups)
    return cell


def _intervals(groups: Sequence[Sequence[Run]], quantile: float, verdicts: Verdicts | None) -> Iterator[Interval]:
    """Return the interval of each group; those of pairs come with the change, which is counted."""
    statistic = Statistic(quantile)
    if verdicts is None:
        yield from (interval_of_runs(group, statistic) for group in groups)
        return
    for base, new in zip(groups[::2], groups[1::2], strict=True):
        change = change_of_estimates(*(estimates_of_runs(side, [statistic])[0] for side in (base, new)))
        verdicts.add(change)
        yield from (change.base, change.new)


def _judge_received(cell: Cell, groups: Sequence[Sequence[Run]]) -> None:
    for group in groups:
        received = received_interval([np.isfinite(run.values) for run in group])
        # Without a loss in sight the lower end supposes single losses, and says so by no episodes.
        if received.episodes:
            cell.received.add(received, 1 - cell.scenario.loss_share)


def interval_tables(samples: int, only: str = "") -> Iterator[Table]:
    """Count intervals that hold the truth, and verdicts of equal and unlike sides, in the scenarios whose name contains `only`."""
    cells = [measure(scenario, *size, samples) for scenario in SCENARIOS if only in scenario.name for size in SIZES]
    intervals = Table("intervals", ("scenario", "runs x messages", "bursts", "p50", "p90", "p99", "received ratio"))
    verdicts = Table(
        "verdicts",
        (
            "scenario",
            "runs x messages",
            "false verdicts, equal sides",
            "false gates `> +10%`",
            "+10 % found",
            "+20 % found",
        ),
    )
    for cell in cells:
        name = (cell.scenario.name, f"{cell.runs} x {cell.messages}")
        bursts = f"{cell.bursts:g}" if math.isfinite(cell.bursts) else ""
        figures = (found.words() for found in cell.intervals.values())
        intervals.rows.append((*name, bursts, *figures, cell.received.words() if cell.received.samples else ""))
        intervals.missed += [f"{cell.name}: {words}" for words in cell.missed()]
        if cell.verdicts:
            found = cell.verdicts.values()
            columns = (
                [verdict.false_verdicts for verdict in found],
                [verdict.false_gates for verdict in found],
                [verdict.found[1.1] for verdict in found],
                [verdict.found[1.2] for verdict in found],
            )
            pairs = next(iter(found)).pairs
            verdicts.rows.append(
                (*name, *(" / ".join(f"{100 * count / pairs:.0f}" for count in counts) for counts in columns))
            )
    yield from (intervals, verdicts)
