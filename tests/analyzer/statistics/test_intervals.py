from __future__ import annotations

import math

import pytest

from dds_trace.analyzer.statistics.intervals import MIN_EPISODES, ranges_overlap, without_open_end


@pytest.mark.parametrize(
    ("one", "other", "do_overlap"),
    [
        ((1.0, 2.0), (1.5, 3.0), True),
        ((1.0, 2.0), (2.0, 3.0), True),  # one value in common
        ((1.0, 2.0), (2.001, 3.0), False),
        ((1.0, None), (2.0, 3.0), True),
        ((4.0, None), (2.0, 3.0), False),
        ((None, 2.0), (-9.0, 1.0), True),
        ((None, 2.0), (3.0, 4.0), False),
        ((None, 2.0), (1.0, None), True),
        ((None, None), (None, None), True),
    ],
)
def test_ranges_overlap_where_they_have_a_value_in_common(one, other, do_overlap):
    assert ranges_overlap(one, other) is do_overlap
    assert ranges_overlap(other, one) is do_overlap


def test_the_end_beyond_a_tail_of_few_episodes_is_open():
    few = MIN_EPISODES - 1
    assert MIN_EPISODES == 10
    assert without_open_end(1.0, 2.0, 0.99, few) == (1.0, None)
    assert without_open_end(1.0, 2.0, 0.5, few) == (1.0, None)  # the median's tail lies above
    assert without_open_end(1.0, 2.0, 0.49, few) == (None, 2.0)
    assert without_open_end(1.0, 2.0, 0.99, few + 1) == (1.0, 2.0)
    assert without_open_end(1.0, 2.0, 0.99, None) == (1.0, 2.0)
    assert without_open_end(math.inf, math.inf, 0.99, few) == (math.inf, math.inf)
