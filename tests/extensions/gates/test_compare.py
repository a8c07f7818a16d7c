import math

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from roundtrip_frames import MS, in_runs, of_sizes, steady

from dds_trace.analyzer.statistics.percentiles import PERCENTILES
from dds_trace.extensions.gates.compare import CompareOptions, compare_roundtrips
from dds_trace.extensions.gates.costs import bridge_cost
from dds_trace.extensions.gates.detectable import probability_of_superiority

P50_ONLY = CompareOptions(metrics=("latency",), statistics=("p50",))


def drawn(messages, mean_ns, seed):
    return (MS + np.random.default_rng(seed).exponential(mean_ns, messages)).astype(np.int64).tolist()


@given(
    base=st.lists(st.integers(0, 50), min_size=1, max_size=30),
    new=st.lists(st.integers(0, 50), min_size=1, max_size=30),
)
def test_superiority_is_the_mean_over_all_pairs(base, new):
    pairs = [(b > n) + (b == n) / 2 for b in base for n in new]
    assert probability_of_superiority(np.sort(base), np.sort(new)) == pytest.approx(np.mean(pairs))
    assert probability_of_superiority(np.sort(base), np.empty(0)) is None


def test_one_run_a_side_has_an_interval_and_no_verdict():
    (row,) = compare_roundtrips(steady(drawn(400, MS, 1)), steady(drawn(400, 9 * MS, 2)), P50_ONLY).rows.iter_rows(
        named=True
    )
    assert row["ratio_low"] > 2
    assert (row["verdict"], row["basis"], row["p_value"]) == ("inconclusive", "within one run", None)
    assert (row["base_runs"], row["new_runs"]) == (1, 1)


def test_a_side_that_loses_its_slow_messages_is_not_better():
    # p99: the base takes 100 ms, of the new side five in a hundred are lost and the rest takes 1 ms.
    base = in_runs([100 * MS if i % 20 == 0 else MS for i in range(400)])
    new = in_runs([None if i % 20 == 0 else MS for i in range(400)])
    options = CompareOptions(metrics=("latency",), statistics=("p99",))
    (row,) = compare_roundtrips(base, new, options).rows.iter_rows(named=True)
    assert row["verdict"] != "better"
    assert row["new_ns"] == math.inf
    assert row["new_survivors_ns"] == pytest.approx(MS, rel=0.05)
    assert (row["base_received_ratio"], row["new_received_ratio"]) == (1.0, 0.95)


def test_a_relay_without_a_trace_matches_any():
    base = in_runs([5 * MS] * 20)
    dead = in_runs([None] * 20, relay_vendor=None, relay_backend=None)
    found = compare_roundtrips(base, dead, P50_ONLY)
    assert found.delivery["is_dead"].to_list() == [True]
    assert found.delivery["relay_vendor"].to_list() == ["fastdds"]
    assert (found.only_base.height, found.only_new.height) == (0, 0)
    two = pl.concat([base, in_runs([5 * MS] * 20, run_id=2, relay_vendor="zenoh")])
    assert compare_roundtrips(two, dead, P50_ONLY).delivery.is_empty()  # nobody knows which of the two it is


def test_verdicts_of_many_groups_are_adjusted():
    # One of forty groups has a p value of about 0.02: alone it is worse, among forty it is not.
    alone = compare_roundtrips(of_sizes([1.0]), of_sizes([1.1]), P50_ONLY).rows
    among = compare_roundtrips(of_sizes([1.0] * 40), of_sizes([1.1] + [1.0] * 39), P50_ONLY).rows
    assert alone["verdict"].to_list() == ["worse"]
    assert 0.005 < alone["p_value"][0] < 0.05
    first = among.row(0, named=True)
    assert first["p_value"] == pytest.approx(alone["p_value"][0])
    assert first["p_adjusted"] == pytest.approx(40 * first["p_value"])
    assert first["verdict"] == "inconclusive"


def test_the_smallest_change_that_would_have_been_found_is_told():
    (row,) = compare_roundtrips(in_runs([MS] * 30), in_runs([MS] * 30, run_id=2), P50_ONLY).rows.iter_rows(named=True)
    # Logarithms 3 % apart: error sqrt(2/3) * log(1.03); 3.761 of them are found in 80 of 100 (test_distributions).
    assert math.log(row["smallest_ratio"]) == pytest.approx(3.761 * math.sqrt(2 / 3) * math.log(1.03), rel=1e-3)


