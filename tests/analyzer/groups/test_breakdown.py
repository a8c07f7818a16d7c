"""Where the time goes, on one message drawn by hand and on runs that contradict themselves."""

from dataclasses import replace

import polars as pl
import pytest
from paired_by_hand import paired
from roundtrip_frames import MS, roundtrips, with_one_way
from trace_files import ping_session, relay_session

from dds_trace.analyzer.groups.breakdown import (
    BREAKDOWN_SCHEMA,
    RESPONSE_SCHEMA,
    STAGES,
    breakdown_frame,
    response_frame,
)
from dds_trace.analyzer.groups.summary import own_cost_ns, ratio

PING_WALL, RELAY_WALL = 10**18, 2 * 10**18  # wall clock at monotonic zero of each device

# us  T0=0  T1=5           R3=45  T3=60   T4=70             R2=112  T2=120
#          source 7                           source 73
MESSAGE = {
    "scheduled_ns": 0,
    "publish_ns": 5_000,
    "relay_in_ns": 60_000,
    "relay_out_ns": 70_000,
    "receive_ns": 120_000,
    "relay_source_ns": PING_WALL + 7_000,
    "relay_received_ns": RELAY_WALL + 45_000,
    "reply_source_ns": RELAY_WALL + 73_000,
    "reply_received_ns": PING_WALL + 112_000,
}


WALLS = {"ping_wall": {1: PING_WALL, 2: PING_WALL}, "relay_wall": {1: RELAY_WALL}}
COARSE = ["waiting_ns", "outbound_ns", "relay_ns", "return_ns"]


def frame_of(rows, **parameters):
    return with_one_way(roundtrips(rows, **{"relay_device": "ping-pi", **parameters}))


def breakdown_of(rows, **parameters):
    return breakdown_frame(*paired(frame_of(rows, **parameters), **WALLS))


def means(table):
    return dict(table.select("part", "mean_ns").iter_rows())


def bounds(table):
    return dict(table.select("part", "bound_ns").iter_rows())


def test_every_part_of_one_message():
    table = breakdown_of([MESSAGE])
    assert means(table) == {
        "waiting_ns": 5_000,
        "outbound_transport_ns": 40_000,
        "relay_delivery_ns": 15_000,
        "relay_ns": 10_000,
        "return_transport_ns": 42_000,
        "ping_delivery_ns": 8_000,
    }
    assert table["part"].to_list() == list(STAGES)
    assert table["order"].to_list() == [0, 1, 2, 3, 4, 5]
    assert table["mean_ns"].sum() == 120_000
    # The relay's anchor is off by at most 15 us (delivery) or 3 us (write), the ping's by 8 us or 2 us.
    assert bounds(table)["relay_delivery_ns"] == 15_000


def test_clocks_that_may_be_off_are_in_the_bound_of_the_transports():
    frame = frame_of([MESSAGE], relay_device="relay-pi")
    clock_ns = frame["clock_bound_ns"][0]
    assert clock_ns > 50_000
    table = breakdown_frame(*paired(frame, **WALLS))
    assert table["bound_ns"].to_list() == [0, clock_ns + 15_000, 15_000, 0, clock_ns + 15_000, 15_000]
    bare = breakdown_frame(*paired(frame.with_columns(relay_received_ns=pl.lit(0, pl.Int64)), **WALLS))
    assert bare["bound_ns"].to_list() == [0, clock_ns, 0, clock_ns]


def test_without_reception_stamps_the_whole_ways_remain():
    bare = {k: v for k, v in MESSAGE.items() if "source" not in k and "received" not in k}
    for rows in ([bare], [{**MESSAGE, "relay_received_ns": 0, "reply_received_ns": 0}]):
        table = breakdown_of(rows)
        assert table["part"].to_list() == COARSE
        assert table["mean_ns"].to_list() == [5_000, 55_000, 10_000, 50_000]
        assert table["mean_ns"].sum() == 120_000


def test_without_the_session_of_the_relay_nothing_is_mixed():
    table = breakdown_frame(*paired(frame_of([MESSAGE]), ping_wall={1: PING_WALL}))
    assert table["part"].to_list() == COARSE


def test_a_run_has_the_anchors_of_all_its_messages_lost_ones_too():
    """The last message contradicts the anchor of the relay, the second is nearest to that of the ping."""
    rows = [MESSAGE, {**MESSAGE, "reply_received_ns": PING_WALL + 119_000}, MESSAGE, MESSAGE]
    assert breakdown_of(rows)["mean_ns"][5] == (8_000 * 3 + 1_000) / 4
    lost = {k: v for k, v in MESSAGE.items() if k not in {"receive_ns", "reply_source_ns", "reply_received_ns"}}
    contradiction = {**lost, "relay_received_ns": RELAY_WALL + 60_001}
    assert breakdown_of([*rows, lost])["part"].to_list() == list(STAGES)
    assert breakdown_of([*rows, contradiction])["part"].to_list() == COARSE


