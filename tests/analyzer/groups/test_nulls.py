from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from dds_trace.analyzer.groups.batch import filled, is_present, present

COLUMNS = {
    "no null": ([1, 2, 3], [1, 2, 3], [1, 2, 3], [True, True, True]),
    "some nulls": ([1, None, 3], [1, 0, 3], [1, 3], [True, False, True]),
    "nulls alone": ([None, None], [0, 0], [], [False, False]),
    "empty": ([], [], [], []),
}


@pytest.mark.parametrize(("values", "with_zeros", "without", "mask"), COLUMNS.values(), ids=COLUMNS)
def test_a_column_as_arrays(values, with_zeros, without, mask):
    column = pl.Series("latency_ns", values, pl.Int64)
    assert filled(column).dtype == present(column).dtype == np.int64
    assert is_present(column).dtype == np.bool_
    assert filled(column).tolist() == with_zeros
    assert present(column).tolist() == without
    assert is_present(column).tolist() == mask


def test_another_number_in_place_of_null():
    assert filled(pl.Series([None, 5], dtype=pl.Int64), -1).tolist() == [-1, 5]


def test_a_column_without_nulls_is_not_copied():
    column = pl.Series(np.arange(5))
    assert np.shares_memory(filled(column), present(column))
