"""Sample sizes: the figures of the literature, and their meaning by drawing."""

from __future__ import annotations

import numpy as np
import pytest

from dds_trace.analyzer.statistics.intervals import order_statistic_ranks
from dds_trace.analyzer.statistics.percentiles import PERCENTILES
from dds_trace.analyzer.statistics.sample_size import (
    minimum_messages,
    plan_run,
    planned_messages,
    supported_percentiles,
)


def test_known_figures():
    assert planned_messages(0.99) == 368
    assert planned_messages(0.999) == 3688
    assert planned_messages(0.5) == 6  # 0.5**6 = 0.016
    assert planned_messages(0.01) == 368  # the low tail likewise
    assert planned_messages(0.99, confidence=0.99) == 528  # log(0.005) / log(0.99) = 527.2


def test_alike_neighbours_take_more_messages():
    assert planned_messages(0.99, inflation=3.0) == 1102  # 3 x 367.03
    assert planned_messages(0.99, inflation=0.2) == 368  # never fewer than independent ones


@pytest.mark.parametrize("quantile", [0.5, 0.9, 0.95, 0.99, 0.999])
def test_planned_is_the_first_size_with_both_ends(quantile):
    planned = planned_messages(quantile)
    assert None not in order_statistic_ranks(planned, quantile)
    assert None in order_statistic_ranks(planned - 1, quantile)


def test_minimum_agrees_with_the_summary():
    assert {p.name: minimum_messages(p.quantile) for p in PERCENTILES} == {
        p.name: p.needs for p in PERCENTILES
    }
    assert minimum_messages(0.9999) == 10_000
    assert supported_percentiles(0) == ()
    assert supported_percentiles(99) == ("p50", "p90", "p95")
    assert supported_percentiles(100) == ("p50", "p90", "p95", "p99")


def test_the_true_p99_exceeds_the_largest_of_150_in_22_of_100_runs():
    missed = 0.99**150
    assert missed == pytest.approx(0.2215, abs=1e-4)
    generator = np.random.default_rng(1)
    beyond = (generator.random((20_000, 150)).max(axis=1) < 0.99).mean()
    assert beyond == pytest.approx(0.2215, abs=0.015)


def test_a_plan_has_messages_and_their_time():
    plan = plan_run(0.99, rate_hz=20.0)
    assert (plan.messages, plan.duration_s) == (368, 18.4)
    assert plan_run(0.99, rate_hz=20.0, received_ratio=0.5).messages == 736


@pytest.mark.parametrize("bad", [0.0, 1.0, -1.0, 99.0])
def test_quantiles_are_no_percents(bad):
    with pytest.raises(ValueError, match="between 0 and 1"):
        planned_messages(bad)


def test_a_run_without_rate_cannot_be_planned():
    with pytest.raises(ValueError, match="rate above 0"):
        plan_run(0.5, rate_hz=0.0)
