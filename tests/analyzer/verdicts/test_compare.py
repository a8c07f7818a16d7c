"""Comparisons of samples whose truth is known, verdicts by hand, and the cost of a bridge."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from roundtrip_frames import MS, steady

from dds_trace.analyzer.verdicts.change import (
    Change,
    ChangeVerdict,
    Sample,
    change_of,
    probability_of_superiority,
)
from dds_trace.analyzer.verdicts.compare import CompareOptions, compare_roundtrips

P50_ONLY = CompareOptions(metrics=("latency",), statistics=("p50",), replicates=199)


def drawn(messages: int, mean_ns: float, seed: int):
    """Latencies from 1 ms up with an exponential tail."""
    return Sample((MS + np.random.default_rng(seed).exponential(mean_ns, messages)).astype(np.int64))


def change(low, high):
    return Change(1.0, 1.0, None, None, 0.0, None, None, 1.0, low, high)


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [
        (0.96, 1.04, ChangeVerdict.SAME),
        (1.01, 1.04, ChangeVerdict.SAME),  # surely slower, and by too little to matter
        (0.80, 0.97, ChangeVerdict.BETTER),
        (1.02, 1.30, ChangeVerdict.WORSE),
        (0.90, 1.10, ChangeVerdict.INCONCLUSIVE),
        (None, None, ChangeVerdict.INCONCLUSIVE),
    ],
)
def test_verdicts(low, high, verdict):
    assert change(low, high).verdict(0.05) is verdict


def test_a_change_by_hand():
    base, new = Sample(np.full(50, 10 * MS)), Sample(np.full(50, 12 * MS))
    found = change_of(base, new, "p50")
    assert (found.base, found.new, found.difference, found.ratio) == (10 * MS, 12 * MS, 2 * MS, 1.2)
    assert (found.difference_low, found.difference_high) == (2 * MS, 2 * MS)
    assert (found.ratio_low, found.ratio_high) == (1.2, 1.2)


def test_the_interval_of_a_ratio_holds_the_true_ratio():
    # Medians are 1 ms + ln 2 * mean: 1 + 0.693 * 1 = 1.693 and 1 + 0.693 * 1.5 = 2.040; ratio 1.2048.
    true = (1 + np.log(2) * 1.5) / (1 + np.log(2))
    held = 0
    for seed in range(60):
        found = change_of(drawn(400, MS, seed), drawn(400, 1.5 * MS, 1000 + seed), "p50", replicates=399)
        held += found.ratio_low <= true <= found.ratio_high
        assert found.ratio_low <= found.ratio <= found.ratio_high
    assert held >= 51  # 57 expected, standard deviation 1.7


def test_equal_sides_are_not_called_different():
    called = [
        change_of(drawn(400, MS, seed), drawn(400, MS, 1000 + seed), "p90", replicates=399).verdict(0.01)
        for seed in range(60)
    ]
    assert sum(v in {ChangeVerdict.BETTER, ChangeVerdict.WORSE} for v in called) <= 8  # 3 expected


def test_samples_too_small_for_an_interval_have_values_without_one():
    found = change_of(drawn(200, MS, 1), drawn(200, MS, 2), "p99")  # an interval takes 368
    assert found.base is not None
    assert found.ratio is not None
    assert (found.ratio_low, found.new_low) == (None, None)
    assert change_of(drawn(50, MS, 1), drawn(50, MS, 2), "p99").base is None
    nothing = Sample(np.empty(0, np.int64))
    assert change_of(nothing, nothing, "mean") == Change(*[None] * 10)
    assert change_of(drawn(5, MS, 1), drawn(400, MS, 2), "mean").ratio_low is None


def test_a_base_of_zero_has_no_ratio():
    found = change_of(Sample(np.zeros(50, np.int64)), Sample(np.full(50, 5)), "p50")
    assert (found.difference, found.ratio, found.ratio_low) == (5.0, None, None)


def test_superiority_counts_pairs():
    base, new = Sample(np.array([10, 20, 30])), Sample(np.array([5, 20]))
    # 5 beats all three; 20 beats 30, ties with 20: (3 + 1 + 0.5) of 6 pairs.
    assert probability_of_superiority(base, new) == 4.5 / 6
    assert probability_of_superiority(base, Sample(np.empty(0))) is None


@given(
    base=st.lists(st.integers(0, 50), min_size=1, max_size=30),
    new=st.lists(st.integers(0, 50), min_size=1, max_size=30),
)
@settings(deadline=None)
def test_superiority_is_the_mean_over_all_pairs(base, new):
    pairs = [(b > n) + (b == n) / 2 for b in base for n in new]
    found = probability_of_superiority(Sample(np.array(base)), Sample(np.array(new)))
    assert found == pytest.approx(np.mean(pairs))


def test_a_machine_that_replaced_the_only_other_one_is_compared_with_it():
    base = pl.concat([steady([5 * MS] * 20), steady([7 * MS] * 20, run_id=2, payload_bytes=502_000)])
    new = pl.concat(
        [
            steady([10 * MS] * 20, ping_device="other-pi", ping_domain_id=7, relay_domain_id=7),
            steady([7 * MS] * 20, run_id=3, rate_hz=20.0, ping_device="other-pi"),
        ],
    )
    found = compare_roundtrips(base, new, P50_ONLY)
    (row,) = found.rows.iter_rows(named=True)
    assert (row["vendor"], row["payload_bytes"], row["metric"], row["statistic"]) == (
        "fastdds",
        33_000,
        "latency",
        "p50",
    )
    assert (row["base_ns"], row["new_ns"], row["ratio"], row["verdict"]) == (5 * MS, 10 * MS, 2.0, "worse")
    assert (row["base_messages"], row["new_messages"]) == (20, 20)
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
    assert (row["base_published"], row["base_received_ratio"], row["base_received_ratio_high"]) == (
        20,
        1.0,
        1.0,
    )
    assert (row["new_published"], row["new_received_ratio"]) == (20, 0.5)
    assert row["new_received_ratio_low"] == pytest.approx(0.299, abs=1e-3)
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
    base, new = steady(drawn(200, MS, 1).values.tolist()), steady(drawn(200, MS, 2).values.tolist())
    first = compare_roundtrips(base, new)
    assert first.rows.equals(compare_roundtrips(base, new).rows)
    assert first.rows.equals(compare_roundtrips(base.sample(fraction=1, shuffle=True, seed=3), new).rows)
    assert first.rows["statistic"].to_list() == ["mean", "p50", "p90", "p95", "p99", "p99_9"] * 2
