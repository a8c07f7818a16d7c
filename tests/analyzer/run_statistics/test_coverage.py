from __future__ import annotations

import importlib
import math
from pathlib import Path

import numpy as np
import pytest

from dds_trace.analyzer.statistics.intervals import Basis, Interval

BENCHMARKS = next(folder for folder in Path(__file__).parents if (folder / "benchmarks").is_dir()) / "benchmarks"


@pytest.fixture(scope="module")
def coverage():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHMARKS)
        yield importlib.import_module("coverage_intervals")


@pytest.mark.parametrize(
    "name", ["independent", "AR(1) 0.8", "bursts of 20, 5 %, runs +-5 %", "losses 0.5 %", "outages of 20, 2 %"]
)
def test_truths_are_those_of_the_draws(coverage, name):
    (scenario,) = (scenario for scenario in coverage.SCENARIOS if scenario.name == name)
    values = scenario.draw(np.random.default_rng(1), 400, 2500, is_own_truth=True)
    assert 1 - np.isfinite(values).mean() == pytest.approx(scenario.loss_share, rel=0.1)
    for quantile in (0.5, 0.9, 0.99):
        below = (values <= scenario.truth(quantile)).mean()
        if math.isfinite(scenario.truth(quantile)):
            assert below == pytest.approx(quantile, abs=0.1 * (1 - quantile))


def test_intervals_are_counted_by_their_ends(coverage):
    found = coverage.Intervals()
    for lower, upper in ((1, 3), (3, 4), (None, 3), (None, 1)):
        found.add(Interval(2, lower, upper, 0.95, 9, 9, Basis.BETWEEN_RUNS, 3, 3, 9), truth=2)
    assert (found.samples, found.printed, found.held, found.wrong) == (4, 2, 1, 2)
    assert found.words() == "50 (50, 50)"


def test_a_missed_bar_is_named(coverage):
    scenario = coverage.SCENARIOS[0]
    narrow = coverage.Intervals(samples=1000, printed=1000, held=850, wrong=150)
    good = coverage.Intervals(samples=1000, printed=1000, held=950, wrong=50)
    verdicts = coverage.Verdicts(pairs=1000, false_verdicts=120, false_gates=10)
    cell = coverage.Cell(scenario, 3, 1000, {0.5: narrow, 0.9: good}, coverage.Intervals(), {0.5: verdicts})
    assert list(cell.missed()) == ["p50 held in 85.0%", "p50: 12.0% false verdicts"]


@pytest.mark.parametrize(
    ("name", "messages", "printed", "is_missed"),
    [
        ("independent", 1000, 51, True),  # one sample in twenty has both ends
        ("independent", 1000, 49, False),
        ("bursts of 20, 2 %", 5000, 1000, True),  # five bursts on average: one sample in 150 has none
        ("bursts of 20, 2 %", 4000, 1000, False),
    ],
)
def test_what_cannot_be_known_is_not_asked(coverage, name, messages, printed, is_missed):
    (scenario,) = (scenario for scenario in coverage.SCENARIOS if scenario.name == name)
    wrong = coverage.Intervals(samples=1000, printed=printed, held=printed // 2, wrong=printed - printed // 2)
    cell = coverage.Cell(scenario, 1, messages, {0.99: wrong}, coverage.Intervals(), {})
    assert bool(list(cell.missed())) == is_missed
