from statistics import median

import numpy as np
import polars as pl
import pytest
from paired_by_hand import paired
from polars.testing import assert_frame_equal
from roundtrip_frames import roundtrips

from dds_trace.analyzer.groups import timeline as module
from dds_trace.analyzer.groups.batch import filled, is_present, present
from dds_trace.analyzer.groups.timeline import RUN_SCHEMA, run_frame, run_rows

HELD = [  # group, run, relay, latency in ns of each message: None is a lost one, text a round trip that no relay stamped
    (0, 1, 1, [5, None, 8]),
    (0, 2, 1, [7]),
    (1, 3, 1, ["16", 9]),
    (2, 4, 1, [1, 2]),
    (2, 4, 2, [3, 4, 30]),
    (3, 1, 2, [50]),
    (3, 5, 1, [None, None]),
]


def rows():
    return roundtrips(
        {
            "group": group,
            "run_id": run,
            "relay_id": relay,
            "sequence": number,
            "publish_ns": 1_000 * run + 100 * number + 3,
            "scheduled_ns": None if run == 2 else 1_000 * run + 100 * number,
            **stamps(1_000 * run + 100 * number + 3, latency),
        }
        for group, run, relay, latencies in HELD
        for number, latency in enumerate(latencies)
    ).with_columns(pl.col("group").cast(pl.UInt32))


def stamps(sent_ns, latency):
    if latency is None:
        return {}
    if isinstance(latency, str):
        return {"receive_ns": sent_ns + int(latency)}
    return {
        "relay_in_ns": sent_ns + latency,
        "relay_out_ns": sent_ns + latency + 1,
        "receive_ns": sent_ns + 2 * latency + 1,
    }


def expected(group=None):
    """The rows of one group, or those of all with the relays of each run put together."""
    of_run = {}
    for number, run, _, latencies in HELD:
        if group in (None, number):
            of_run.setdefault(run, []).append(latencies)
    found = []
    for run, of_relays in sorted(of_run.items()):
        came = [int(time) for latencies in of_relays for time in latencies if time is not None]
        origin_ns = 1_000 * run + (3 if run == 2 else 0)
        last_ns = max(1_000 * run + 100 * (len(latencies) - 1) + 3 for latencies in of_relays)
        slowest, middle = (max(came), float(median(came))) if came else (None, None)
        found.append((run, origin_ns, last_ns, sum(map(len, of_relays)), len(came), middle, slowest))
    return found


def test_each_run_of_each_group_in_one_row():
    frame = run_frame(*paired(rows()))
    assert frame.schema == RUN_SCHEMA
    for group in range(4):
        assert frame.filter(group=group).drop("group").rows() == expected(group)


@pytest.mark.parametrize("at_once", [1, 4, 100])
def test_a_run_whose_relays_are_of_several_groups_is_one_row(monkeypatch, at_once):
    monkeypatch.setattr(module, "ROWS_AT_ONCE", at_once)
    assert run_rows(run_frame(*paired(rows())), rows().lazy()).rows() == expected()


def test_nothing_is_read_where_each_run_is_of_one_group():
    frame = run_frame(*paired(rows().filter(pl.col("group") < 3)))
    assert_frame_equal(run_rows(frame, pl.LazyFrame()), frame.drop("group").sort("run_id"))


def test_no_run_at_all():
    frame = run_frame(*paired(rows().clear()))
    assert frame.schema == RUN_SCHEMA
    assert run_rows(frame, rows().clear().lazy()).is_empty()


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