@pytest.mark.parametrize(
    "stamps",
    [
        # The relay's wall clock was set back by 5 us: its replies seem to be written before T4 (3 us - 5 us < 0).
        {"relay_received_ns": RELAY_WALL + 40_000, "reply_source_ns": RELAY_WALL + 68_000},
        # Set forward by 20 us: messages seem to be delivered before they came.
        {"relay_received_ns": RELAY_WALL + 65_000, "reply_source_ns": RELAY_WALL + 93_000},
        # The ping's by 3 us back, and by 9 us forward.
        {"reply_received_ns": PING_WALL + 109_000, "relay_source_ns": PING_WALL + 4_000},
        {"reply_received_ns": PING_WALL + 121_000, "relay_source_ns": PING_WALL + 16_000},
    ],
)
def test_a_wall_clock_set_during_the_session_voids_the_run(stamps):
    assert breakdown_of([MESSAGE, {**MESSAGE, **stamps}])["part"].to_list() == COARSE
    # And the group, of which the other run alone would be a part.
    rows = [frame_of([MESSAGE], run_id=1), frame_of([{**MESSAGE, **stamps}], run_id=2)]
    assert breakdown_frame(*paired(pl.concat(rows), **WALLS))["part"].to_list() == COARSE


def test_a_stamp_on_its_anchor_contradicts_nothing():
    at_once = {
        "relay_source_ns": PING_WALL + 5_000,
        "relay_received_ns": RELAY_WALL + 60_000,
        "reply_source_ns": RELAY_WALL + 70_000,
        "reply_received_ns": PING_WALL + 120_000,
    }
    table = breakdown_of([{**MESSAGE, **at_once}])
    assert table["mean_ns"].to_list() == [5_000, 55_000, 0, 10_000, 50_000, 0]
    assert bounds(table)["relay_delivery_ns"] == 0


def test_a_bridge_writes_its_own_source_stamps():
    bridged = {**MESSAGE, "relay_source_ns": 1, "reply_source_ns": 1}
    table = breakdown_of([bridged], bridge="builtin")
    assert means(table)["relay_delivery_ns"] == 15_000
    assert table["bound_ns"].to_list() == [0, None, None, 0, None, None]


def test_without_a_source_stamp_one_side_of_an_anchor_is_not_judged():
    unknown = {**MESSAGE, "reply_source_ns": 0}
    runs = [frame_of([unknown], run_id=1), frame_of([MESSAGE, MESSAGE], run_id=2)]
    assert breakdown_of([unknown])["bound_ns"][2] is None
    table = breakdown_frame(*paired(pl.concat(runs), **WALLS))
    assert table["messages"].to_list() == [3] * 6
    assert table["bound_ns"].to_list() == [0, 15_000, 15_000, 0, 15_000, 15_000]  # of the two that are judged


def test_lost_messages_are_no_part_of_it():
    lost = {k: v for k, v in MESSAGE.items() if k not in {"receive_ns", "reply_source_ns", "reply_received_ns"}}
    table = breakdown_of([lost, MESSAGE, lost])
    assert table["messages"].to_list() == [1] * 6
    assert table["mean_ns"].sum() == 120_000


def test_a_group_is_summarized_in_detail_and_its_means_add_up():
    later = {k: v + 1_000_000 for k, v in MESSAGE.items()}
    slow = {**later, "receive_ns": 1_140_000, "reply_received_ns": PING_WALL + 1_112_000}
    table = breakdown_of([MESSAGE, slow])
    assert table["part"].to_list() == list(STAGES)
    assert table["mean_ns"].to_list() == [5_000, 40_000, 15_000, 10_000, 42_000, 18_000]
    assert table["p50_ns"].to_list() == [5_000, 40_000, 15_000, 10_000, 42_000, 18_000]  # half of 8 and 28
    assert table["mean_ns"].sum() == (120_000 + 140_000) / 2
    assert table["bound_ns"].to_list() == [0, 15_000, 15_000, 0, 15_000, 15_000]
    assert table["p99_ns"].to_list() == [None] * 6
    assert table["messages"].to_list() == [2] * 6


def test_p99_takes_a_hundred_messages():
    rows = [{**MESSAGE, "scheduled_ns": -10 * number} for number in range(100)]
    waiting = breakdown_of(rows).row(0, named=True)
    assert waiting["p99_ns"] == pytest.approx(5_000 + 0.99 * 990)
    assert breakdown_of(rows[:-1])["p99_ns"].to_list() == [None] * 6


def test_a_group_with_gaps_is_summarized_by_whole_ways():
    bare = {**MESSAGE, "relay_received_ns": 0}
    table = breakdown_of([MESSAGE, bare])
    assert table["part"].to_list() == COARSE
    assert table["mean_ns"].to_list() == [5_000, 55_000, 10_000, 50_000]


