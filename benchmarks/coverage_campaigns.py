"""How often answers, recommendations and `--until` err and find, by simulated campaigns with a known truth."""

from __future__ import annotations

import math
from functools import partial
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np
from coverage_intervals import SCENARIOS
from simulated import LOSSES, SEED, Table, estimate_of, percent, round_trips

from dds_trace.analyzer.run_statistics.between_runs import estimates_of_runs
from dds_trace.analyzer.run_statistics.runs import Run, Statistic
from dds_trace.analyzer.statistics.distributions import student_quantile
from dds_trace.analyzer.statistics.intervals import MIN_RUNS
from dds_trace.analyzer.verdicts.job import Job
from dds_trace.analyzer.verdicts.judgements import PROVEN
from dds_trace.analyzer.verdicts.ranking import Kind, judge_losers, rank_setups
from dds_trace.analyzer.verdicts.recommend import Fit
from dds_trace.analyzer.verdicts.setup_runs import SetupRuns
from dds_trace.extensions.campaigns.recommend import recommend_settings
from dds_trace.extensions.campaigns.verdicts.false_alarms import until_confidence

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray
    from simulated import DrawLosses

    Float64 = NDArray[np.float64]
    Draw = Callable[[np.random.Generator, tuple[int, int, int]], Float64]

SPREAD = 0.2
MOST_FALSE_LEADERS, MOST_FALSE_LOSERS, MOST_FALSE_MEETS = 0.05, 0.07, 0.05
PERCENTILES = {"p50": Statistic(0.5), "p99": Statistic(0.99)}


def independent(generator: np.random.Generator, shape: tuple[int, int, int]) -> Float64:
    """Draw the logarithms of the runs, without their mean; shape (kinds, setups, repeats)."""
    return SPREAD * generator.standard_normal(shape)


def shared(generator: np.random.Generator, shape: tuple[int, int, int], share: float, setups: int) -> Float64:
    """Draw runs that share a part of their variance over the kinds of a repeat, with 1 `setups` over the setups, too."""
    kinds, own, repeats = shape
    common = generator.standard_normal((1, 1 if setups else own, repeats))
    return SPREAD * (
        math.sqrt(share) * common + math.sqrt(1 - share) * generator.standard_normal((kinds, own, repeats))
    )


def unlike_kinds(generator: np.random.Generator, shape: tuple[int, int, int]) -> Float64:
    """Draw runs whose spread depends on the kind of message, 0.2 to 3 times."""
    return independent(generator, shape) * np.geomspace(0.2, 3, shape[0])[:, None, None]


def unlike_setups(generator: np.random.Generator, shape: tuple[int, int, int]) -> Float64:
    """Draw runs whose spread depends on the setup, 0.3 to 3 times."""
    return independent(generator, shape) * np.geomspace(0.3, 3, shape[1])[None, :, None]


def one_noisy(generator: np.random.Generator, shape: tuple[int, int, int]) -> Float64:
    """Draw runs of which one kind of message spreads four times as much."""
    return independent(generator, shape) * np.where(np.arange(shape[0]) == 0, 4, 1)[:, None, None]


def heavy_tails(generator: np.random.Generator, shape: tuple[int, int, int]) -> Float64:
    """Draw runs with Student's t of three degrees."""
    return SPREAD * generator.standard_t(3, shape) / math.sqrt(3)


DESIGNS: dict[str, Draw] = {
    "independent": independent,
    "a repeat moves all": partial(shared, share=0.5, setups=1),
    "a relay moves its sizes, 0.5": partial(shared, share=0.5, setups=0),
    "a relay moves its sizes, 0.95": partial(shared, share=0.95, setups=0),
    "spreads unlike over sizes": unlike_kinds,
    "one noisy size": one_noisy,
    "spreads unlike over setups": unlike_setups,
    "heavy tails": heavy_tails,
}


def kinds_of(median: Float64, tail: Float64) -> list[Kind]:
    return [
        Kind(
            "",
            {
                str(setup): SetupRuns(
                    {"p50": estimate_of(p50), "p99": estimate_of(p99)}, repeats=tuple(range(len(p50)))
                )
                for setup, (p50, p99) in enumerate(zip(*of_kind, strict=True))
            },
            ("p50", "p99"),
        )
        for of_kind in zip(np.exp(median), np.exp(tail), strict=True)
    ]


def _campaign(generator: np.random.Generator, draw: Draw, shape: tuple[int, int, int]) -> list[Kind]:
    """Draw a campaign in which p99 follows the median of its run in part."""
    median = draw(generator, shape)
    return kinds_of(median, 0.7 * median + math.sqrt(1 - 0.7**2) * draw(generator, shape))


MANY = 100
"""Results beyond which a fifth of the campaigns is simulated."""


