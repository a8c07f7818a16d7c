import numpy as np
import pytest

from dds_trace.analyzer.clocks.fit import RelayedMessages, fit_clocks
from dds_trace.extensions.topics.exchange import ClockEstimate

SECOND = 1_000_000_000


def round_trips(rng, *, seconds, rate_hz=2.0, offset_ns=2 * SECOND, drift_ppm=0.0, base_ns=150_000):
    """T1, T3, T4, T2 of messages whose ways take a base and what a queue adds."""
    t1 = np.arange(round(seconds * rate_hz)) * SECOND / rate_hz + rng.integers(0, 1000, round(seconds * rate_hz))
    out = base_ns + rng.exponential(200_000, len(t1))
    back = base_ns + rng.exponential(200_000, len(t1))
    other = lambda at: at * (1 + drift_ppm / 1e6) + offset_ns  # noqa: E731
    arrival, departure = t1 + out, t1 + out + 30_000
    columns = t1, other(arrival), other(departure), departure + back
    return np.stack([column.astype(np.int64) for column in columns], axis=1), other


@pytest.mark.parametrize("drift_ppm", [0.0, 3.1, -300.0, 1000.0])
@pytest.mark.parametrize("seconds", [3, 20, 120, 900])
def test_the_difference_is_inside_its_bound(seconds, drift_ppm):
    rng = np.random.default_rng(seconds)
    for _ in range(20):
        stamps, other = round_trips(rng, seconds=seconds, drift_ppm=drift_ppm)
        estimate = ClockEstimate()
        for row in stamps.tolist():
            estimate.add(*row)
        now_ns = int(stamps[-1, 3]) + SECOND // 2
        result = estimate.at(now_ns)
        assert abs(other(now_ns) - now_ns - result.offset_ns) <= result.bound_ns
        assert result.bound_ns < 2_000_000
        if seconds >= 120:
            assert result.drift_ppm == pytest.approx(drift_ppm, abs=2.0)
            assert result.bound_ns < 400_000
        elif seconds == 3:
            assert result.drift_ppm is None


@pytest.mark.parametrize("drift_ppm", [0.0, 20.0])
def test_it_agrees_with_the_analysis_of_the_same_round_trips(drift_ppm):
    stamps, other = round_trips(np.random.default_rng(7), seconds=300, drift_ppm=drift_ppm)
    estimate = ClockEstimate()
    for row in stamps.tolist():
        estimate.add(*row)
    publish, relay_in, relay_out, receive = np.ascontiguousarray(stamps.T)
    ((_, offsets),) = fit_clocks([RelayedMessages(publish, relay_in, relay_out, receive)])
    at_ns = int(publish[-1] + receive[-1]) // 2
    live, whole_ns, bound_ns = estimate.at(at_ns), int(offsets.offset_ns[-1]), int(offsets.bound_ns[-1])
    assert abs(live.offset_ns - whole_ns) <= live.bound_ns + bound_ns
    assert abs(whole_ns - (other(at_ns) - at_ns)) <= bound_ns
    assert live.bound_ns < 2 * bound_ns + 100_000


def test_a_stepped_clock_is_followed():
    rng, estimate = np.random.default_rng(1), ClockEstimate()
    before, _ = round_trips(rng, seconds=100)
    after, other = round_trips(rng, seconds=200, offset_ns=3 * SECOND)
    for row in [*before.tolist(), *after[len(before) :].tolist()]:
        estimate.add(*row)
    now_ns = int(after[-1, 3])
    assert estimate.at(now_ns).offset_ns == pytest.approx(other(now_ns) - now_ns, abs=2_000_000)


def test_stamps_of_no_round_trip_are_ignored():
    estimate = ClockEstimate()
    estimate.add(0, 100, 1_000_000, 50)
    assert estimate.at(10) is None
