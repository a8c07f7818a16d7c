"""Outages drawn by hand: runs of lost messages, how long they lasted, when the run was steady again."""

import numpy as np

from dds_trace.analyzer.groups.freshness import Outage, find_outages, longest_run, runs_of


def test_runs_of_true_have_start_stop_and_a_longest():
    happened = np.array([1, 1, 0, 1, 1, 1, 0, 1], np.bool_)
    assert runs_of(happened) == [(0, 2), (3, 6), (7, 8)]
    assert longest_run(happened) == 3
    assert longest_run(np.zeros(4, np.bool_)) == longest_run(np.empty(0, np.bool_)) == 0


def flags(text):
    return np.array([character == "x" for character in text], np.bool_)


def outages(lost, in_time):
    """Outages of messages 0, 1, 2 ... planned every 10 ns and received 4 ns later; `x` marks lost, or in time."""
    planned_ns = np.arange(len(lost), dtype=np.int64) * 10
    sequence = np.arange(100, 100 + len(lost), dtype=np.uint64)
    return find_outages(sequence, planned_ns, planned_ns + 4, flags(lost), flags(in_time))


def test_three_losses_in_a_row_are_an_outage_and_two_are_none():
    assert outages(lost=".xx...xxx......", in_time="x..xxx...xxxxxx") == [Outage(106, 3, 60, 94, 0)]


def test_recovery_lasts_until_five_in_a_row_are_in_time():
    # Lost 1-3; 4 gets through at 44, late; 5 and 6 in time, 7 late, 8-12 in time: steady from 8, received at 84.
    (outage,) = outages(lost=".xxx.........", in_time="x....xx.xxxxx")
    assert (outage.end_ns, outage.recovery_ns, outage.duration_ns) == (44, 40, 34)


def test_an_outage_may_last_to_the_end_and_a_run_may_never_be_steady_again():
    assert outages(lost="..xxx", in_time="xx...") == [Outage(102, 3, 20, None, None)]
    (outage,) = outages(lost="xxx....", in_time="...xxxx")  # four in a row are too few
    assert (outage.end_ns, outage.recovery_ns) == (34, None)
