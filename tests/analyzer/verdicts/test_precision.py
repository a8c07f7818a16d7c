from __future__ import annotations

import math

import pytest
from roundtrip_frames import MS, roundtrips

from dds_trace.analyzer.verdicts.false_alarms import check_statistic, half_widths
from dds_trace.base.errors import OptionError


def rows_of(rtts_ms):
    """Runs 1, 2 ... of ten messages each that all take the run's time; None is lost."""
    return roundtrips(
        {
            "run_id": run,
            "sequence": number,
            "publish_ns": (run * 100 + number) * MS,
            "receive_ns": None if rtt is None else (run * 100 + number) * MS + round(rtt * MS),
        }
        for run, rtt in enumerate(rtts_ms, 1)
        for number in range(10)
    )


def test_half_width_is_that_of_students_t_on_the_logarithms_of_the_runs():
    # p50 of three runs: e^-0.1, 1, e^0.1 ms; standard deviation 0.1, t of two degrees of freedom 4.302653
    rows = rows_of([math.exp(-0.1), 1.0, math.exp(0.1)])
    reach = 4.302653 * 0.1 / math.sqrt(3)
    expected = 100 * (math.exp(reach) - math.exp(-reach)) / 2
    assert half_widths(rows, {"cell": (1, 2, 3)}, "rtt_p50") == {"cell": pytest.approx(expected, rel=1e-4)}


def test_sets_of_runs_are_measured_each_by_itself():
    rows = rows_of([1.0, 1.0, 1.0, 1.0, 2.0, 3.0])
    widths = half_widths(rows, {"alike": (1, 2, 3), "apart": (4, 5, 6)}, "rtt_p50")
    assert widths["alike"] == pytest.approx(0)
    assert widths["apart"] > 100


@pytest.mark.parametrize(
    ("rtts_ms", "why"),
    [([1.0, 1.0], "fewer than three runs"), ([1.0, 1.0, None], "a run that lost everything")],
)
def test_interval_that_lacks_an_end_is_infinitely_wide(rtts_ms, why):
    runs = tuple(range(1, len(rtts_ms) + 1))
    assert half_widths(rows_of(rtts_ms), {"cell": runs}, "rtt_p50") == {"cell": math.inf}, why


@pytest.mark.parametrize("text", ["latency", "latency_p98", "lateness_p99", ""])
def test_unknown_statistic_is_refused(text):
    with pytest.raises(OptionError, match="for example latency_p99"):
        check_statistic(text)
