from __future__ import annotations

import pytest

from dds_trace.recorder.backends.node import Endpoint
from dds_trace.recorder.backends.qos import (
    duration_extra,
    incompatible_pairs,
    mismatches,
    requested_durations,
    warn_of_depth,
)
from dds_trace.tracefile.format.descriptions import Qos

RELIABLE, BEST_EFFORT = Qos(), Qos(reliability="best_effort")
LATCHED = Qos(durability="transient_local")


@pytest.mark.parametrize(
    ("offered", "requested", "found"),
    [
        (RELIABLE, RELIABLE, []),
        (RELIABLE, BEST_EFFORT, []),
        (BEST_EFFORT, RELIABLE, ["reliability (best_effort offered, reliable requested)"]),
        (RELIABLE, LATCHED, ["durability (volatile offered, transient_local requested)"]),
        (LATCHED, RELIABLE, []),
        (Qos(reliability="unknown"), RELIABLE, []),
        (Qos(depth=1), Qos(depth=1000, history="keep_all"), []),
        (Qos(extra={"deadline_ns": 20_000_000}), Qos(extra={"deadline_ns": 20_000_000}), []),
        (Qos(extra={"deadline_ns": 5}), Qos(), []),
        (Qos(), Qos(extra={"deadline_ns": 20_000_000}), ["deadline (none offered, 20ms requested)"]),
        (
            Qos(extra={"deadline_ns": 1_500_000_000}),
            Qos(extra={"deadline_ns": 20_000_000}),
            ["deadline (1.5s offered, 20ms requested)"],
        ),
        (Qos(), Qos(extra={"lifespan_ns": 5}), []),
    ],
)
def test_offered_against_requested(offered, requested, found):
    assert mismatches(offered, requested) == found


def test_durations_without_end_are_left_out():
    told_ns = {"deadline": 20_000_000, "lifespan": (2**31 - 1) * 10**9}
    assert duration_extra(told_ns) == {"deadline_ns": 20_000_000}
    assert duration_extra({"deadline": 0, "lifespan": 2**63 - 1}) == {}
    assert requested_durations(Qos(extra={"lifespan_ns": 7, "vendor": "x"})) == {"lifespan": 7}


def test_pairs_of_ours_are_named_and_others_are_not(sentences):
    type_name = "sensor_msgs/msg/Imu"
    ours, theirs = Endpoint("me", type_name, BEST_EFFORT), Endpoint("they", type_name, RELIABLE)
    unknown = Endpoint("bare", type_name)
    (line,) = incompatible_pairs("imu_data", [ours, unknown], [theirs], "me")
    sentences(line)
    assert list(incompatible_pairs("imu_data", [ours], [theirs], "somebody")) == []


@pytest.mark.parametrize(
    ("history", "depth", "rate_hz", "warned"),
    [
        ("keep_last", 10, 100, True),
        ("keep_last", 10, 101, True),
        ("keep_last", 101, 1000, False),
        ("keep_last", 1, 10.5, True),
        ("keep_last", 1, 0.1, False),
        ("keep_all", 1, 1000, False),
    ],
)
def test_a_depth_below_rate_times_stall_is_warned_of(history, depth, rate_hz, warned):
    assert (warn_of_depth(history, depth, rate_hz) is not None) == warned


def test_the_warning_of_a_depth_says_how_long_it_lasts_and_what_would_do(sentences):
    sentences(warn_of_depth("keep_last", 10, 1000))
