from __future__ import annotations

import polars as pl
import pytest
from trace_files import ping_session, relay_session

from dds_trace.analyzer.groups.summary import own_cost_ns, ratio

FLOOR = {"median_ns": 40_000, "p99_ns": 90_000, "messages": 50}
COST = {"record_median_ns": 3_000}


def test_both_floors_and_the_two_events_of_the_relay():
    ping = ping_session(extra={"client_library_floor": FLOOR, "recorder_cost": COST})
    relay = relay_session(
        extra={"client_library_floor": {"median_ns": 50_000}, "recorder_cost": {"record_median_ns": 4_000}}
    )
    assert own_cost_ns(ping, relay) == 40_000 + 50_000 + 2 * 4_000


@pytest.mark.parametrize(
    ("of_ping", "of_relay"),
    [
        ({}, {"client_library_floor": FLOOR}),
        ({"client_library_floor": FLOOR}, {}),
        ({"client_library_floor": FLOOR}, None),
        ({"client_library_floor": FLOOR}, {"client_library_floor": {"median_ns": "40"}}),
        ({"client_library_floor": FLOOR}, {"client_library_floor": {"median_ns": float("nan")}}),
        ({"client_library_floor": 7}, {"client_library_floor": FLOOR}),
    ],
)
def test_a_side_that_measured_none_leaves_it_unknown(of_ping, of_relay):
    relay = None if of_relay is None else relay_session(extra=of_relay)
    assert own_cost_ns(ping_session(extra=of_ping), relay) is None


def test_the_share_is_that_of_the_median_round_trip():
    frame = pl.DataFrame({"own_cost_ns": [50.0, None, 50.0], "rtt_p50_ns": [200.0, 200.0, None]})
    assert frame.select(ratio(pl.col("own_cost_ns"), pl.col("rtt_p50_ns")).alias("share"))["share"].to_list() == [
        0.25,
        None,
        None,
    ]
