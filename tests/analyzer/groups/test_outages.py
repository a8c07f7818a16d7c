"""Outages drawn by hand: runs of lost messages, how long they lasted, when the run was steady again."""

import polars as pl

from dds_trace.analyzer.groups.freshness import find_outages, runs_of


def flags(text):
    return [character == "x" for character in text]


def messages(lost, in_time=""):
    """Messages 100, 101, 102 ... planned every 10 ns and received 4 ns later; `x` marks lost, or in time."""
    planned_ns = [10 * number for number in range(len(lost))]
    return pl.DataFrame(
        {
            "sequence": range(100, 100 + len(lost)),
            "planned_ns": planned_ns,
            "receive_ns": [time_ns + 4 for time_ns in planned_ns],
            "lost": pl.Series(flags(lost), dtype=pl.Boolean),
            "in_time": pl.Series(flags(in_time or lost), dtype=pl.Boolean),
        }
    ).with_columns(exchange=0)


def outages(lost, in_time):
    """Of each: first number, messages, start, end, recovery."""
    found = find_outages(messages(lost, in_time)).collect()
    return found.select("first_sequence", "messages", "start_ns", "end_ns", "recovery_ns").rows()


def test_runs_of_true_have_start_stop_and_a_longest():
    runs = runs_of(messages("xx.xxx.x"), pl.col("lost")).collect()
    assert runs.select("row", "end_row").rows() == [(0, 2), (3, 6), (7, 8)]
    assert runs["messages"].max() == 3
    for lost in ("....", ""):
        assert runs_of(messages(lost), pl.col("lost")).collect().is_empty()


def test_three_losses_in_a_row_are_an_outage_and_two_are_none():
    assert outages(lost=".xx...xxx......", in_time="x..xxx...xxxxxx") == [(106, 3, 60, 94, 0)]


def test_recovery_lasts_until_five_in_a_row_are_in_time():
    # Lost 1-3; 4 gets through at 44, late; 5 and 6 in time, 7 late, 8-12 in time: steady from 8, received at 84.
    lost, in_time = ".xxx.........", "x....xx.xxxxx"
    assert outages(lost, in_time) == [(101, 3, 10, 44, 40)]
    assert find_outages(messages(lost, in_time)).collect()["duration_ns"].to_list() == [34]


def test_an_outage_may_last_to_the_end_and_a_run_may_never_be_steady_again():
    assert outages(lost="..xxx", in_time="xx...") == [(102, 3, 20, None, None)]
    # Four in a row are too few.
    assert outages(lost="xxx....", in_time="...xxxx") == [(100, 3, 0, 34, None)]
