"""What each detector and each building block of the statistics says of short drawn series: see `pinned.py`."""

from typing import Any

import numpy as np
from drawn_series import autoregressive

from dds_trace.analyzer.run_statistics.bursts import (
    cells_of,
    equal_episodes,
    independent_squares,
    long_run_variance,
    share_inflation,
    share_inflations,
)
from dds_trace.analyzer.run_statistics.modes import find_modes, find_trend, find_warm_up
from dds_trace.analyzer.run_statistics.received import late_share, loss_excesses, received_interval
from dds_trace.analyzer.run_statistics.runs import MEAN, Run, Runs, Statistic
from dds_trace.analyzer.run_statistics.setups import (
    RunLogarithms,
    campaign_variance,
    overlap_in_time,
    passes_depend,
    residuals_by_setup,
    setup_means,
)
from dds_trace.analyzer.run_statistics.spread import spread_of_runs
from dds_trace.analyzer.run_statistics.tails import bursts_to_count, episodes_of, tails_of_all
from dds_trace.analyzer.run_statistics.two_samples import fieller_ends, paired_test, welch_test
from dds_trace.analyzer.statistics.percentiles import order_statistic_ranks


def modes() -> list[Any]:
    """Mixtures of many shapes: how far apart, how many messages, how large the smaller mode, how dependent."""
    found = []
    for seed in range(40):
        draw = np.random.default_rng([1, seed])
        messages, apart = int(draw.integers(180, 900)), float(draw.uniform(1.4, 6))
        is_slow = draw.random(messages) < draw.uniform(0.08, 0.92)
        values = np.exp(draw.uniform(0.1, 0.35) * draw.standard_normal(messages)) * np.where(is_slow, apart, 1)
        found.append(find_modes(np.sort(values), float(draw.choice([0.5, 1.0, 1.0, 1.6]))))
    return found


def warm_ups() -> list[Any]:
    """Begins that are slow or fast, short or long, at once or falling off."""
    found = []
    for seed, run in enumerate(np.exp(0.3 * autoregressive(40, 503, 0.3, seed=2))):
        draw = np.random.default_rng([2, seed])
        messages, length, level = (int(draw.integers(198, 504)), int(draw.integers(0, 90)), draw.uniform(0.4, 4))
        place = np.arange(messages)
        begin = np.where(place < length, level, 1) if seed % 2 else 1 + (level - 1) * np.exp(-place / (length + 1))
        found.append(find_warm_up(begin * run[:messages]))
    return found


def trends() -> list[Any]:
    return [
        find_trend(np.exp(0.4 * run[: 120 + 9 * seed] + 0.08 * (seed - 20) * np.linspace(0, 1, 120 + 9 * seed)))
        for seed, run in enumerate(autoregressive(41, 500, 0.7, seed=3))
    ]


def losses() -> list[Any]:
    """Runs that lost some or most of their messages, singly or in outages, alike or unlike."""
    found = []
    for seed in range(40):
        draw = np.random.default_rng([4, seed])
        runs = [
            draw.random(int(draw.integers(20, 300))) > draw.choice([0, 0.02, 0.3, 0.8]) for _ in range(1 + seed % 5)
        ]
        if seed % 3 == 0:
            runs[0][5 : 5 + int(draw.integers(1, 15))] = False
        found.append(received_interval(runs, float(draw.choice([0.95, 0.8]))))
    return found


def _groups() -> list[list[Run]]:
    """Runs with bursts and losses; some know when each message was sent, of some a level is not above zero."""
    groups = []
    for seed in range(30):
        draw = np.random.default_rng([5, seed])
        runs = []
        for _ in range(1 + seed % 4):
            messages = int(draw.integers(30, 500))
            values = np.exp(0.5 * draw.standard_normal(messages)) - (1.2 if seed % 7 == 6 else 0)
            for begin in draw.integers(0, messages, int(draw.integers(0, 4))):
                values[begin : begin + int(draw.integers(2, 15))] *= 8
            if seed % 5 == 4:
                values[draw.random(messages) < 0.02] = np.inf
            if seed % 6 == 5:
                values = np.ceil(values * 4) / 4
            sent_ns = np.cumsum(draw.integers(1, 40, messages)) * 250_000
            runs.append(Run(values, sent_ns if seed % 2 else None))
        groups.append(runs)
    return groups


def tails() -> list[Any]:
    found: list[Any] = []
    for runs in _groups():
        for quantile in (0.02, 0.4, 0.5, 0.9, 0.97, 0.99):
            (of_runs,) = tails_of_all([(Runs.of(runs), [quantile])])[0]
            found.append(
                [
                    episodes_of(of_runs),
                    [
                        [each.messages, each.sizes.tolist(), each.inflation, each.squares, each.streaks, each.bursts]
                        for each in of_runs
                    ],
                ]
            )
    return found


def spreads() -> list[Any]:
    return [
        spread_of_runs(runs, one)
        for runs in _groups()
        for one in (MEAN, Statistic(0.1), Statistic(0.5), Statistic(0.9), Statistic(0.99))
    ]


