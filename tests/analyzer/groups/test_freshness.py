from dataclasses import replace

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paired_by_hand import paired
from roundtrip_frames import MS, roundtrips, steady, with_one_way

from dds_trace.analyzer.groups.freshness import age_of_information, freshness_frame, outage_frame


def summarize_freshness(frame, **wanted):
    return freshness_frame(*paired(frame, **wanted))


def outage_table(frame, **wanted):
    return outage_frame(*paired(frame, **wanted))


def test_deadline_misses_are_counted_with_their_longest_run():
    # One message each 100 ms, deadline 20 ms:      ok  late  lost  late   ok   ok  late
    frame = steady([5 * MS, 30 * MS, None, 21 * MS, 20 * MS, 5 * MS, 90 * MS])
    row = summarize_freshness(frame, deadline_ns=20 * MS, metric="latency").row(0, named=True)
    assert (row["messages"], row["judged"], row["missed"]) == (7, 7, 4)
    assert row["missed_ratio"] == pytest.approx(4 / 7)
    assert (row["longest_missed"], row["longest_missed_ns"]) == (3, 300 * MS)  # from 100 ms to 400 ms
    assert row["outages"] == 0
    assert (row["outage_longest_ns"], row["recovery_longest_ns"]) == (None, None)


def test_without_a_deadline_nothing_is_judged():
    row = summarize_freshness(steady([5 * MS, None])).row(0, named=True)
    assert (row["deadline_ns"], row["judged"], row["missed"], row["missed_ratio"]) == (None, None, None, None)


def test_a_reply_without_the_relays_trace_is_judged_on_rtt_only():
    frame = roundtrips([{"publish_ns": 0, "receive_ns": 10 * MS}, {"publish_ns": 100 * MS}])
    by_latency = summarize_freshness(frame, deadline_ns=20 * MS, metric="latency").row(0, named=True)
    assert (by_latency["judged"], by_latency["missed"], by_latency["unsure"]) == (1, 1, 1)
    by_rtt = summarize_freshness(frame, deadline_ns=20 * MS, metric="rtt").row(0, named=True)
    assert (by_rtt["judged"], by_rtt["missed"]) == (2, 1)


def test_the_age_is_known_at_the_ping_and_with_a_bound_at_the_relay():
    # Replies after 21 ms (10 out, 1 in the relay, 10 back) of messages at 0, 100, 200 ms.
    frame = with_one_way(
        roundtrips(
            [
                {
                    "publish_ns": sent * MS,
                    "relay_in_ns": (sent + 10) * MS,
                    "relay_out_ns": (sent + 11) * MS,
                    "receive_ns": (sent + 21) * MS,
                }
                for sent in (0, 100, 200)
            ],
            relay_device="ping-pi",
        )
    )
    row = summarize_freshness(frame).row(0, named=True)
    # From 21 to 121 on average over each 100 ms; at the relay from 10 to 110. One machine: no clock error.
    assert (row["age_mean_ns"], row["age_peak_mean_ns"], row["age_peak_max_ns"]) == (71 * MS, 121 * MS, 121 * MS)
    assert (row["relay_age_mean_ns"], row["relay_age_peak_max_ns"]) == (60 * MS, 110 * MS)
    assert row["clock_bound_ns"] == 0


def test_an_outage_lasts_from_its_first_loss_to_the_next_reply():
    #   0 .. 9 in time, 10 .. 14 lost, 15 .. 17 late by 60 ms, 18 in time, 19 late, 20 .. 29 in time
    latencies = [5 * MS] * 10 + [None] * 5 + [60 * MS] * 3 + [5 * MS, 60 * MS] + [5 * MS] * 10
    frame = steady(latencies)
    (outage,) = outage_table(frame, deadline_ns=20 * MS).iter_rows(named=True)
    assert (outage["first_sequence"], outage["messages"]) == (10, 5)
    assert outage["start_ns"] == 1000 * MS
    assert outage["end_ns"] == 1500 * MS + 120 * MS + 1000  # reply to message 15
    assert outage["duration_ns"] == 620 * MS + 1000
    # Five in a row in time begin with message 20, whose reply came at 2010 ms.
    assert outage["recovery_ns"] == (2010 - 1620) * MS
    row = summarize_freshness(frame, deadline_ns=20 * MS).row(0, named=True)
    assert (row["outages"], row["outage_longest_ns"], row["recovery_longest_ns"]) == (1, 620 * MS + 1000, 390 * MS)


def test_an_outage_that_is_over_at_once_and_one_that_never_ends():
    frame = steady([5 * MS] * 10 + [None] * 3 + [5 * MS] * 10 + [None] * 4)
    table = outage_table(frame)
    assert table["messages"].to_list() == [3, 4]
    assert table["recovery_ns"].to_list() == [0, None]
    assert table["duration_ns"].to_list() == [300 * MS + 10 * MS + 1000, None]


def test_two_losses_are_no_outage():
    assert outage_table(steady([5 * MS, None, None, 5 * MS])).is_empty()