def leaders_table(samples: int) -> Table:
    """Count campaigns of equal setups in which any of them is called the fastest, at the median or at p99."""
    counts = (1, 6, 20)
    table = Table("leaders", ("runs vary by 20 %", "repeats", "setups", *(f"kinds: {kinds}" for kinds in counts)))
    for name, draw in DESIGNS.items():
        for repeats in (3, 5):
            for setups in (2, 3, 6):
                cells = []
                for kinds in counts:
                    generator = np.random.default_rng([SEED, repeats, setups, kinds])
                    campaigns = max(1, samples // 5) if kinds * setups > MANY else samples
                    false = sum(
                        any(ranking.leader for rankings in rank_setups(campaign) for ranking in rankings.values())
                        for campaign in (_campaign(generator, draw, (kinds, setups, repeats)) for _ in range(campaigns))
                    )
                    where = f"{name}, {repeats} repeats, {setups} setups, {kinds} kinds"
                    cells.append(table.at_most(MOST_FALSE_LEADERS, false, campaigns, where))
                table.rows.append((name, str(repeats), str(setups), *cells))
    return table


MESSAGES, POOL = 1000, 4


def message_leaders_table(samples: int) -> Table:
    """Count the same with messages, five repeats and three setups; the setups of all campaigns are drawn from a pool of them."""
    counts = (1, 6, 20)
    table = Table("leaders-messages", ("messages of runs", *(f"kinds: {kinds}" for kinds in counts)))
    for scenario in SCENARIOS:
        generator = np.random.default_rng([SEED, 5])
        pool = []
        drawn = scenario.draw(generator, 5 * POOL * samples, MESSAGES, is_own_truth=False)
        for values in drawn.reshape(-1, 5, MESSAGES):
            estimates = estimates_of_runs([Run(run) for run in values], list(PERCENTILES.values()))
            received = np.isfinite(values)
            pool.append(
                SetupRuns(
                    dict(zip(PERCENTILES, estimates, strict=True)), repeats=tuple(range(5)), received=tuple(received)
                )
            )
        cells = []
        for kinds in counts:
            false = 0
            for _ in range(samples):
                drawn = generator.choice(len(pool), 3 * kinds, replace=3 * kinds > len(pool)).reshape(kinds, 3)
                campaign = [_kind_of({str(number): pool[index] for number, index in enumerate(of)}) for of in drawn]
                rankings = rank_setups(campaign)
                false += any(ranking.leader for ranked in rankings for ranking in ranked.values())
            cells.append(table.at_most(MOST_FALSE_LEADERS, false, samples, f"{scenario.name}, {kinds} kinds"))
        table.rows.append((scenario.name, *cells))
    return table


def _kind_of(setups: Mapping[str, SetupRuns]) -> Kind:
    has_tails = all(setup.estimates["p99"].interval.is_two_sided for setup in setups.values())
    lossy = frozenset(name for name, setup in setups.items() if setup.received_share < 0.99)
    return Kind("", setups, ("p50", "p99") if has_tails else ("p50",), barred=lossy)


LEADS = ((3, 3, 2.0, 0.60), (5, 6, 1.5, 0.45), (5, 6, 2.0, 0.95), (5, 3, 1.5, 0.0), (5, 2, 1.3, 0.0))
"""Repeats, setups, how much longer all but one take, and the least share of kinds in which that one is to be called."""


def found_leaders_table(samples: int) -> Table:
    """Count kinds of message in which the setup that is faster than all others is called the fastest."""
    counts = (1, 3, 6)
    table = Table(
        "leaders-found", ("repeats", "setups", "the others take", *(f"called, kinds: {kinds}" for kinds in counts))
    )
    for repeats, setups, ratio, bar in LEADS:
        cells = []
        for kinds in counts:
            generator = np.random.default_rng([SEED, repeats, setups, kinds])
            called = 0
            for _ in range(samples):
                median = independent(generator, (kinds, setups, repeats))
                median[:, 1:] += math.log(ratio)
                called += sum(
                    rankings["p50"].leader == "0" for rankings in rank_setups(kinds_of(median, np.zeros_like(median)))
                )
            where = f"{repeats} repeats, {setups} setups, {ratio:g} x"
            cells.append(table.at_least(bar if kinds == 1 else 0.0, called, kinds * samples, where))
        table.rows.append((str(repeats), str(setups), f"{ratio:g} x", *cells))
    return table


def _lossy(generator: np.random.Generator, draw: DrawLosses, kinds: int, shares: tuple[float, ...]) -> list[Kind]:
    return [
        Kind(
            "",
            {
                str(number): SetupRuns({}, received=tuple(~draw(generator, 5, 300, share)))
                for number, share in enumerate(shares)
            },
            (),
        )
        for _ in range(kinds)
    ]


def _losers(campaign: list[Kind]) -> list[set[str]]:
    return [{row.subject for row in rows if row.verdict == PROVEN} for rows in judge_losers(campaign)]


LOSER_SETUPS = (2, 6)


def losers_table(samples: int) -> Table:
    """Count campaigns of setups that lose equally in which one is said to lose more, and one of 5 % among others of 0.5 % found."""
    counts = (1, 6, 20)
    table = Table(
        "losers",
        (
            "2 % lost, 5 x 300",
            "setups",
            *(f"kinds: {kinds}" for kinds in counts),
            "0.5 % against 5 %, 1 kind",
            "0.5 % against 5 %, 6 kinds",
        ),
    )
    for name, draw in LOSSES.items():
        for setups in LOSER_SETUPS:
            generator = np.random.default_rng([SEED, setups])

            cells = []
            for kinds in counts:
                false = sum(any(_losers(_lossy(generator, draw, kinds, (0.02,) * setups))) for _ in range(samples))
                where = f"{name}, {setups} setups, {kinds} kinds"
                cells.append(table.at_most(MOST_FALSE_LOSERS, false, samples, where))
            for kinds in (1, 6):
                unlike = (0.05, *(0.005,) * (setups - 1))
                found = sum(
                    sum("0" in names for names in _losers(_lossy(generator, draw, kinds, unlike)))
                    for _ in range(samples)
                )
                cells.append(percent(found, kinds * samples))
            table.rows.append((name, str(setups), *cells))
    return table


DEADLINES = (
    ("one in ten takes 3 times as long", 0.1, 0.1, 0.05),
    ("one in ten takes 3 times as long, vary by 20 %", 0.1, 0.1, 0.2),
    ("vary by 20 %", 0.02, 0.0, 0.2),
    ("vary by 10 %", 0.02, 0.0, 0.1),
    ("vary by 20 %", 0.001, 0.0, 0.2),
    ("vary by 10 %", 0.001, 0.0, 0.1),
    ("vary by 5 %", 0.001, 0.0, 0.05),
)
"""Runs, their true share of late messages, the share of slow runs, the spread of the others."""

DEADLINE_REPEATS = (5, 10, 20)


def deadlines_table(samples: int) -> Table:
    """Count jobs (99 % in time) that a setting is said to meet: the true share late is 2 % and more, or nearly none."""
    table = Table(
        "deadlines", ("runs", "late", "repeats", "said to meet", "said to miss", "repeats without a slow run")
    )
    deadline = 2.0
    for name, late, slow_share, spread in DEADLINES:
        for repeats in DEADLINE_REPEATS:
            generator = np.random.default_rng([SEED, repeats, int(1000 * late)])
            level = deadline / math.exp(-NormalDist().inv_cdf(0.0005 if slow_share else late) * math.hypot(0.2, spread))
            meets = misses = unseen = 0
            for _ in range(samples):
                levels = level * np.exp(spread * generator.standard_normal((repeats, 1)))
                is_slow = generator.random((repeats, 1)) < slow_share
                times = levels * np.where(is_slow, 3, 1) * np.exp(0.2 * generator.standard_normal((repeats, 300)))
                if slow_share and not is_slow.any():  # no method can know: the answer states how likely that is
                    unseen += 1
                    continue
                job = Job("any", 1, 100.0, int(1e6 * deadline), 0.99, metric="latency")
                (candidate,) = recommend_settings(round_trips(times[None]), job).candidates
                meets += candidate.fit is Fit.MEETS
                misses += candidate.fit is Fit.MISSES
            seen = samples - unseen
            where = f"{name}, {late:.1%} late, {repeats} repeats"
            bar = MOST_FALSE_MEETS if late > 0.01 else 1.0
            table.rows.append(
                (
                    name,
                    f"{100 * late:g} %",
                    str(repeats),
                    table.at_most(bar, meets, max(1, seen), where),
                    percent(misses, seen),
                    percent(unseen, samples),
                )
            )
    return table


TARGET_PERCENT, MOST_REPEATS = 5.0, 40


def until_table(samples: int) -> Table:
    """Count results of `--until ...:5%`, from three repeats on, that stop within 40, and of these the intervals that contain the truth."""
    results = 60 * samples
    table = Table("until", ("runs vary by", "stop", "mean repeats", "of these hold", "stop with a wrong interval"))
    for spread in (0.01, 0.02, 0.03, 0.05, 0.07, 0.10, 0.12, 0.14, 0.17):
        generator = np.random.default_rng([SEED, int(1000 * spread)])
        logarithms = spread * generator.standard_normal((results, MOST_REPEATS))
        is_open = np.ones(results, np.bool_)
        stopped = held = repeats = 0
        for runs in range(MIN_RUNS, MOST_REPEATS + 1):
            means, deviations = logarithms[:, :runs].mean(axis=1), logarithms[:, :runs].std(axis=1, ddof=1)
            reach = student_quantile((1 + until_confidence(runs)) / 2, runs - 1) / math.sqrt(runs) * deviations
            stops = is_open & (100 * np.sinh(reach) <= TARGET_PERCENT)
            is_open &= ~stops
            stopped, repeats = stopped + int(stops.sum()), repeats + runs * int(stops.sum())
            held += int((np.abs(means[stops]) <= reach[stops]).sum())
        table.rows.append(
            (
                f"{100 * spread:.0f} %",
                percent(stopped, results),
                f"{repeats / stopped:.1f}" if stopped else "-",
                table.at_least(0.95 if stopped >= results / 100 else 0.0, held, max(1, stopped), f"{spread:.0%}"),
                percent(stopped - held, results),
            )
        )
    return table
