"""The four formulas, by hand."""

import numpy as np
import polars as pl
import pytest

from dds_trace.analyzer.model.metrics import with_metrics
from dds_trace.reports.book.groups import LATENCY_MEANING

STAMPS = ("scheduled_ns", "publish_ns", "receive_ns", "relay_in_ns", "relay_out_ns")


def metrics(t0=0, t1=0, t2=None, t3=None, t4=None):
    stamps = pl.DataFrame(
        dict(zip(STAMPS, ([t] for t in (t0, t1, t2, t3, t4)), strict=True)), schema=dict.fromkeys(STAMPS, pl.Int64)
    )
    row = with_metrics(stamps).row(0, named=True)
    return row["rtt_ns"], row["intermediate_ns"], row["latency_ns"], row["response_ns"]


def test_metrics_follow_their_formulas():
    # T0=100 planned, T1=107 sent, relay 5000..5040 on its own clock, T2=467 back.
    assert metrics(100, 107, 467, 5000, 5040) == (360, 40, 160, 367)


def test_half_a_nanosecond_is_rounded_down():
    assert metrics(0, 0, 101, 50, 60) == (101, 10, 45, 101)
    assert metrics(0, 0, 10, 50, 61) == (10, 11, -1, 10)  # -1 // 2, not 0


def test_a_missing_stamp_makes_null_never_0():
    assert metrics(1, 2) == (None, None, None, None)
    assert metrics(1, 2, t2=9) == (7, None, None, 8)
    assert metrics(1, 2, t2=9, t3=4) == (7, None, None, 8)
    assert metrics(1, 2, t3=4, t4=6) == (None, 2, None, None)
    assert metrics(None, 2, 9, 4, 6) == (7, 2, 2, None)


def test_times_since_boot_do_not_lose_nanoseconds():
    day = 86_400 * 10**9
    assert metrics(900 * day, 900 * day + 1, 900 * day + 4, 5, 6) == (3, 1, 1, 4)


RANDOM = np.random.default_rng(1)
WAYS = {
    "exponential": lambda count: RANDOM.exponential(1e6, count),
    "lognormal": lambda count: RANDOM.lognormal(0, 1, count) * 1e6,
    "Pareto": lambda count: (1 + RANDOM.pareto(2.5, count)) * 1e6,
    "2 % ten times as slow": lambda count: np.where(RANDOM.random(count) < 0.02, 1e7, 1e6),
}


def p99s(there, back):
    """p99 of the way out, and p99 of the latency, of messages with these two ways."""
    zero = np.zeros(len(there), np.int64)
    stamps = {"scheduled_ns": zero, "publish_ns": zero, "receive_ns": (there + back).astype(np.int64)}
    frame = with_metrics(pl.DataFrame({**stamps, "relay_in_ns": zero, "relay_out_ns": zero}))
    return np.quantile(there, 0.99), np.quantile(frame["latency_ns"].to_numpy(), 0.99)


@pytest.mark.parametrize("kind", WAYS)
def test_the_tail_of_the_latency_lies_below_that_of_one_way_as_reports_say(kind):
    there, back = WAYS[kind](200_000), WAYS[kind](200_000)
    one_way, latency = p99s(there, back)
    assert "20 to 50 % below" in LATENCY_MEANING
    assert 0.20 <= 1 - latency / one_way <= 0.50
    one_way, latency = p99s(there, there)  # slow both ways at once: nothing is hidden
    assert latency == pytest.approx(one_way, rel=0.01)
