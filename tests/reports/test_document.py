from __future__ import annotations

import json
import math

import polars as pl

from dds_trace.reports.document import _lines

TABLE = pl.DataFrame(
    {
        "run_id": pl.Series([2**64 - 1, 7], dtype=pl.UInt64),
        "count": pl.Series([None, -3], dtype=pl.Int64),
        "mean_ns": [0.1, 1e300],
        "worst_ns": [math.inf, math.nan],
        "device": ['a "b", ü', None],
        "same": [True, None],
        "nothing": [None, None],
        "parts": [[1, 2], []],
    }
)


def test_a_table_is_its_rows_as_json():
    expected = [
        {
            "run_id": "ffffffffffffffff",
            "count": None,
            "mean_ns": 0.1,
            "worst_ns": None,
            "device": 'a "b", ü',
            "same": True,
            "nothing": None,
            "parts": [1, 2],
        },
        {
            "run_id": "0000000000000007",
            "count": -3,
            "mean_ns": 1e300,
            "worst_ns": None,
            "device": None,
            "same": None,
            "nothing": None,
            "parts": [],
        },
    ]
    assert _lines(TABLE) == "[\n" + ",\n".join(json.dumps(row) for row in expected) + "\n]"


def test_a_table_without_rows_is_an_empty_list():
    assert _lines(TABLE.head(0)) == "[]"
