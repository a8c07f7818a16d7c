import math
from statistics import NormalDist

import numpy as np
import pytest
from drawn_series import autoregressive

from dds_trace.analyzer.run_statistics.bursts import share_inflation
from dds_trace.analyzer.run_statistics.modes import BLOCKS, Trend, block_medians, find_modes, find_trend

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
    found = [find_modes(np.sort(run), share_inflation(np.flatnonzero(run > np.median(run)), 1000)) for run in runs]
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


def two_of(values, messages=200):
    steps = np.arange(messages) % (values // 2) / 1000
    return np.sort(np.where(np.arange(messages) % 2, 1 + steps, 3 + steps))


def test_two_hundred_messages_of_thirty_values_can_tell():
    assert find_modes(two_of(30)).share == pytest.approx(0.5)
    assert find_modes(two_of(28)) is None
    assert find_modes(two_of(30)[1:]) is None
    assert find_modes(two_of(30), inflation=1.01) is None
    assert find_modes(two_of(30), inflation=0.5) is not None  # no message counts twice


def with_smaller(share, messages):
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


def test_blocks_are_equally_long():
    assert block_medians(np.array([3, 1, 2, 9, 8, 7, 5]), 2).tolist() == [2, 8]
    assert block_medians(np.array([4, 1, 9, 2, 8, 7, 5, 5, 6]), 2).tolist() == [3, 6]  # even: between the middle two


def test_a_straight_line_by_hand():
    # 128 messages in 32 blocks of four, medians 1.5, 5.5 ... plus 100: from 101.5 to 225.5.
    trend = find_trend(100 + np.arange(4 * BLOCKS))
    assert trend.change == pytest.approx(225.5 / 101.5 - 1)
    assert trend.p_value < 1e-4
    assert trend.is_sure(0.5)
    assert not trend.is_sure(1.5)
    fall = find_trend(300 - np.arange(4 * BLOCKS))
    assert fall.change == pytest.approx(174.5 / 298.5 - 1)
    assert fall.is_sure()


def test_short_and_constant_runs():
    assert find_trend(np.ones(4 * BLOCKS - 1)) is None
    constant = find_trend(np.full(1000, 7))
    assert (constant.change, constant.p_value, constant.is_sure()) == (0.0, 1.0, False)


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.8, 0.95])
@pytest.mark.parametrize("messages", [300, 1000])
def test_runs_without_a_trend_rarely_have_one(correlation, messages):
    runs = np.exp(0.5 * autoregressive(600, messages, correlation, seed=1))
    assert np.mean([find_trend(run).is_sure() for run in runs]) <= 0.01


def test_a_rise_is_found():
    rise = np.exp(np.linspace(0, 0.5, 1000))
    found = [find_trend(rise * np.exp(0.5 * run)) for run in autoregressive(200, 1000, 0.0, seed=2)]
    assert np.mean([trend.is_sure(0.1) for trend in found]) >= 0.9
    assert np.median([trend.change for trend in found]) == pytest.approx(np.exp(0.5) - 1, rel=0.1)


def test_a_burst_is_no_trend():
    values = np.exp(0.3 * np.random.default_rng(3).standard_normal(1000))
    values[900:960] *= 10
    assert not find_trend(values).is_sure()


def test_what_is_sure_begins_at_its_limits():
    assert Trend(-0.1, 0.001).is_sure(0.1)
    assert Trend(0.0, 0.0).is_sure()
    assert not Trend(0.1, 0.001).is_sure(0.101)
    assert not Trend(0.1, 0.00101).is_sure()


def test_a_single_rise_is_less_than_chance_makes():
    # Equal blocks but the last: 31 of 496 pairs rise, 30 after the step of two; variance 32 31 69 / 18 = 3802.7.
    values = np.ones(4 * BLOCKS)
    values[-4:] = 2
    trend = find_trend(values)
    assert trend.p_value == pytest.approx(math.erfc(30 / math.sqrt(2 * 3802 + 4 / 3)), rel=0.2)
    assert trend.change == 0.0


@pytest.mark.parametrize(("raised", "correlation"), [(8.2e-9, 0.0), (8.3e-9, 0.95)])
def test_what_is_below_a_billionth_of_the_level_is_no_correlation(raised, correlation):
    # A line from 1 to 32, at 16.5 in its middle, of which half a billionth is 8.25e-9. Sixteen neighbours of the 32 blocks
    # are raised: 29 pairs of neighbours are alike and two are not, 27 / 32 + (1 + 3 * 27 / 32) / 32 = 0.954, at most 0.95.
    medians = np.arange(1.0, BLOCKS + 1)
    medians[8:24] += raised
    # All 496 pairs rise; 495 after the step of two.
    variance = BLOCKS * (BLOCKS - 1) * (2 * BLOCKS + 5) / 18 * (1 + correlation) / (1 - correlation)
    expected = math.erfc(495 / math.sqrt(2 * variance))
    assert find_trend(np.repeat(medians, 4)).p_value == pytest.approx(expected, rel=1e-6)
