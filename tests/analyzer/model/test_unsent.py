from __future__ import annotations

import polars as pl
import pytest
from roundtrip_frames import MS, in_runs, steady

from dds_trace.analyzer.model.runs import delivered_runs, split_runs, with_unsent
from dds_trace.analyzer.verdicts.compare import CompareOptions, compare_roundtrips
from dds_trace.analyzer.verdicts.matching import MatchedGroup


def test_they_are_lost_and_not_published():
    group = MatchedGroup(with_unsent(steady([MS] * 20), {1: 5, 9: 3}))
    (run,) = group.delivered("latency")
    assert (len(group), len(run), int((run.values == float("inf")).sum())) == (20, 25, 5)
    assert group.received_ratio(0.95).value == pytest.approx(0.8)
    assert len(group.runs[0].sent_ns) == 20
    assert len(group.survivors("latency")) == 20


def test_a_side_that_does_not_send_its_messages_is_not_better():
    base, new = in_runs([5 * MS] * 40), in_runs([MS] * 10, run_id=2)
    unsent = dict.fromkeys(new["run_id"].unique().to_list(), 30)
    options = CompareOptions(metrics=("latency",), statistics=("p50",))
    (row,) = compare_roundtrips(base, with_unsent(new, unsent), options).rows.iter_rows(named=True)
    assert row["verdict"] == "worse"
    assert (row["new_ns"], row["new_survivors_ns"]) == (float("inf"), pytest.approx(MS, rel=0.05))
    assert row["new_received_ratio"] == pytest.approx(0.25)


def test_frames_without_unsent_messages_stay_as_they_are():
    frame = steady([MS] * 3)
    assert with_unsent(frame, {}).equals(frame)
    assert with_unsent(frame, {7: 2}).equals(frame)
    assert isinstance(delivered_runs(split_runs(frame), "latency")[0].values[0], float)
    assert with_unsent(frame, {1: 2}).schema == pl.Schema(frame.schema)
