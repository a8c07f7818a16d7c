from __future__ import annotations

import math

import polars as pl
from roundtrip_frames import MS, steady

from dds_trace.analyzer.model.runs import delivered_runs, pass_numbers, passes_of, split_runs
from dds_trace.tracefile.format.descriptions import Run


def values_of(frame, metric="latency"):
    return [run.values.tolist() for run in delivered_runs(split_runs(frame), metric)]


def test_lost_messages_are_infinitely_late_and_replies_without_stamps_take_half_their_round_trip():
    late = steady([5 * MS, None, 7 * MS])
    bare = late.with_columns(latency_ns=pl.when(pl.col("sequence") == 2).then(None).otherwise(pl.col("latency_ns")))
    assert bare["rtt_ns"][2] == 14 * MS + 1000
    assert values_of(bare) == [[5 * MS, math.inf, 7 * MS + 500]]


def test_a_group_without_any_latency_has_no_values_unless_everything_was_lost():
    bare = steady([MS, None]).with_columns(latency_ns=pl.lit(None, pl.Int64))
    assert values_of(bare) == [[]]
    assert values_of(steady([None, None])) == [[math.inf, math.inf]]


def test_relays_of_one_run_are_one_run_in_the_order_of_time():
    frame = pl.concat([steady([MS, 2 * MS], relay_id=1), steady([3 * MS, 4 * MS], relay_id=2)])
    assert values_of(frame) == [[MS, 3 * MS, 2 * MS, 4 * MS]]
    assert [run.run_id for run in split_runs(pl.concat([frame, steady([MS], run_id=7)]))] == [1, 7]


def described(run_id, **labels):
    return Run(run_id, "binary", 1, 1.0, 1, 0, labels=labels)


def test_passes_pair_runs_only_where_every_run_has_one():
    passes = pass_numbers([described(1, **{"pass": "1"}), described(2, **{"pass": "2"}), described(3, other="x")])
    assert passes == {1: 1, 2: 2}
    one, two, three = (split_runs(steady([MS], run_id=number)) for number in (1, 2, 3))
    assert passes_of(one, two, passes) == ([1], [2])
    assert passes_of(one, three, passes) is None
    assert passes_of((*one, *one), two, passes) is None
