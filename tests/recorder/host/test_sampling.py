import errno
import json
import os
import queue
import subprocess
import sys
from unittest import mock

import numpy as np
import pytest
from waiting import PATIENCE_S

from dds_trace.base.errors import OutputError
from dds_trace.recorder.host import sampling
from dds_trace.recorder.host.sampling import HostSampler
from dds_trace.recorder.roles.floor import measure_recorder_cost, worst_stall_ns


def test_samples_of_host_and_own_process_arrive_until_stopped():
    samples = queue.Queue()
    with HostSampler(samples.put, period_s=0.02):
        first, second = (samples.get(timeout=PATIENCE_S) for _ in range(2))
    assert second["monotonic_ns"] > first["monotonic_ns"]
    assert second["monotonic_raw_ns"] > first["monotonic_raw_ns"]
    json.dumps(first)
    assert first["processes"]["self"]["pid"] == os.getpid()
    assert first["processes"]["self"]["memory_bytes"] > 0
    assert first["host"]["memory_available_bytes"] > 0
    assert len(first["host"]["cpu_percent_each"]) == os.cpu_count()
    assert "lo" in first["network"]
    assert first["sampling_cpu_ns"] > 0


def test_run_shorter_than_a_period_has_one_sample():
    samples = queue.Queue()
    with HostSampler(samples.put, period_s=3600):
        pass
    assert samples.qsize() == 1


def test_named_process_is_followed_until_it_ends():
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as child:
        sampler = HostSampler(lambda _sample: None, processes={"bridge": child.pid})
        assert sampler.sample()["processes"]["bridge"]["pid"] == child.pid
        child.communicate(b"\n")
    assert set(sampler.sample()["processes"]) == {"self"}


def test_dropped_datagrams_are_read_from_the_kernel(monkeypatch):
    counters = {"ReasmFails": 3, "ReasmTimeout": 2, "FragFails": 0, "InErrors": 7, "RcvbufErrors": 6, "SndbufErrors": 0}
    monkeypatch.setattr(sampling, "read_kernel_counters", lambda: counters | {"ReasmOKs": 9, "MemErrors": 1})
    assert HostSampler(lambda _sample: None).sample()["udp"] == counters


def test_a_moment_without_files_costs_only_its_samples():
    """As where strangers take all of them: EMFILE at the first two, then room again."""
    samples, lack = queue.Queue(), OSError(errno.EMFILE, "Too many open files")
    taken = mock.patch.object(HostSampler, "sample", side_effect=[lack, lack, *[{"monotonic_ns": 1}] * 10_000])
    with taken, HostSampler(samples.put, period_s=0.01):
        assert samples.get(timeout=PATIENCE_S) == {"monotonic_ns": 1}


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
    measured = (gross, np.full(100, 850.0))
    monkeypatch.setattr("dds_trace.recorder.roles.floor.time_paced_events", lambda *_: measured)
    assert measure_recorder_cost(tmp_path, seconds=0.1).record_median_ns == 7_000 - 850
    assert measure_recorder_cost(tmp_path, seconds=0.1).record_max_ns == 9_000 - 850