def dependence() -> list[Any]:
    """Variances of means and of shares, alone and several series together, of few messages and of more than there are cells."""
    found: list[Any] = []
    for seed, (messages, correlation) in enumerate(((24, 0.0), (25, 0.5), (300, 0.9), (1024, 0.2), (1500, 0.8))):
        (run,) = autoregressive(1, messages, correlation, seed=[6, seed])
        events = np.flatnonzero(run > 0.8)
        found += [long_run_variance(run), share_inflation(events, messages)]
        joined = np.concatenate([events, messages + np.flatnonzero(run < -1)])
        edges = np.array([0, len(events), len(joined)])
        cells = cells_of([messages, messages])
        found += share_inflations(cells, cells.counts(joined), edges[None, :])
    found += [independent_squares(events, 500, gap) for events, gap in ((1, 25.9), (40, 4.0), (40, 6.25), (499, 1.5))]
    found += [
        equal_episodes(n * (n - 1) // 2, (np.arange(1, n) ** 2 / np.linspace(1, 2, n - 1)).sum()) for n in (2, 7, 30)
    ]
    return found


def bursts() -> list[Any]:
    """Rows of messages beyond a level, of chance and of bursts that hold a part of the tail."""
    found = []
    for seed in range(60):
        draw = np.random.default_rng([7, seed])
        messages, below, beyond = 1000, [], []
        for _ in range(1 + seed % 2):
            marked = draw.random(messages) < draw.uniform(0.03, 0.12)
            for begin in draw.integers(0, messages, int(draw.integers(1, 11))):
                marked[begin : begin + int(draw.integers(4, 16))] = True
            places = np.flatnonzero(marked)
            below.append(places.astype(float))
            beyond.append(places[draw.random(len(places)) < 0.2].astype(float))
        found.append(bursts_to_count(below, beyond, messages * len(below)))
    return found


def samples() -> list[Any]:
    found: list[Any] = []
    for seed in range(20):
        draw = np.random.default_rng([8, seed])
        above, below = (draw.lognormal(0, draw.uniform(0.05, 1.5), int(draw.integers(3, 9))) for _ in range(2))
        below = np.where(draw.random(len(below)) < 0.2, 0, below)
        test = welch_test(above, below)
        found += [test, test.p_value, test.reach(0.9), fieller_ends(above, below, test, 0.95)]
        found.append(paired_test(above[:3], below[:3]).p_value)
    sizes = (1, 7, 60, 368, 5000)
    return found + [order_statistic_ranks(n, q, c) for n in sizes for q in (0.1, 0.5, 0.99) for c in (0.8, 0.95)]


def excesses() -> list[Any]:
    """Groups of no, one, few or many runs, which lost none, some or all of their messages."""
    found: list[Any] = []
    for seed in range(30):
        draw, groups = np.random.default_rng([9, seed]), []
        for _ in range(1 + seed % 4):
            lost = draw.choice([0, 0.01, 0.1, 1.0], int(draw.integers(0, 7)))
            groups.append([draw.random(int(draw.integers(1, 400))) >= share for share in lost])
            for run in groups[-1][1:]:
                run[: int(draw.integers(0, 30))] = False
        of_groups = loss_excesses(groups, float(draw.choice([0.001, 0.02, 0.3])), 0.9)
        found += [of_groups, [one.share for one in of_groups]]
    return found


def late() -> list[Any]:
    """Runs of unlike levels, whose slow messages or whose quick ones lie far from the others."""
    found = []
    for seed in range(30):
        draw = np.random.default_rng([10, seed])
        levels, away = draw.normal(0, 0.2, 2 + seed % 5), 0.3 * (-1) ** seed
        runs = [Run(1e6 * np.exp(level + away * draw.exponential(size=int(draw.integers(1, 200))))) for level in levels]
        found.append(late_share(Runs(tuple(runs)), 1e6 * np.exp(draw.normal(0, 0.6)), 0.9))
    return found


def setups() -> list[Any]:
    """Repeats of one to three kinds that drift or not, together or not, of some setups with unlike spreads or none."""
    found: list[Any] = []
    for seed in range(120):
        draw = np.random.default_rng([11, seed])
        kinds, repeats = 1 + seed % 3, draw.integers(3, 9, 2)
        runs = {}
        for setup, count in zip("ab", (repeats[0], repeats[seed % 2]), strict=True):
            common = draw.standard_normal(count)
            common = np.cumsum(common) if seed % 5 == 0 else common
            for kind in range(kinds):
                own = draw.uniform(0.1, 1) * common + draw.choice([0.1, 1, 1]) * draw.standard_normal(count)
                runs[kind, setup] = RunLogarithms(own * (seed % 13 != kind), tuple(range(count)))
        starts = [draw.integers(0, 20, draw.integers(0, 5)) for _ in range(2)]
        residuals = [rows for _, rows in residuals_by_setup(runs).values()]
        found += [list(setup_means(runs).values()), passes_depend(runs), campaign_variance(residuals)]
        found.append(overlap_in_time(*starts))
    return found


SERIES = {
    each.__name__: each
    for each in (modes, warm_ups, trends, losses, tails, spreads, dependence, bursts, samples, excesses, late, setups)
}
