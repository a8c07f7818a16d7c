from __future__ import annotations

import numpy as np
import pytest

from dds_trace.base.errors import OutputError
from dds_trace.recorder.host.recorder_cost import measure_recorder_cost, worst_stall_ns


def test_the_figures_are_in_order_and_nothing_is_left(tmp_path):
    cost = measure_recorder_cost(tmp_path, seconds=0.3)
    assert cost.events == 300
    assert cost.timer_ns > 0
    assert 0 < cost.record_median_ns <= cost.record_p99_ns <= cost.record_max_ns <= cost.stall_of_ten_ns
    assert list(tmp_path.iterdir()) == []


def test_the_worst_stall_is_ten_events_in_a_row():
    times = np.zeros(100)
    times[[3, 50, 59, 70]] = [40.0, 30.0, 30.0, 1.0]  # 50 and 59 are the ends of one ten
    assert worst_stall_ns(times) == 60.0


def test_a_folder_that_is_not_there(tmp_path):
    with pytest.raises(OutputError):
        measure_recorder_cost(tmp_path / "gone", seconds=0.01)


def test_the_clock_that_is_taken_off_is_the_cold_one(monkeypatch, tmp_path):
    """An event at 1 kHz meets cold caches, and so does the reading of the clock that its time holds."""
    cost = measure_recorder_cost(tmp_path, seconds=0.2)
    assert cost.cold_timer_ns > 0
    gross = np.array([9_000.0, 7_000.0, 400.0] * 50)
    monkeypatch.setattr("dds_trace.recorder.host.recorder_cost.time_paced_events", lambda *_: gross)
    monkeypatch.setattr("dds_trace.recorder.host.recorder_cost.measure_cold_timer_ns", lambda _: 850.0)
    assert measure_recorder_cost(tmp_path, seconds=0.1).record_median_ns == 7_000 - 850
    assert measure_recorder_cost(tmp_path, seconds=0.1).record_max_ns == 9_000 - 850
