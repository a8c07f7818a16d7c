import math

import pytest
from roundtrip_frames import MS, roundtrips

from dds_trace.analyzer.statistics.percentiles import PERCENTILES
from dds_trace.base.errors import OptionError
from dds_trace.extensions.campaigns.verdicts.false_alarms import (
    MOST_DEALS,
    check_statistic,
    count_false_alarms,
    half_widths,
)
from dds_trace.extensions.gates.compare import CompareOptions

P50 = CompareOptions(metrics=("rtt",), statistics=("p50",), paired=True)


def side(first_run, rtts_ms):
    return roundtrips(
        {
            "run_id": first_run + place,
            "sequence": number,
            "publish_ns": (place * 100 + number) * MS,
            "receive_ns": None if rtt is None else (place * 100 + number) * MS + round(rtt * MS),
        }
        for place, rtt in enumerate(rtts_ms)
        for number in range(10)
    )


def passes(count):
    return {first + place: place + 1 for first in (100, 200) for place in range(count)}


def test_sides_that_differ_alike_in_every_pass_alarm_as_recorded_and_not_once_a_pass_is_exchanged():
    base = side(100, [1.00, 1.01, 0.99, 1.00])
    new = side(200, [1.50, 1.51, 1.49, 1.52])
    alarms = count_false_alarms(base, new, passes(4), P50)
    # pass 1 stays; each of the other three is exchanged or not
    assert alarms.deals == 8
    assert (alarms.measured, alarms.of_measured) == (1, 1)
    assert (alarms.dealt, alarms.of_dealt) == (1, 8)
    assert alarms.rate == 1 / 8


def test_noise_alarms_only_in_the_deal_that_puts_every_slower_run_on_one_side():
    base = side(100, [1.0, 1.1, 0.9, 1.05])
    new = side(200, [1.1, 0.9, 1.05, 1.0])
    # new against base: slower, faster, slower, faster; exchanged in passes 2 and 4 it is always slower
    alarms = count_false_alarms(base, new, passes(4), P50)
    assert (alarms.measured, alarms.dealt, alarms.of_dealt) == (0, 1, 8)


def test_by_default_passes_are_compared_as_pairs():
    """A machine that drifts by a third from pass to pass hides a tenth from two series of runs, and not from pairs."""
    drift = [1.33**number for number in range(5)]
    base, new = side(100, drift), side(200, [1.1 * rtt for rtt in drift])
    unpaired = CompareOptions(metrics=("rtt",), statistics=("p50",), paired=False)
    assert count_false_alarms(base, new, passes(5), unpaired).measured == 0
    by_default = count_false_alarms(base, new, passes(5))
    assert by_default.measured > 0
    assert by_default.of_measured == 2 * (1 + len(PERCENTILES))  # latency and rtt by mean and percentiles


def test_of_many_passes_some_ways_to_deal_them_are_drawn():
    rtts = [1.0, 1.1, 0.9, 1.05, 1.2, 0.95, 1.02, 1.08]
    alarms = count_false_alarms(side(100, rtts), side(200, rtts[::-1]), passes(8), P50)
    assert alarms.deals == MOST_DEALS
    assert alarms.of_dealt == MOST_DEALS


def test_half_width_is_that_of_students_t_on_the_logarithms_of_the_runs():
    # p50 of three runs: e^-0.1, 1, e^0.1 ms; standard deviation 0.1, 99.995 % point of Student's t with two degrees 99.9925
    rows = side(1, [math.exp(-0.1), 1.0, math.exp(0.1)])
    reach = 99.9925 * 0.1 / math.sqrt(3)
    expected = 100 * (math.exp(reach) - math.exp(-reach)) / 2
    assert half_widths(rows, {"cell": (1, 2, 3)}, "rtt_p50") == {"cell": pytest.approx(expected, rel=1e-4)}


def test_sets_of_runs_are_measured_each_by_itself():
    rows = side(1, [1.0, 1.0, 1.0, 1.0, 2.0, 3.0])
    widths = half_widths(rows, {"alike": (1, 2, 3), "apart": (4, 5, 6)}, "rtt_p50")
    assert widths["alike"] == pytest.approx(0)
    assert widths["apart"] > 100


@pytest.mark.parametrize(
    ("rtts_ms", "why"), [([1.0, 1.0], "fewer than three runs"), ([1.0, 1.0, None], "a run that lost everything")]
)
def test_interval_that_lacks_an_end_is_infinitely_wide(rtts_ms, why):
    runs = tuple(range(1, len(rtts_ms) + 1))
    assert half_widths(side(1, rtts_ms), {"cell": runs}, "rtt_p50") == {"cell": math.inf}, why


@pytest.mark.parametrize("text", ["latency", "latency_p98", "lateness_p99", ""])
def test_unknown_statistic_is_refused(text):
    with pytest.raises(OptionError, match="for example latency_p99"):
        check_statistic(text)
