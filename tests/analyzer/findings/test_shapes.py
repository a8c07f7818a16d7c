import re

import numpy as np
import pytest
from trace_files import evenly, run, write_runs
from wording import numbers

from dds_trace.analyzer.groups.shapes import shape_of
from dds_trace.analyzer.pipeline import analyze

MS = 1_000_000
PERIOD = 10 * MS
CODES = {"short_warm_up", "latency_rises", "two_modes"}


def found(folder, *series_ms, warmup=0):
    recorded, start = [], 0
    for number, latencies_ms in enumerate(series_ms, 1):
        messages = evenly((round(MS * each) for each in latencies_ms), start_ns=start, period_ns=PERIOD)
        start += (len(messages) + 200) * PERIOD
        count = len(messages) - warmup
        fields = {"planned_messages": count, "published": len(messages), "warmup_messages": warmup}
        recorded.append((run(run_id=number, rate_hz=100.0, **fields), messages))
    write_runs(folder, recorded)
    return {finding.code: finding for finding in analyze(folder).findings if finding.code in CODES}


def noise(seed, count=1000):
    return np.exp(np.random.default_rng(seed).normal(0, 0.2, count))


def test_steady_latency_has_no_shape(tmp_path):
    assert found(tmp_path, *(noise(seed) for seed in range(3))) == {}


def test_a_short_warm_up_is_named_with_the_length_that_would_do(tmp_path, sentences):
    slow_begin = np.where(np.arange(1000) < 40, 3.0, 1.0)
    finding = found(tmp_path, *(slow_begin * noise(seed) for seed in range(3)), warmup=10)["short_warm_up"]
    # Ten of the forty are warm-up already; noise adds batches of five.
    assert numbers(finding.what)[:2] == [3, 3]
    sentences(finding.what.partition(": ")[0])
    messages = int(re.search(r"up to (\d+) messages", finding.what)[1])
    assert 30 <= messages <= 45
    assert finding.action == f"Record with -o warmup={10 + messages}, which leaves them out."


def test_latency_that_rises_through_a_run(tmp_path, sentences):
    rise = np.linspace(1, 2, 1000)
    finding = found(tmp_path, rise * noise(1), rise * noise(2), noise(3))["latency_rises"]
    assert numbers(finding.what)[:2] == [2, 3]
    sentences(finding.what.partition(", ")[0])
    assert "latency_rises" not in found(tmp_path, rise[::-1] * noise(1))


def test_one_run_of_five_decides_nothing(tmp_path):
    assert found(tmp_path, np.linspace(1, 2, 1000) * noise(0), *(noise(seed) for seed in range(1, 5))) == {}


def test_two_modes(tmp_path):
    one_in_three = np.where(np.arange(1000) % 3 == 0, 4.0, 1.0)
    finding = found(tmp_path, one_in_three * noise(1))["two_modes"]
    assert "33 % of the messages" in finding.what


@pytest.mark.parametrize("scale_ns", [1, 10_000])
def test_what_may_be_the_recorders_own_is_no_finding(scale_ns):
    # A rise by the half of 10 us, as one of 10 ms would be found.
    sent_ns = np.arange(1000) * PERIOD
    rise = np.linspace(1, 1.5, 1000) * noise(4)
    shape = shape_of((rise * scale_ns * 10_000).astype(np.int64), sent_ns)
    assert ("trend_ratio" in shape) is (scale_ns > 1)
    assert shape_of(np.empty(0, np.int64), np.empty(0, np.int64)) == {}
