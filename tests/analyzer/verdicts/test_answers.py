"""The first screen's answers on campaigns whose truth is known."""

from __future__ import annotations

import math

import numpy as np
import polars as pl
from roundtrip_frames import MS, rows_by_group, steady

from dds_trace.analyzer.verdicts.answers import Clarity, Headline, Lead, find_answers, find_headlines


def noisy(centre_ns, messages=60, seed=0):
    return (centre_ns * (1 + 0.1 * np.random.default_rng(seed).uniform(-1, 1, messages))).astype(int).tolist()


def test_a_clear_leader():
    frame = pl.concat([steady(noisy(10 * MS)), steady(noisy(5 * MS), vendor="cyclonedds", run_id=2)])
    (answer,) = find_answers(rows_by_group(frame))
    assert (answer.connectivity, answer.domain_mode, answer.data_type) == ("wired", "same", "binary")
    assert (answer.payload_bytes, answer.rate_hz) == (33_000, 10.0)
    assert answer.clarity is Clarity.CLEAR
    assert answer.percentile == "p50"  # 60 messages carry no interval for p99
    assert [c.name for c in answer.contenders] == ["cyclonedds to fastdds", "fastdds"]
    assert [c.name for c in answer.leaders] == ["cyclonedds to fastdds"]
    assert answer.contenders[0].latency.upper < answer.contenders[1].latency.lower
    assert answer.contenders[0].received.value == 1.0


def test_overlapping_intervals_are_inconclusive():
    frame = pl.concat([steady(noisy(10 * MS)), steady(noisy(10 * MS, seed=9), bridge="builtin", run_id=2)])
    (answer,) = find_answers(rows_by_group(frame))
    assert answer.clarity is Clarity.INCONCLUSIVE
    assert {c.name for c in answer.leaders} == {"fastdds", "fastdds via builtin"}


def test_sockets_are_the_floor_and_no_contender():
    floor = steady(noisy(MS), vendor="socket", backend="socket", run_id=3)
    (answer,) = find_answers(rows_by_group(pl.concat([steady(noisy(10 * MS)), floor])))
    assert answer.clarity is Clarity.ONLY_ONE
    assert [c.name for c in answer.contenders] == ["fastdds"]
    (alone,) = find_answers(rows_by_group(floor))
    assert [c.setting["backend"] for c in alone.contenders] == ["socket"]


def test_tails_are_compared_where_every_sample_supports_them():
    frame = pl.concat([steady(noisy(10 * MS, 400)), steady(noisy(5 * MS, 400), vendor="zenoh", run_id=2)])
    (answer,) = find_answers(rows_by_group(frame))
    assert answer.percentile == "p99"
    assert answer.clarity is Clarity.CLEAR


def test_losing_most_messages_is_not_fast():
    lossy = [MS if i % 4 == 0 else None for i in range(60)]
    frame = pl.concat([steady(noisy(10 * MS)), steady(lossy, reliability="best_effort", run_id=2)])
    (answer,) = find_answers(rows_by_group(frame))
    assert [c.name for c in answer.contenders] == [
        "fastdds, reliability reliable",
        "fastdds, reliability best_effort",
    ]
    assert answer.contenders[1].latency.value == math.inf
    assert answer.contenders[1].received.value == 0.25


def test_headlines_count_cases():
    runs = []
    for number, (size, cyclone_ns) in enumerate([(33_000, 5 * MS), (502_000, 6 * MS), (1_000_000, 10 * MS)]):
        runs.append(steady(noisy(10 * MS), payload_bytes=size, run_id=10 + number))
        runs.append(
            steady(
                noisy(cyclone_ns, seed=3),
                payload_bytes=size,
                run_id=20 + number,
                vendor="cyclonedds",
                relay_vendor="cyclonedds",
            ),
        )
    runs.append(steady(noisy(MS), data_type="imu", payload_bytes=296, run_id=30))
    headlines = find_headlines(find_answers(rows_by_group(pl.concat(runs))))
    assert headlines == (
        Headline("wired", "same", "binary", 3, (Lead("cyclonedds", 2),), inconclusive=1, only_one=0),
        Headline("wired", "same", "imu", 0, (), inconclusive=0, only_one=1),
    )


def test_contenders_have_names_that_tell_them_apart():
    frame = pl.concat(
        [
            steady(noisy(10 * MS), rmw="rmw_fastrtps_cpp"),
            steady(noisy(5 * MS), rmw="rmw_fastrtps_dynamic_cpp", run_id=2),
            steady(noisy(7 * MS), vendor="zenoh", relay_vendor="zenoh", relay_backend="zenoh", run_id=3),
            steady(noisy(8 * MS), vendor="zenoh", relay_vendor=None, relay_backend=None, run_id=4),
            steady(noisy(9 * MS), vendor="opendds", relay_vendor="opendds", run_id=5),
        ]
    )
    (answer,) = find_answers(rows_by_group(frame))
    assert [c.name for c in answer.contenders] == [
        "fastdds, rmw_fastrtps_dynamic_cpp",
        "zenoh, relay zenoh, relay by zenoh",
        "zenoh, relay unknown",
        "opendds",
        "fastdds, rmw_fastrtps_cpp",
    ]


def test_no_relay_trace_and_nothing_at_all():
    bare = steady([MS] * 9).with_columns(latency_ns=pl.lit(None, pl.Int64))
    (answer,) = find_answers(rows_by_group(bare))
    assert answer.clarity is Clarity.ONLY_ONE
    assert answer.contenders[0].latency.value is None
    assert find_answers(rows_by_group(steady([]))) == ()
    assert find_headlines(()) == ()
