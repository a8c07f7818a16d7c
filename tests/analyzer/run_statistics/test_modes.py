"""Two modes: known mixtures, and distributions that have one."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np
import pytest
from drawn_series import autoregressive

from dds_trace.analyzer.run_statistics.bursts import share_inflation
from dds_trace.analyzer.run_statistics.modes import find_modes

GENERATOR = np.random.default_rng(1)
ONE_MODE = {
    "normal": lambda n: GENERATOR.normal(10, 1, n),
    "log-normal": lambda n: np.exp(GENERATOR.standard_normal(n)),
    "exponential": lambda n: GENERATOR.exponential(1, n) + 0.01,
    "pareto": lambda n: GENERATOR.pareto(2, n) + 1,
    "uniform": lambda n: GENERATOR.random(n) + 1,
}


def test_two_modes_are_found_where_they_are():
    values = np.exp(0.15 * GENERATOR.standard_normal(2000))
    values[: 2000 * 3 // 10] *= 4
    found = find_modes(np.sort(values))
    assert found.low == pytest.approx(1, rel=0.1)
    assert found.high == pytest.approx(4, rel=0.1)
    assert found.share == pytest.approx(0.3, abs=0.02)
    assert found.valley < 0.1


@pytest.mark.parametrize("name", ONE_MODE)
@pytest.mark.parametrize("messages", [300, 3000])
def test_one_mode_is_never_two(name, messages):
    found = [find_modes(np.sort(ONE_MODE[name](messages))) for _ in range(200)]
    assert sum(modes is not None for modes in found) <= 1


def test_correlated_messages_make_no_modes():
    runs = np.exp(0.5 * autoregressive(300, 1000, 0.95, seed=2))
    found = [
        find_modes(np.sort(run), share_inflation(np.flatnonzero(run > np.median(run)), 1000)) for run in runs
    ]
    assert sum(modes is not None for modes in found) <= 3


def test_a_few_late_messages_are_a_tail():
    values = np.exp(0.1 * GENERATOR.standard_normal(2000))
    values[:100] *= 10
    assert find_modes(np.sort(values)) is None


def test_ticks_of_a_clock_are_no_modes():
    assert find_modes(np.sort(GENERATOR.integers(1, 4, 5000)) * 1_000_000) is None


def test_few_messages_do_not_tell():
    assert find_modes(np.sort([1.0, 10.0] * 99)) is None
    assert find_modes(np.exp(np.sort(GENERATOR.standard_normal(3000))), inflation=20) is None
    assert find_modes(np.full(1000, 5)) is None


def two_of(values: int, messages: int = 200):
    """Two modes of values that are all different within so many steps, in rising order."""
    steps = np.arange(messages) % (values // 2) / 1000
    return np.sort(np.where(np.arange(messages) % 2, 1 + steps, 3 + steps))


def test_two_hundred_messages_of_thirty_values_can_tell():
    assert find_modes(two_of(30)).share == pytest.approx(0.5)
    assert find_modes(two_of(28)) is None
    assert find_modes(two_of(30)[1:]) is None
    assert find_modes(two_of(30), inflation=1.01) is None
    assert find_modes(two_of(30), inflation=0.5) is not None  # no message counts twice


def with_smaller(share: float, messages: int):
    """Messages of thirty values at 1, and a share of them at 4, in rising order."""
    values = 1 + np.arange(messages) % 30 / 1000
    values[: round(share * messages)] += 3
    return np.sort(values)


def test_a_mode_has_a_tenth_of_the_messages():
    assert [find_modes(with_smaller(share, 2000)).share for share in (0.1, 0.9)] == [0.1, 0.1]
    assert [find_modes(with_smaller(share, 2000)) for share in (0.0995, 0.9005)] == [None, None]


def test_narrow_modes_are_not_smoothed_away():
    # Each mode lies in a single bin. Under the narrowest kernel, half a bin, the peak of 24 messages is 0.79 * 24 = 18.9
    # high, above the 9 that four deviations of chance ask for; under three times that width it would be 6.4.
    found = find_modes(with_smaller(0.12, 200))
    assert (found.share, found.valley) == (0.12, 0.0)


def test_a_shallow_valley_is_none_however_sure():
    # Normal modes d deviations apart have a valley of 2 exp(-d^2 / 8) of their peaks: 0.75 of 2.8, 0.27 of 4, which the
    # kernel, a quarter of their deviation wide, makes 0.30.
    normal = np.array([NormalDist().inv_cdf((place + 0.5) / 20_000) for place in range(20_000)])
    shallow, deep = (
        find_modes(np.exp(0.2 * np.sort(np.concatenate([normal, normal + apart])))) for apart in (2.8, 4.0)
    )
    assert shallow is None
    assert deep.valley == pytest.approx(0.30, abs=0.01)


def test_a_value_that_most_messages_have_leaves_no_width():
    values = np.full(1000, 5.0)
    values[-150:] = 20 + np.arange(150) / 100
    assert find_modes(values) is None


def test_of_two_valleys_the_deeper_one_counts():
    # The second is lower, and less deep below the peak of the third mode.
    normal = np.array([NormalDist().inv_cdf((place + 0.5) / 2000) for place in range(2000)])
    logs = np.concatenate([normal] * 4 + [normal + 4.8] * 5 + [normal[::2] + 9.6] * 2)
    assert find_modes(np.exp(0.2 * np.sort(logs))).share == pytest.approx(0.4, abs=0.01)
