"""Histograms: buckets by hand, and the error of any value."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dds_trace.analyzer.statistics.histogram import RELATIVE_ERROR, histogram_of


def test_histogram_by_hand():
    # Below 2048 ns every value has its own bucket; 4096..4099 share one of width 4.
    histogram = histogram_of(np.array([-3, 0, 1, 5, 5, 2047, 4096, 4099, 4100]))
    assert histogram.value_ns.tolist() == [-3.0, 0.0, 1.0, 5.0, 2047.0, 4097.5, 4101.5]
    assert histogram.count.tolist() == [1, 1, 1, 2, 1, 2, 1]


def test_the_largest_error_is_half_of_the_widest_bucket():
    # An octave has 1024 buckets, of which the first are the widest for their values: 1/1024.
    assert RELATIVE_ERROR == 1 / 2048


def test_histogram_of_nothing():
    assert len(histogram_of(np.empty(0, np.int64)).value_ns) == 0


@given(st.lists(st.integers(-(2**62), 2**62), max_size=200))
def test_histogram_keeps_every_value_within_a_tenth_of_a_percent(values):
    histogram = histogram_of(np.sort(np.array(values, np.int64)))
    assert histogram.count.sum() == len(values)
    assert histogram.value_ns.tolist() == sorted(set(histogram.value_ns.tolist()))
    centres = np.repeat(histogram.value_ns, histogram.count.astype(int))
    for value, centre in zip(sorted(values), centres.tolist(), strict=True):
        assert abs(value - centre) <= 0.0005 * abs(value) + 1e-9
