"""Adjusted p values: by hand, and what they promise by drawing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dds_trace.analyzer.statistics.power import benjamini_hochberg_adjusted, holm_adjusted

p_values = st.lists(st.floats(0, 1), max_size=20)


def test_holm_by_hand():
    # Rising 0.01, 0.02, 0.03, 0.2: times 4, 3, 2, 1 = 0.04, 0.06, 0.06, 0.2.
    assert holm_adjusted([0.03, 0.01, 0.2, 0.02]).tolist() == pytest.approx([0.06, 0.04, 0.2, 0.06])


def test_benjamini_and_hochberg_by_hand():
    # Rising 0.01, 0.02, 0.03, 0.2: times 4/1, 4/2, 4/3, 1 = 0.04, 0.04, 0.04, 0.2.
    assert benjamini_hochberg_adjusted([0.03, 0.01, 0.2, 0.02]).tolist() == pytest.approx(
        [0.04, 0.04, 0.2, 0.04]
    )


@pytest.mark.parametrize("adjust", [holm_adjusted, benjamini_hochberg_adjusted])
@given(values=p_values)
def test_adjusting_keeps_the_order_and_never_lowers(adjust, values):
    found = adjust(values)
    assert len(found) == len(values)
    assert all(found >= np.array(values) - 1e-15)
    assert all(found <= 1)
    order = np.argsort(values, kind="stable")
    assert (np.diff(found[order]) >= 0).all()


@given(values=p_values)
def test_holm_is_the_stricter(values):
    assert all(holm_adjusted(values) >= benjamini_hochberg_adjusted(values) - 1e-15)


def test_twenty_equal_groups_give_one_false_alarm_in_twenty_families():
    draws = np.random.default_rng(1).random((2000, 20))
    alarms = [(holm_adjusted(draw) <= 0.05).any() for draw in draws]
    assert np.mean(alarms) == pytest.approx(0.05, abs=0.015)


def test_a_twentieth_of_the_alarms_is_false():
    draws = np.random.default_rng(2).random((2000, 20))
    draws[:, :10] *= 1e-3  # ten true differences
    false = [
        (found[10:].sum() / max(1, found.sum()))
        for found in (benjamini_hochberg_adjusted(draw) <= 0.05 for draw in draws)
    ]
    assert np.mean(false) <= 0.05
