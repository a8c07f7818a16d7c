import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dds_trace.analyzer.groups.freshness import age_of_information


def age(made, received):
    rows = pl.DataFrame(
        {"planned_ns": made, "receive_ns": received}, dict.fromkeys(("planned_ns", "receive_ns"), pl.Int64)
    )
    ages = age_of_information(rows.with_columns(exchange=0), "receive_ns").collect().to_dicts()
    return ages[0] if ages else None


def test_age_is_a_saw_tooth():
    #  made      0    10        30
    #  received     4    12          38
    #  age at reception 4, 2, 8; just before the next one 12 and 28.
    #  time average over 4..38: (4+12)/2*8 + (2+28)/2*26 = 64 + 390 = 454, over 34.
    saw = age([0, 10, 30], [4, 12, 38])
    assert saw["mean_ns"] == pytest.approx(454 / 34)
    assert saw["peak_mean_ns"] == 20.0
    assert (saw["peak_max_ns"], saw["updates"]) == (28, 3)


def test_a_late_older_message_is_no_news():
    assert age([0, 10, 5, 30], [4, 12, 20, 38]) == age([0, 10, 30], [4, 12, 38])


def test_two_at_one_instant_are_one_update():
    assert age([0, 5, 10], [4, 12, 12]) == age([0, 10], [4, 12])


def test_one_update_has_no_age_over_time():
    assert age([1], [2]) is None
    assert age([], []) is None


@given(gaps=st.lists(st.integers(1, 1000), min_size=2, max_size=30), delay=st.integers(0, 5000))
@settings(deadline=None)
def test_a_constant_delay_adds_to_the_mean_age(gaps, delay):
    made = np.cumsum(np.array(gaps, np.int64))
    without, delayed = age(made, made), age(made, made + delay)
    assert delayed["mean_ns"] == pytest.approx(without["mean_ns"] + delay)
    assert delayed["peak_max_ns"] == max(gaps[1:]) + delay
