"""Intervals of one-way times hold what the clocks leave open: known ways, on a link that is slower on its way back."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from roundtrip_frames import MS, S, roundtrips, with_one_way

from dds_trace.analyzer.groups.intervals import interval_rows

OUT_NS, BACK_NS = 2 * MS, 3 * MS
"""Medians of the two ways. Nobody can see the difference: the clocks seem to be off by half a millisecond."""


def ways(centre_ns, seed, messages=300):
    """Times of one way, mostly quick, with a tail; none is below 90 % of the centre."""
    return (centre_ns * (0.9 + np.random.default_rng(seed).exponential(0.144, messages))).astype(np.int64)


@pytest.fixture(scope="module")
def measured():
    """Three runs between two devices whose clocks are 7 s apart, with their true ways."""
    runs, out, back = [], [], []
    for number in range(3):
        out.append(ways(OUT_NS, number))
        back.append(ways(BACK_NS, 10 + number))
        rows = [
            {
                "publish_ns": sent,
                "relay_in_ns": sent + there + 7 * S,
                "relay_out_ns": sent + there + 1000 + 7 * S,
                "receive_ns": sent + there + 1000 + again,
            }
            for sent, there, again in zip(
                range(0, 30 * S, 100 * MS), out[-1].tolist(), back[-1].tolist(), strict=True
            )
        ]
        runs.append(roundtrips(rows, run_id=number + 1))
    frame = with_one_way(pl.concat(runs))
    truth = {"outbound": np.concatenate(out), "return": np.concatenate(back)}
    found = interval_rows(0, frame.get_column, np.repeat(np.arange(3), 300))
    return {(row["metric"], row["percentile"]): row for row in found}, truth, frame


@pytest.mark.parametrize("metric", ["outbound", "return"])
@pytest.mark.parametrize(("percentile", "quantile"), [("p50", 0.5), ("p90", 0.9)])
def test_the_interval_of_a_one_way_time_holds_the_true_one(measured, metric, percentile, quantile):
    rows, truth, frame = measured
    row, true_ns = rows[metric, percentile], np.quantile(truth[metric], quantile)
    bound_ns = frame["clock_bound_ns"].max()
    assert row["basis"] == "between runs"
    assert row["low_ns"] <= true_ns <= row["high_ns"]
    # The runs alone say otherwise: they agree with each other, and all are wrong by the same half of a millisecond.
    assert not row["low_ns"] + bound_ns <= true_ns <= row["high_ns"] - bound_ns
    assert bound_ns > 0.4 * MS


def test_the_interval_of_the_latency_needs_no_clock(measured):
    rows, truth, _ = measured
    row = rows["latency", "p50"]
    true_ns = np.quantile((truth["outbound"] + truth["return"]) / 2, 0.5)
    assert row["low_ns"] <= true_ns <= row["high_ns"]
    assert row["high_ns"] - row["low_ns"] < 0.5 * MS


def test_on_one_machine_one_way_intervals_are_not_widened(measured):
    frame = measured[2].with_columns(
        relay_device=pl.col("ping_device"),
        relay_in_ns=pl.col("relay_in_ns") - 7 * S,
        relay_out_ns=pl.col("relay_out_ns") - 7 * S,
    )
    exact = with_one_way(frame)
    assert exact["clock_bound_ns"].max() == 0
    found = interval_rows(0, exact.get_column, np.repeat(np.arange(3), 300))
    row = next(row for row in found if (row["metric"], row["percentile"]) == ("outbound", "p50"))
    assert row["low_ns"] <= np.quantile(measured[1]["outbound"], 0.5) <= row["high_ns"]
    assert row["high_ns"] - row["low_ns"] < 0.5 * MS
