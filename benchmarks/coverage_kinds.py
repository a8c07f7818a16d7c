"""How often verdicts err where runs come in kinds: two modes, a slow one in ten, skewed levels, passes that depend on each other."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from coverage_campaigns import SPREAD, kinds_of
from simulated import LOSSES, SEED, Table, estimate_of, percent

from dds_trace.analyzer.run_statistics.change import Verdict, change_of_estimates, least_variances
from dds_trace.analyzer.run_statistics.received import late_share, loss_excesses
from dds_trace.analyzer.run_statistics.runs import Run, Runs
from dds_trace.analyzer.run_statistics.setups import DEPENDENT_UP_TO
from dds_trace.analyzer.statistics.power import benjamini_hochberg_adjusted
from dds_trace.analyzer.verdicts.judgements import LOSSY_SHARE, Reason
from dds_trace.analyzer.verdicts.ranking import rank_setups

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray
    from simulated import DrawLosses

    Float64 = NDArray[np.float64]
    Draw = Callable[[np.random.Generator, tuple[int, int, int]], Float64]

MOST_FALSE_LEADERS, MOST_FALSE_ADVICE, MOST_FALSE_MEETS, MOST_FALSE_CHANGES = 0.06, 0.05, 0.07, 0.06
LEAST_ADVICE = 0.80


def two_modes(generator: np.random.Generator, shape: tuple[int, int, int], noise: float, ratio: float = 1.5) -> Float64:
    """Draw the logarithms of runs, half of which take `ratio` times as long; shape (kinds, setups, repeats)."""
    return noise * generator.standard_normal(shape) + math.log(ratio) * (generator.random(shape) < 0.5)


def one_in_ten(generator: np.random.Generator, shape: tuple[int, int, int]) -> Float64:
    """Draw runs that vary by 5 %, one in ten of which takes 3 times as long."""
    return 0.05 * generator.standard_normal(shape) + math.log(3) * (generator.random(shape) < 0.1)


def skewed(generator: np.random.Generator, shape: tuple[int, int, int]) -> Float64:
    """Draw runs whose logarithms are exponential."""
    return SPREAD * generator.exponential(size=shape)


def correlated(generator: np.random.Generator, shape: tuple[int, int, int], correlation: float = 0.8) -> Float64:
    """Draw runs that correlate with the run of the same setup and kind in the pass before."""
    values = generator.standard_normal(shape)
    for number in range(1, shape[-1]):
        values[..., number] *= math.sqrt(1 - correlation**2)
        values[..., number] += correlation * values[..., number - 1]
    return SPREAD * values


def walk(generator: np.random.Generator, shape: tuple[int, int, int]) -> Float64:
    """Draw runs that each setup and kind moves by 5 % from pass to pass, and that vary by 1 %."""
    return 0.05 * np.cumsum(generator.standard_normal(shape), axis=-1) + 0.01 * generator.standard_normal(shape)


KINDS: dict[str, Draw] = {
    "two modes, 1 and 1.5, each +-1 %": partial(two_modes, noise=0.01),
    "two modes, 1 and 1.5, each +-5 %": partial(two_modes, noise=0.05),
    "one run in ten 3 times": one_in_ten,
    "levels skewed to the right": skewed,
}


def together(generator: np.random.Generator, shape: tuple[int, int, int], draw: Draw) -> Float64:
    """Draw runs whose kinds all move as the one of their setup and pass."""
    return draw(generator, (1, *shape[1:])) + 0.01 * generator.standard_normal(shape)


DEPENDENT: dict[str, Draw] = {
    "correlation 0.8 from pass to pass": correlated,
    "a walk of 5 % a pass": walk,
    "correlation 0.8, all sizes together": partial(together, draw=correlated),
}


def kinds_table(samples: int) -> Table:
    """Count campaigns of equal setups in which any of them is called the fastest, at the median or at p99."""
    counts = (1, 6, 12)
    table = Table("leaders-kinds", ("runs", "repeats", "setups", *(f"kinds: {kinds}" for kinds in counts)))
    for name, draw in KINDS.items():
        for repeats in (3, 5):
            for setups in (2, 3):
                cells = []
                for kinds in counts:
                    false, _ = _led(samples, draw, (kinds, setups, repeats))
                    where = f"{name}, {repeats} repeats, {setups} setups, {kinds} kinds"
                    cells.append(table.at_most(MOST_FALSE_LEADERS, false, samples, where))
                table.rows.append((name, str(repeats), str(setups), *cells))
    return table


def dependent_table(samples: int) -> Table:
    """Count campaigns of equal setups whose dependent passes are seen, and those in which a setup is called the fastest."""
    table = Table("leaders-dependent", ("passes", "repeats", "setups", "kinds", "seen", "called the fastest"))
    for name, draw in DEPENDENT.items():
        for repeats in (3, 5):
            for setups in (2, 3):
                for kinds in (1, 6, 12):
                    false, seen = _led(samples, draw, (kinds, setups, repeats))
                    bar = (
                        MOST_FALSE_LEADERS if kinds > 1 else 1.0
                    )  # few passes of one kind look the same as a true lead
                    said = table.at_most(
                        bar, false, samples, f"{name}, {repeats} repeats, {setups} setups, {kinds} kinds"
                    )
                    table.rows.append((name, str(repeats), str(setups), str(kinds), percent(seen, samples), said))
    return table


BEST = ((3, 2, 2.0), (3, 3, 2.0), (5, 2, 1.3), (5, 6, 1.5), (5, 6, 2.0))
"""Repeats, setups, how many times as long all but one take; independent runs of one kind vary by `SPREAD`."""


def best_table(samples: int) -> Table:
    """Find how often the best test there is calls the one faster setup of one kind, if at most 6 % of equal ones with dependent passes may be.

    The last columns are how often the best test sees that passes depend, if 5 % of independent ones may be taken for such.
    """
    seen = (f"seen, {name}" for name in COVARIANCES)
    table = Table("leaders-best", ("repeats", "setups", "the others take", *COVARIANCES, *seen))
    for repeats, setups, ratio in BEST:
        covariances = [of(repeats) for of in COVARIANCES.values()]
        shares = [best_power(covariance, setups, ratio, 40 * samples) for covariance in covariances]
        shares += [best_sight(covariance, setups, 40 * samples) for covariance in covariances]
        cells = (f"{100 * share:.1f}" for share in shares)
        table.rows.append((str(repeats), str(setups), f"{ratio:g} x", *cells))
    return table


def best_sight(covariance: Float64, setups: int, draws: int) -> float:
    """Return the power of Neyman and Pearson's test of passes that depend, which knows how: by what the setups' means and a unit leave."""
    generator = np.random.default_rng([SEED, setups, len(covariance)])
    repeats = len(covariance)
    basis = np.linalg.svd(np.eye(repeats) - 1 / repeats)[2][:-1]
    dependent = basis @ covariance @ basis.T
    equal, drawn = generator.standard_normal((2, draws, setups, repeats - 1))
    of_equal, of_drawn = (
        np.einsum("ijk,kl,ijl->i", side, np.linalg.inv(dependent), side) / np.square(side).sum(axis=(1, 2))
        for side in (equal, drawn @ np.linalg.cholesky(dependent).T)
    )
    return float((of_drawn < np.quantile(of_equal, DEPENDENT_UP_TO)).mean())


def _places(repeats: int) -> NDArray[np.intp]:
    return np.arange(1, repeats + 1)


COVARIANCES: dict[str, Callable[[int], Float64]] = {
    "correlation 0.8 from pass to pass": lambda repeats: 0.8 ** np.abs(np.subtract.outer(*[_places(repeats)] * 2)),
    "a walk of 5 % a pass": lambda repeats: (
        0.05**2 * np.minimum.outer(*[_places(repeats)] * 2) + 0.01**2 * np.eye(repeats)
    ),
}


def best_power(covariance: Float64, setups: int, ratio: float, draws: int) -> float:
    """Return the power of Neyman and Pearson's test of the campaign's shape: what its common level and its unit leave (invariance).

    It knows how the passes depend, the true lead in units of the spread, and which setup to ask for; no other test that does not know
    the spread finds more.
    """
    generator = np.random.default_rng([SEED, setups, len(covariance)])
    repeats = len(covariance)
    free = setups * repeats - 1
    basis = np.linalg.svd(np.eye(free + 1) - 1 / (free + 1))[2][:free]
    dependent = basis @ np.kron(np.eye(setups), covariance) @ basis.T
    lead = basis @ np.repeat(np.arange(setups) > 0, repeats) * math.log(ratio) / SPREAD
    lengths = np.linspace(0.001, 40, 800)

    def ratios(drawn: Float64) -> Float64:
        units = drawn / np.linalg.norm(drawn, axis=1, keepdims=True)
        along = (free - 1) * np.log(lengths) - lengths**2 / 2 + (units @ lead)[:, None] * lengths
        most = along.max(axis=1)
        faster = most + np.log(np.exp(along - most[:, None]).sum(axis=1))
        return np.asarray(faster + free / 2 * np.log(np.einsum("ij,jk,ik->i", units, np.linalg.inv(dependent), units)))

    equal, faster = generator.standard_normal((2, draws, free))
    equal = equal @ np.linalg.cholesky(dependent).T
    of_equal, of_faster = (
        np.concatenate([ratios(part) for part in np.array_split(side, 1 + draws // 1000)])
        for side in (equal, faster + lead)
    )
    return float((of_faster > np.quantile(of_equal, 1 - MOST_FALSE_LEADERS / setups)).mean())


def _led(samples: int, draw: Draw, shape: tuple[int, int, int]) -> tuple[int, int]:
    generator = np.random.default_rng([SEED, *shape])
    led = dependent = 0
    for _ in range(samples):
        median = draw(generator, shape)
        tail = 0.7 * median + math.sqrt(1 - 0.7**2) * draw(generator, shape)
        rankings = [ranking for of_kind in rank_setups(kinds_of(median, tail)) for ranking in of_kind.values()]
        led += any(ranking.leader for ranking in rankings)
        dependent += any(ranking.lead.reason == Reason.DEPENDENT.value for ranking in rankings)
    return led, dependent


def changes_table(samples: int) -> Table:
    """Count comparisons of equal sides with twelve groups, in which a median is called slower or faster."""
    table = Table("comparisons-kinds", ("runs", "runs a side", "measured in turns", "independent"))
    near_modes = partial(two_modes, noise=0.05, ratio=1.3)
    for name, draw in {**KINDS, "two modes, 1 and 1.3, each +-5 %": near_modes}.items():
        for runs in (3, 5):
            cells = []
            for is_paired in (True, False):
                generator = np.random.default_rng([SEED, runs, is_paired])
                false = sum(_is_called(np.exp(draw(generator, (12, 2, runs))), is_paired) for _ in range(samples))
                cells.append(table.at_most(MOST_FALSE_CHANGES, false, samples, f"{name}, {runs} runs, {is_paired}"))
            table.rows.append((name, str(runs), *cells))
    return table


def _is_called(values: Float64, is_paired: bool) -> bool:
    passes = (range(values.shape[-1]),) * 2 if is_paired else None
    sides = [(estimate_of(base), estimate_of(new), passes) for base, new in values]
    least = least_variances(sides)
    changes = [change_of_estimates(base, new, paired, least=least) for base, new, paired in sides]
    adjusted = benjamini_hochberg_adjusted([change.p_value or 0.0 for change in changes]).tolist()
    called = {Verdict.BETTER, Verdict.WORSE}
    return any(p <= 0.05 and change.verdict(0.05) in called for p, change in zip(adjusted, changes, strict=True))


def advice_table(samples: int) -> Table:
    """Count campaigns in which a setup is advised against that loses 1 %, and setups that lose 3 % and are advised against."""
    counts = (1, 6, 20)
    columns = (*(f"1 %, results: {results}" for results in counts), "3 %, of two setups", "3 %, of twelve")
    table = Table("advice", ("losses, 3 x 1000", *columns))
    for name, draw in LOSSES.items():
        generator = np.random.default_rng([SEED, 3])
        cells = []
        for results in counts:
            wrong = sum(any(_advised(draw, generator, [0.01] * 2 * results)) for _ in range(samples))
            cells.append(table.at_most(MOST_FALSE_ADVICE, wrong, samples, f"{name}, {results} results"))
        for setups in (2, 12):
            right = sum(_advised(draw, generator, [0.03, *[0.001] * (setups - 1)])[0] for _ in range(samples))
            bar = LEAST_ADVICE if name == "single losses" else 0.0
            cells.append(table.at_least(bar, right, samples, f"{name}, {setups} setups"))
        table.rows.append((name, *cells))
    return table


def _advised(draw: DrawLosses, generator: np.random.Generator, shares: list[float]) -> list[bool]:
    groups = [list(~draw(generator, 3, 1000, share)) for share in shares]
    return [one.is_sure() for one in loss_excesses(groups, LOSSY_SHARE)]


LEVELS: dict[str, Callable[[np.random.Generator, int], Float64]] = {
    "levels skewed, 0.1": lambda generator, runs: 0.1 * generator.exponential(size=runs),
    "levels skewed, 0.2": lambda generator, runs: 0.2 * generator.exponential(size=runs),
    "levels skewed, 0.5": lambda generator, runs: 0.5 * generator.exponential(size=runs),
    "levels with t of 3 degrees, 15 %": lambda generator, runs: 0.15 * generator.standard_t(3, runs) / math.sqrt(3),
    "one run in ten 3 times, all campaigns": lambda generator, runs: math.log(3) * (generator.random(runs) < 0.1),
}
LATE, MESSAGES = 0.02, 300


def late_table(samples: int) -> Table:
    """Count settings of which 2 % are late in the long run that are said to meet 99 %; the last row has no bar: no run shows what it lacks."""
    counts = (3, 5, 10, 20)
    table = Table("deadlines-kinds", ("levels of runs", *(f"runs: {runs}" for runs in counts)))
    for name, draw in LEVELS.items():
        generator = np.random.default_rng([SEED, 1])
        long_run = draw(generator, 200_000) + 0.2 * generator.standard_normal(200_000)
        deadline = 1e6 * math.exp(float(np.quantile(long_run, 1 - LATE)))
        campaigns = 14 * samples if "skewed" in name else samples  # these are near the bar
        cells = []
        for runs in counts:
            generator = np.random.default_rng([SEED, runs])
            meets = 0
            for _ in range(campaigns):
                logs = draw(generator, runs)[:, None] + 0.2 * generator.standard_normal((runs, MESSAGES))
                late = late_share(Runs.of([Run(values) for values in 1e6 * np.exp(logs)]), deadline)
                meets += late is not None and late.upper is not None and late.upper <= 0.01
            bar = 1.0 if name.endswith("all campaigns") else MOST_FALSE_MEETS
            cells.append(table.at_most(bar, meets, campaigns, f"{name}, {runs} runs"))
        table.rows.append((name, *cells))
    return table


BURSTS = ((LATE, 5), (LATE, 15), (LATE, 30), (0.001, 1), (0.001, 5), (0.001, 15), (0.0, 1))
"""Share lost in the long run, and messages of a burst (geometric, as by E. N. Gilbert, 1960)."""


def count_bursts(
    generator: np.random.Generator, runs: int, burst: int, share: float, campaigns: int
) -> tuple[int, int]:
    """Return of settings that lose messages in bursts how many are said to meet 99 %, and how many of these lost nothing yet."""
    meets = unseen = 0
    for _ in range(campaigns):
        lost = np.zeros((runs, MESSAGES), np.bool_)
        now = generator.random(runs) < share
        for message in range(MESSAGES):
            lost[:, message] = now
            now = np.where(
                now, generator.random(runs) > 1 / burst, generator.random(runs) < share / (1 - share) / burst
            )
        levels = 0.05 * generator.standard_normal((runs, 1))
        times = 1e6 * np.exp(levels + 0.3 * generator.standard_normal((runs, MESSAGES)))
        late = late_share(Runs.of([Run(values) for values in np.where(lost, np.inf, times)]), 1e9)
        is_said = late is not None and late.observed <= 0.01 and late.upper is not None and late.upper <= 0.01
        meets += is_said
        unseen += is_said and not lost.any()
    return meets, unseen


def bursts_table(samples: int) -> Table:
    """Count settings that lose in bursts and are said to meet 99 %: of 2 % lost those of which a burst was seen have a bar."""
    counts = (3, 5, 10, 20)
    table = Table(
        "deadlines-bursts", ("lost", "bursts of", *(f"runs: {runs}" for runs in counts), "10 runs without any")
    )
    for share, burst in BURSTS:
        cells, without = [], ""
        for runs in counts:
            generator = np.random.default_rng([SEED, runs, burst, int(1000 * share)])
            meets, unseen = count_bursts(generator, runs, burst, share, samples)
            bar = MOST_FALSE_MEETS if share == LATE else 1.0
            table.at_most(bar, meets - unseen, samples, f"{share:.1%} in bursts of {burst}, {runs} runs")
            cells.append(percent(meets, samples))
            without = percent(unseen, samples) if runs == 10 else without
        table.rows.append((f"{100 * share:g} %", str(burst), *cells, without))
    return table