def test_runs_and_relays_have_rows_of_their_own():
    frame = pl.concat(
        [steady([5 * MS, None], run_id=9), steady([5 * MS], run_id=2), steady([5 * MS], run_id=9, relay_id=7)]
    ).with_columns(group=pl.lit(4, pl.UInt32))
    other = steady([None] * 3, run_id=1).with_columns(group=pl.lit(5, pl.UInt32))
    held = pl.concat([frame, other])
    assert summarize_freshness(held, deadline_ns=MS).select(
        "group", "run_id", "relay_id", "messages", "missed"
    ).rows() == [(4, 2, 1, 1, 1), (4, 9, 1, 2, 2), (4, 9, 7, 1, 1), (5, 1, 1, 3, 3)]
    assert outage_table(held).select("group", "run_id", "messages").rows() == [(5, 1, 3)]


def test_a_run_without_messages_has_no_row():
    batch, roundtrips = paired(pl.concat([steady([5 * MS], run_id=1), steady([5 * MS], run_id=2)]))
    empty = replace(roundtrips, bounds=np.array([0, 0, 2]))
    assert freshness_frame(batch, empty).select("run_id", "messages").rows() == [(2, 2)]


def test_without_messages_there_is_nothing_to_summarize():
    assert summarize_freshness(steady([]), deadline_ns=1).is_empty()
    assert outage_table(steady([])).is_empty()
    row = summarize_freshness(steady([None, None, None]), deadline_ns=1).row(0, named=True)
    assert (row["missed"], row["age_mean_ns"], row["outages"], row["outage_longest_ns"]) == (3, None, 1, None)


def test_a_deadline_is_for_the_response_unless_another_metric_is_named():
    # Sent 15 ms late, back 10 ms later: the response is 25 ms, the round trip 10 ms.
    frame = roundtrips([{"scheduled_ns": 0, "publish_ns": 15 * MS, "receive_ns": 25 * MS}])
    assert summarize_freshness(frame, deadline_ns=20 * MS)["missed"].to_list() == [1]
    assert summarize_freshness(frame, deadline_ns=20 * MS, metric="rtt")["missed"].to_list() == [0]


def test_messages_that_never_left_miss_the_deadline():
    frame = roundtrips([{"publish_ns": 0, "receive_ns": 10 * MS}, {"publish_ns": 100 * MS}], run_id=4, relay_id=7)
    row = summarize_freshness(frame, deadline_ns=20 * MS, unsent={(4, 7): 3}).row(0, named=True)
    assert (row["messages"], row["judged"], row["missed"], row["longest_missed"]) == (2, 5, 4, 4)
    assert row["missed_ratio"] == 0.8


def test_a_one_way_deadline_is_surely_met_surely_missed_or_cannot_be_told():
    # 5, 19, 21, 30 ms out, each wrong by at most 2 ms, deadline 20 ms; one lost on its way out, one on its way back.
    ways = [{"outbound_ns": ms * MS, "clock_bound_ns": 2 * MS, "receive_ns": 50 * MS} for ms in (5, 19, 21, 30)]
    lost = [{"outcome": "lost_outbound"}, {"outcome": "lost_return"}]
    frame = roundtrips({"publish_ns": 0, "sequence": n, **row} for n, row in enumerate([*ways, *lost]))
    row = summarize_freshness(frame, deadline_ns=20 * MS, metric="outbound").row(0, named=True)
    assert (row["messages"], row["judged"], row["missed"]) == (6, 3, 2)
    assert row["unsure"] == 3  # 19 and 21 ms, and the one lost on its way back


def age(made, received):
    rows = pl.DataFrame(
        {"planned_ns": made, "receive_ns": received}, dict.fromkeys(("planned_ns", "receive_ns"), pl.Int64)
    )
    ages = age_of_information(rows.with_columns(exchange=0), "receive_ns").collect().to_dicts()
    return ages[0] if ages else None


def test_age_is_a_saw_tooth():
    #  made      0    10        30
    #  received     4    12          38
    #  age at reception 4, 2, 8; just before the next one 12 and 28.
    #  time average over 4..38: (4+12)/2*8 + (2+28)/2*26 = 64 + 390 = 454, over 34.
    saw = age([0, 10, 30], [4, 12, 38])
    assert saw["mean_ns"] == pytest.approx(454 / 34)
    assert saw["peak_mean_ns"] == 20.0
    assert (saw["peak_max_ns"], saw["updates"]) == (28, 3)


def test_a_late_older_message_is_no_news():
    assert age([0, 10, 5, 30], [4, 12, 20, 38]) == age([0, 10, 30], [4, 12, 38])


def test_two_at_one_instant_are_one_update():
    assert age([0, 5, 10], [4, 12, 12]) == age([0, 10], [4, 12])


def test_one_update_has_no_age_over_time():
    assert age([1], [2]) is None
    assert age([], []) is None


@given(gaps=st.lists(st.integers(1, 1000), min_size=2, max_size=30), delay=st.integers(0, 5000))
def test_a_constant_delay_adds_to_the_mean_age(gaps, delay):
    made = np.cumsum(np.array(gaps, np.int64))
    without, delayed = age(made, made), age(made, made + delay)
    assert delayed["mean_ns"] == pytest.approx(without["mean_ns"] + delay)
    assert delayed["peak_max_ns"] == max(gaps[1:]) + delay
