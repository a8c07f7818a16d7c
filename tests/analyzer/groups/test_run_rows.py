"""Each run in one row: part by part as from all rows at once."""

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from dds_trace.analyzer.groups import run_rows as module
from dds_trace.analyzer.groups.run_rows import run_rows

LENGTHS = [3, 2, 4, 1]


def rows():
    """Ten messages of four runs in four groups; two relays of run 1 are of the first and of the last group."""
    number = pl.int_range(10, eager=True)
    return pl.DataFrame(
        {
            "run_id": pl.Series([1, 1, 2, 3, 3, 4, 4, 4, 4, 1], dtype=pl.UInt64),
            "scheduled_ns": number * 10,
            "publish_ns": number * 10 + 1,
            "outcome": ["completed", "lost", *["completed"] * 8],
            "latency_ns": [5, None, 7, None, 9, 1, 2, 3, 4, 50],
            "rtt_ns": [10, None, 14, 16, 18, 2, 4, 6, 8, 100],
        }
    )


def test_a_run_in_one_row():
    found = run_rows(rows().lazy(), LENGTHS).row(0, named=True)
    expected = {
        "run_id": 1,
        "origin_ns": 0,
        "last_ns": 91,
        "published": 3,
        "received": 2,
        "p50_ns": 27.5,
        "max_ns": 50,
    }
    assert found == expected


@pytest.mark.parametrize("at_once", [1, 3, 5, 9])
def test_parts_say_the_same(monkeypatch, at_once):
    whole = run_rows(rows().lazy(), LENGTHS)
    monkeypatch.setattr(module, "ROWS_AT_ONCE", at_once)
    assert_frame_equal(run_rows(rows().lazy(), LENGTHS), whole)
