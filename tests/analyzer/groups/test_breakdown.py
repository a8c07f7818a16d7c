"""Where the time goes, on one message drawn by hand and on runs that contradict themselves."""

from __future__ import annotations

import polars as pl
import pytest
from polars.testing import assert_frame_equal
from roundtrip_frames import MS, roundtrips, with_one_way

from dds_trace.analyzer.groups import breakdown
from dds_trace.analyzer.groups.breakdown import (
    STAGES,
    break_down,
    response_against_latency,
    summarize_breakdown,
)

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


def parts_of(rows, **parameters):
    frame = with_one_way(roundtrips(rows, **{"relay_device": "ping-pi", **parameters}))
    return break_down(frame, {1: PING_WALL}, {1: RELAY_WALL})


def test_every_part_of_one_message():
    row = parts_of([MESSAGE]).row(0, named=True)
    assert {name: row[name] for name in STAGES} == {
        "waiting_ns": 5_000,
        "outbound_transport_ns": 40_000,
        "relay_delivery_ns": 15_000,
        "relay_ns": 10_000,
        "return_transport_ns": 42_000,
        "ping_delivery_ns": 8_000,
    }
    assert sum(row[name] for name in STAGES) == row["response_ns"] == 120_000
    # The relay's anchor is off by at most 15 us (delivery) or 3 us (write), the ping's by 8 us or 2 us.
    assert row["delivery_bound_ns"] == 15_000
    assert row["clock_bound_ns"] == 0


def test_without_reception_stamps_the_whole_ways_remain():
    bare = {k: v for k, v in MESSAGE.items() if "source" not in k and "received" not in k}
    for rows in ([bare], [{**MESSAGE, "relay_received_ns": 0, "reply_received_ns": 0}]):
        row = parts_of(rows).row(0, named=True)
        assert (row["waiting_ns"], row["outbound_ns"], row["relay_ns"], row["return_ns"]) == (
            5000,
            55000,
            10000,
            50000,
        )
        assert row["outbound_transport_ns"] is None
        assert row["ping_delivery_ns"] is None


def test_without_anchors_nothing_is_mixed():
    frame = with_one_way(roundtrips([MESSAGE]))
    row = break_down(frame).row(0, named=True)
    assert row["relay_delivery_ns"] is None
    assert row["outbound_ns"] is not None


@pytest.mark.parametrize("slice_rows", [1, 2, 4])
def test_slices_of_rows_have_the_anchors_of_the_whole_run(monkeypatch, slice_rows):
    """The last message contradicts the anchor of the relay, the second is nearest to that of the ping."""
    rows = [MESSAGE, {**MESSAGE, "reply_received_ns": PING_WALL + 119_000}, MESSAGE, MESSAGE]
    rows.append({**MESSAGE, "relay_received_ns": RELAY_WALL + 60_001})
    for held in (rows, rows[:-1]):
        monkeypatch.undo()
        whole = parts_of(held)
        assert whole["relay_delivery_ns"].is_null().all() == (held is rows)
        monkeypatch.setattr(breakdown, "_SLICE_ROWS", slice_rows)
        assert_frame_equal(parts_of(held), whole)


def test_a_wall_clock_set_during_the_session_voids_the_run():
    # The relay's wall clock was set back by 5 us: its replies seem to be written before T4 (3 us - 5 us < 0).
    back = {**MESSAGE, "relay_received_ns": RELAY_WALL + 40_000, "reply_source_ns": RELAY_WALL + 68_000}
    row = parts_of([back]).row(0, named=True)
    assert row["relay_delivery_ns"] is None
    assert row["outbound_transport_ns"] is None
    assert row["ping_delivery_ns"] == 8_000
    # Set forward by 20 us: messages seem to be delivered before they came.
    ahead = {**MESSAGE, "relay_received_ns": RELAY_WALL + 65_000, "reply_source_ns": RELAY_WALL + 93_000}
    assert parts_of([MESSAGE, ahead])["relay_delivery_ns"].to_list() == [None, None]


def test_a_bridge_writes_its_own_source_stamps():
    bridged = {**MESSAGE, "relay_source_ns": 1, "reply_source_ns": 1}
    row = parts_of([bridged], bridge="builtin").row(0, named=True)
    assert row["relay_delivery_ns"] == 15_000
    assert row["delivery_bound_ns"] is None


def test_lost_messages_have_the_parts_they_got_to():
    lost = {
        k: v for k, v in MESSAGE.items() if k not in {"receive_ns", "reply_source_ns", "reply_received_ns"}
    }
    row = parts_of([MESSAGE, lost]).row(1, named=True)
    assert (row["waiting_ns"], row["relay_ns"], row["relay_delivery_ns"]) == (5_000, 10_000, 15_000)
    assert row["outbound_transport_ns"] is None  # no fit without T2


def test_a_group_is_summarized_in_detail_and_its_means_add_up():
    later = {k: v + 1_000_000 for k, v in MESSAGE.items()}
    slow = {**later, "receive_ns": 1_140_000, "reply_received_ns": PING_WALL + 1_112_000}
    table = summarize_breakdown(parts_of([MESSAGE, slow]), ["vendor"])
    assert table["part"].to_list() == list(STAGES)
    assert table["mean_ns"].to_list() == [5_000, 40_000, 15_000, 10_000, 42_000, 18_000]
    assert table["mean_ns"].sum() == (120_000 + 140_000) / 2
    assert table["bound_ns"].to_list() == [0, 15_000, 15_000, 0, 15_000, 15_000]
    assert table["p99_ns"].to_list() == [None] * 6
    assert table["messages"].to_list() == [2] * 6


def test_a_group_with_gaps_is_summarized_by_whole_ways():
    bare = {**MESSAGE, "relay_received_ns": 0}
    table = summarize_breakdown(parts_of([MESSAGE, bare]), ["vendor", "payload_bytes"])
    assert table["part"].to_list() == ["waiting_ns", "outbound_ns", "relay_ns", "return_ns"]
    assert table["mean_ns"].to_list() == [5_000, 55_000, 10_000, 50_000]
    assert summarize_breakdown(parts_of([]), ["vendor"]).is_empty()


def test_waiting_shows_in_the_response_and_not_in_the_round_trip():
    # 10 Hz. A stall: message 1 is planned at 100 ms and sent at 250 ms, message 2 planned at 200, sent at 260.
    plan = [(0, 0), (100, 250), (200, 260), (300, 300)]
    frame = roundtrips(
        [{"scheduled_ns": t0 * MS, "publish_ns": t1 * MS, "receive_ns": (t1 + 2) * MS} for t0, t1 in plan],
    )
    (row,) = response_against_latency(frame, ["vendor"]).iter_rows(named=True)
    assert (row["messages"], row["late_ratio"], row["waiting_max_ns"]) == (4, 0.5, 150 * MS)
    assert row["rtt_p50_ns"] == 2 * MS
    assert row["response_p50_ns"] == (2 + 62) / 2 * MS  # of 2, 2, 62, 152
    assert row["hidden_p50_ns"] == 30 * MS
    assert row["rtt_p99_ns"] is None


@pytest.mark.parametrize("rows", [[], [{"publish_ns": 0}]])
def test_without_a_reply_frames_have_their_columns(rows):
    parts = parts_of(rows)
    assert set(STAGES) <= set(parts.columns)
    assert all(parts.schema[name] == pl.Int64 for name in STAGES)
    assert response_against_latency(parts, ["vendor"]).is_empty()