def test_groups_have_rows_of_their_own_and_none_where_they_are_here_in_part():
    frames = [frame_of([MESSAGE] * (2 + group), run_id=1 + group) for group in range(2)]
    frames.append(frame_of([{"publish_ns": 0}], run_id=3))
    held = pl.concat([rows.select(frames[2].columns) for rows in frames]).with_columns(
        group=pl.col("run_id").cast(pl.UInt32) + 6
    )
    batch, roundtrips = paired(held, relay_wall={1: RELAY_WALL})
    table = breakdown_frame(batch, roundtrips)
    assert table.select("group", "part", "messages").rows() == [
        (group, part, messages) for group, messages in ((7, 2), (8, 3)) for part in COARSE
    ]
    assert response_frame(batch, roundtrips).select("group", "messages").rows() == [(7, 2), (8, 3)]
    in_part = replace(batch, whole=False)
    assert breakdown_frame(in_part, roundtrips).is_empty()
    assert response_frame(in_part, roundtrips).is_empty()


def test_waiting_shows_in_the_response_and_not_in_the_round_trip():
    # 10 Hz. A stall: message 1 is planned at 100 ms and sent at 250 ms, message 2 planned at 200, sent at 260.
    plan = [(0, 0), (100, 250), (200, 260), (300, 300)]
    frame = roundtrips(
        [{"scheduled_ns": t0 * MS, "publish_ns": t1 * MS, "receive_ns": (t1 + 2) * MS} for t0, t1 in plan]
    )
    (row,) = response_frame(*paired(frame)).iter_rows(named=True)
    assert (row["messages"], row["late_ratio"], row["waiting_max_ns"]) == (4, 0.5, 150 * MS)
    assert row["rtt_p50_ns"] == 2 * MS
    assert row["response_p50_ns"] == (2 + 62) / 2 * MS  # of 2, 2, 62, 152
    assert row["hidden_p50_ns"] == 30 * MS
    assert row["rtt_p99_ns"] is None


def test_p99_of_responses_takes_a_hundred_messages_and_a_late_one_more_than_a_tenth_of_the_period():
    # 10 Hz: of 99 messages one is 10 ms late, and the last one by a nanosecond more.
    rows = [{"scheduled_ns": 0, "publish_ns": 10 * MS + (n > 98), "receive_ns": (20 + n) * MS} for n in range(100)]
    (row,) = response_frame(*paired(roundtrips(rows))).iter_rows(named=True)
    assert row["late_ratio"] == 0.01
    assert row["response_p99_ns"] == pytest.approx((20 + 98.01) * MS)
    assert row["hidden_p99_ns"] == pytest.approx(10 * MS)
    assert response_frame(*paired(roundtrips(rows[1:])))["response_p99_ns"].to_list() == [None]


def test_without_a_rate_nothing_is_late():
    frame = roundtrips([{"scheduled_ns": 0, "publish_ns": 9 * MS, "receive_ns": 10 * MS}], rate_hz=0.0)
    assert response_frame(*paired(frame))["late_ratio"].to_list() == [0.0]


@pytest.mark.parametrize("rows", [[], [{"publish_ns": 0}]])
def test_without_a_reply_frames_have_their_columns(rows):
    held = paired(frame_of(rows))
    for table, schema in ((breakdown_frame(*held), BREAKDOWN_SCHEMA), (response_frame(*held), RESPONSE_SCHEMA)):
        assert table.is_empty()
        assert dict(table.schema) == schema


FLOOR = {"median_ns": 40_000, "p99_ns": 90_000, "messages": 50}
COST = {"record_median_ns": 3_000}


@pytest.mark.parametrize(
    ("of_ping", "of_relay", "cost_ns"),
    [
        (
            {"client_library_floor": FLOOR, "recorder_cost": COST},
            {"client_library_floor": {"median_ns": 50_000}, "recorder_cost": {"record_median_ns": 4_000}},
            40_000 + 50_000 + 2 * 4_000,  # both floors, and the two events of the relay
        ),
        ({}, {"client_library_floor": FLOOR}, None),
        ({"client_library_floor": FLOOR}, {}, None),
        ({"client_library_floor": FLOOR}, None, None),
        ({"client_library_floor": FLOOR}, {"client_library_floor": {"median_ns": "40"}}, None),
        ({"client_library_floor": FLOOR}, {"client_library_floor": {"median_ns": float("nan")}}, None),
        ({"client_library_floor": 7}, {"client_library_floor": FLOOR}, None),
    ],
)
def test_a_side_that_measured_none_leaves_the_own_cost_unknown(of_ping, of_relay, cost_ns):
    relay = None if of_relay is None else relay_session(extra=of_relay)
    assert own_cost_ns(ping_session(extra=of_ping), relay) == cost_ns


def test_the_share_is_that_of_the_median_round_trip():
    frame = pl.DataFrame({"own_cost_ns": [50.0, None, 50.0], "rtt_p50_ns": [200.0, 200.0, None]})
    shares = frame.select(ratio(pl.col("own_cost_ns"), pl.col("rtt_p50_ns"))).to_series()
    assert shares.to_list() == [0.25, None, None]