def test_a_machine_that_replaced_the_only_other_one_is_compared_with_it():
    base = pl.concat([in_runs([5 * MS] * 20), steady([7 * MS] * 20, run_id=2, payload_bytes=502_000)])
    new = pl.concat(
        [
            in_runs([10 * MS] * 20, ping_device="other-pi", ping_domain_id=7, relay_domain_id=7),
            steady([7 * MS] * 20, run_id=3, rate_hz=20.0, ping_device="other-pi"),
        ]
    )
    found = compare_roundtrips(base, new, P50_ONLY)
    (row,) = found.rows.iter_rows(named=True)
    assert (row["vendor"], row["payload_bytes"], row["metric"], row["statistic"]) == (
        "fastdds",
        33_000,
        "latency",
        "p50",
    )
    assert (row["base_ns"], row["new_ns"]) == (pytest.approx(5 * MS), pytest.approx(10 * MS))
    assert (row["ratio"], row["verdict"]) == (pytest.approx(2.0), "worse")
    assert (row["base_messages"], row["new_messages"]) == (60, 60)
    assert (row["superiority"], row["cliffs_delta"]) == (0.0, -1.0)
    assert found.only_base["payload_bytes"].to_list() == [502_000]
    assert found.only_new["rate_hz"].to_list() == [20.0]
    assert row["ping_device"] == "ping-pi"


def test_of_several_devices_each_is_compared_with_itself():
    base = pl.concat([steady([5 * MS] * 20), steady([50 * MS] * 20, run_id=2, ping_device="slow-pi")])
    new = pl.concat(
        [
            steady([10 * MS] * 20, run_id=3, ping_device="other-pi"),
            steady([50 * MS] * 20, run_id=4, ping_device="slow-pi"),
        ]
    )
    found = compare_roundtrips(base, new, P50_ONLY)
    assert found.rows["ping_device"].to_list() == ["slow-pi"]
    assert (found.rows["base_ns"].item(), found.rows["new_ns"].item()) == (50 * MS, 50 * MS)
    assert found.only_base["ping_device"].to_list() == ["ping-pi"]
    assert found.only_new["ping_device"].to_list() == ["other-pi"]


def test_losses_are_compared_beside_the_times():
    found = compare_roundtrips(steady([5 * MS] * 20), steady([5 * MS, None] * 10), P50_ONLY)
    (row,) = found.delivery.iter_rows(named=True)
    assert (row["base_published"], row["base_received_ratio"], row["base_received_ratio_high"]) == (20, 1.0, 1.0)
    assert (row["new_published"], row["new_received_ratio"]) == (20, 0.5)
    assert row["new_received_ratio_low"] == pytest.approx(0.281, abs=1e-3)  # Wilson with t of 12 degrees, 2.179
    assert found.rows["new_messages"].to_list() == [10]


def test_null_parameters_match_each_other():
    bare = steady([5 * MS] * 20, rmw=None, relay_vendor=None, backend="zenoh")
    assert compare_roundtrips(bare, bare, P50_ONLY).rows.height == 1


def test_nothing_in_common_and_nothing_at_all():
    found = compare_roundtrips(steady([MS] * 3), steady([MS] * 3, vendor="zenoh"), P50_ONLY)
    assert found.rows.is_empty()
    assert (found.only_base.height, found.only_new.height) == (1, 1)
    empty = compare_roundtrips(steady([]), steady([]))
    assert empty.rows.is_empty()
    assert empty.rows.schema["ratio_low"] == pl.Float64


def test_equal_input_gives_equal_rows():
    base, new = steady(drawn(200, MS, 1)), steady(drawn(200, MS, 2))
    first = compare_roundtrips(base, new)
    assert first.rows.equals(compare_roundtrips(base, new).rows)
    assert first.rows.equals(compare_roundtrips(base.sample(fraction=1, shuffle=True, seed=3), new).rows)
    assert first.rows["statistic"].to_list() == ["mean", *(percentile.name for percentile in PERCENTILES)] * 2


def test_cost_of_each_bridge():
    same = in_runs([5 * MS] * 20)
    apart = {"domain_mode": "different", "relay_domain_id": 10}
    frame = pl.concat(
        [
            same,
            in_runs([8 * MS] * 20, run_id=2, bridge="builtin", **apart),
            in_runs([20 * MS, 20 * MS, 20 * MS, None] * 5, run_id=3, bridge="zenoh-bridge-dds", **apart),
            steady([9 * MS] * 20, run_id=4, bridge="builtin", payload_bytes=502_000, **apart),  # no partner
        ]
    )
    cost = bridge_cost(frame, P50_ONLY)
    assert cost.select("bridge", "payload_bytes").rows() == [("builtin", 33_000), ("zenoh-bridge-dds", 33_000)]
    assert cost["base_ns"].to_list() == pytest.approx([5 * MS, 5 * MS])
    assert cost["new_ns"].to_list() == pytest.approx([8 * MS, 20 * MS])
    assert cost["difference_ns"].to_list() == pytest.approx([3 * MS, 15 * MS])
    assert cost["new_received_ratio"].to_list() == [1.0, 0.75]
    assert cost["verdict"].to_list() == ["worse", "worse"]
    without = bridge_cost(same, P50_ONLY)
    assert without.is_empty()
    assert without.columns == cost.columns
