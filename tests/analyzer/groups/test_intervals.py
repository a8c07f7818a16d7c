import numpy as np
import polars as pl
import polars.selectors as cs
import pytest
from polars.testing import assert_frame_equal
from roundtrip_frames import MS, S, roundtrips, with_one_way

from dds_trace.analyzer.groups.intervals import INTERVAL_SCHEMA, one_way_rows, rows_of_groups
from dds_trace.analyzer.run_statistics.between_runs import interval_of_runs
from dds_trace.analyzer.run_statistics.runs import Run, Statistic
from dds_trace.analyzer.statistics.percentiles import PERCENTILES

OUT_NS, BACK_NS = 2 * MS, 3 * MS
"""Medians of the two ways. Nobody can see the difference: the clocks seem to be off by half a millisecond."""


def interval_rows(group, column, run_of_row):
    return rows_of_groups([(group, column, run_of_row)])


def ways(centre_ns, seed, messages=300):
    """Times of one way, mostly quick, with a tail; none is below 90 % of the centre."""
    return (centre_ns * (0.9 + np.random.default_rng(seed).exponential(0.144, messages))).astype(np.int64)


@pytest.fixture(scope="module")
def measured():
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
            for sent, there, again in zip(range(0, 30 * S, 100 * MS), out[-1].tolist(), back[-1].tolist(), strict=True)
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


def columns_of(values, sent_ns, **more):
    """The columns of rows that have a latency and, where they are given, one-way times and what clocks leave open."""
    held = {"latency_ns": values, "publish_ns": sent_ns, **more}
    return lambda name: pl.Series(name, held.get(name, [None] * len(values)), pl.Int64)


@pytest.mark.parametrize("runs", [1, 2, 3])
@pytest.mark.parametrize("messages", [99, 100])
def test_rows_are_the_statistics_of_the_runs_that_a_group_has(runs, messages):
    values = np.random.default_rng(runs).integers(1, 9 * MS, messages)
    run_of_row = np.sort(np.arange(messages) % runs)
    sent = np.arange(messages) // 2 * MS  # two relays: two rows of one instant
    parts = [Run(values[run_of_row == each], sent[run_of_row == each]) for each in range(runs)]
    rows = list(interval_rows(7, columns_of(values, sent), run_of_row))
    assert [row["percentile"] for row in rows] == [each.name for each in PERCENTILES]
    for row, percentile in zip(rows, PERCENTILES, strict=True):
        expected = interval_of_runs(parts, Statistic(percentile.quantile))
        assert (row["group"], row["metric"], row["runs"], row["messages"]) == (7, "latency", runs, messages)
        assert (row["low_ns"], row["high_ns"], row["typical_ns"]) == (*expected.range, expected.value)
        is_supported = messages >= percentile.needs
        estimate_ns = pytest.approx(np.quantile(values, percentile.quantile)) if is_supported else None
        assert row["estimate_ns"] == estimate_ns
    # Rows that are not in the order of T1 are the same, and so are those between which others were lost.
    order = np.lexsort((-sent, run_of_row))
    shuffled = list(interval_rows(7, columns_of(values[order], sent[order]), run_of_row))
    assert [row["estimate_ns"] for row in shuffled] == [row["estimate_ns"] for row in rows]
    later = np.lexsort((sent[order], run_of_row))
    again = [Run(values[order][later][run_of_row == each], sent[run_of_row == each]) for each in range(runs)]
    assert [row["low_ns"] for row in shuffled] == [
        interval_of_runs(again, Statistic(each.quantile)).lower for each in PERCENTILES
    ]
    lost = columns_of([*values, None], [*sent, 10**12])
    assert list(interval_rows(7, lost, np.append(run_of_row, 0))) == rows


def test_rows_are_put_in_the_order_of_t1():
    """A slow rise is no rise where its messages are shuffled, and counts for more."""
    values, sent = np.arange(1000) + 1, np.arange(1000) * MS
    shuffled = np.concatenate([[0], 1 + np.random.default_rng(0).permutation(999)])
    of_one_run = np.zeros(1000, np.int64)
    rows = list(interval_rows(0, columns_of(values[shuffled], sent[shuffled]), of_one_run))
    assert rows == list(interval_rows(0, columns_of(values, sent), of_one_run))
    assert rows[0]["independent"] < 20


@pytest.mark.parametrize("runs", [1, 3, 5])
def test_metrics_side_by_side_are_each_as_by_themselves(runs, monkeypatch):
    """Of unlike values and unlike messages: ticks of a clock, a way that is negative, replies that were lost in one run more."""
    draw = np.random.default_rng(runs)
    messages, run_of_row = 1200 * runs, np.repeat(np.arange(runs), 1200)
    lost = draw.random(messages) < 0.1 + 0.2 * (run_of_row == 1)
    latency_ns = [
        None if gone else int(value) for gone, value in zip(lost, draw.lognormal(13, 1, messages), strict=True)
    ]
    held = {
        "outbound_ns": draw.normal(0, MS, messages).astype(np.int64),
        "return_ns": draw.integers(1, 9, messages) * MS,
        "rtt_ns": np.convolve(draw.exponential(MS, messages), np.ones(20), "same").astype(np.int64),
        "clock_bound_ns": draw.integers(1, 99, messages),
    }
    columns = columns_of(latency_ns, np.arange(messages) * MS, **held)

    def found(most):
        monkeypatch.setattr("dds_trace.analyzer.groups.intervals.SMALL_GROUP", most)
        return pl.DataFrame(list(interval_rows(0, columns, run_of_row)), INTERVAL_SCHEMA, strict=False)

    together, alone = found(messages), found(0)
    assert together["metric"].n_unique() == 4
    assert_frame_equal(together.drop(cs.float()), alone.drop(cs.float()))
    floats = (each.select(cs.float()).to_numpy() for each in (together, alone))
    np.testing.assert_allclose(*floats, rtol=1e-9)


def test_one_way_rows_are_wider_by_the_worst_bound_and_those_of_a_round_trip_are_not():
    values, sent = np.random.default_rng(1).integers(1, 9 * MS, 300), np.arange(300) * MS
    run_of_row = np.repeat(np.arange(3), 100)
    bounds = {"outbound_ns": values, "return_ns": values, "clock_bound_ns": [5, 9, *[7] * 298]}
    rows = {
        (row["metric"], row["percentile"]): row
        for row in interval_rows(0, columns_of(values, sent, **bounds), run_of_row)
    }
    plain, wide = rows["latency", "p50"], rows["outbound", "p50"]
    assert (wide["low_ns"], wide["high_ns"]) == (plain["low_ns"] - 9, plain["high_ns"] + 9)
    assert wide["estimate_ns"] == plain["estimate_ns"]
    unbounded = columns_of(values, sent, outbound_ns=values)  # of runs whose clocks were slewed
    assert "outbound" not in {row["metric"] for row in interval_rows(0, unbounded, run_of_row)}
    assert list(one_way_rows(3, unbounded)) == []
    one_way = list(one_way_rows(3, columns_of(values, sent, **bounds)))
    assert [(row["metric"], row["messages"], row["bound_max_ns"], row["bound_p50_ns"]) for row in one_way] == [
        ("outbound", 300, 9, 7.0),
        ("return", 300, 9, 7.0),
    ]
    assert {"mean_ns", "min_ns", "max_ns", "p50_ns", "p99_ns"} <= set(one_way[0])
    assert "std_ns" not in one_way[0]
