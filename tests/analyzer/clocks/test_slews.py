import numpy as np
import pytest

from dds_trace.analyzer.clocks.slews import Stretch, find_slews, slewed_ppm

MS = 1_000_000
S = 1_000_000_000
STEADY, FAST, UNSURE = (0.0, 1000.0), (400_000.0, 50_000.0), (0.0, 500_000.0)


def stretches(*drawn):
    """Stretches from (start and end in s, drift and its bound, step and its bound in ms)."""
    return [
        Stretch(begin * S, end * S, *drift, round(step * MS), round(bound * MS))
        for begin, end, drift, step, bound in drawn
    ]


def found(drawn, gain_ppm=0, begin_s=0, end_s=100):
    """Slews with a knot every second, each known within 10 us, of a clock that gains from a begin to an end."""
    at_ns = np.arange(0, 100 * S + 1, S)
    offset_ns = (np.clip(at_ns, begin_s * S, end_s * S) - begin_s * S) * gain_ppm // 1_000_000
    return list(find_slews(stretches(*drawn), at_ns, offset_ns, np.full(len(at_ns), 10_000)))


def test_three_steps_within_windows_are_a_slew_with_its_rate():
    drawn = [(0, 20, STEADY, 0, 0)] + [(20 + 5 * n, 25 + 5 * n, UNSURE, 10, 0.1) for n in range(8)]
    (slew,) = found([*drawn, (60, 100, STEADY, 10, 0.1)], gain_ppm=2000, begin_s=20, end_s=60)
    assert (slew.first, slew.after) == (1, 10)
    assert slew.rate_ppm == pytest.approx(2000, rel=0.05)
    # 42 of its seconds held the 40 of the slew, which is nearly as fast.
    assert (slew.end_ns - slew.start_ns) / S == pytest.approx(40, abs=2)
    assert slew.bound_ppm < 1


def test_a_step_that_barely_shows_beside_a_fast_clock_is_a_slew():
    drawn = [(0, 40, FAST, 0, 0), (40, 100, STEADY, 12, 11)]
    (slew,) = found(drawn, gain_ppm=600, begin_s=20, end_s=60)
    assert (slew.first, slew.after) == (1, 2)
    assert slew.rate_ppm == pytest.approx(600, rel=0.05)


@pytest.mark.parametrize(
    "drawn",
    [
        [(0, 40, STEADY, 0, 0), (40, 100, STEADY, 12, 11)],  # barely, and nothing ran fast
        [(0, 40, FAST, 0, 0), (40, 100, FAST, 500, 5)],  # a clock that was set while it drifted
        [(0, 40, (-400_000.0, 50_000.0), 0, 0), (40, 100, STEADY, 12, 11)],  # the other way
        [(0, 40, FAST, 0, 0)],  # no step at all
        [(0, 30, STEADY, 0, 0), (30, 60, STEADY, 12, 11), (60, 90, STEADY, 12, 11), (90, 99, STEADY, 12, 11)],
        [(0, 30, STEADY, 0, 0), (30, 35, STEADY, 12, 1), (35, 40, STEADY, -12, 1), (40, 99, STEADY, 12, 1)],
    ],
    ids=["alone", "set", "other way", "drift", "surely slow between", "to and fro"],
)
def test_jumps_and_drifts_are_no_slews(drawn):
    assert [slew for slew in found(drawn, gain_ppm=600, begin_s=20, end_s=60) if slew.after > slew.first] == []


@pytest.mark.parametrize(
    ("gain_ppm", "begin_s", "expected"), [(600, 20, [(1, 1)]), (60, 20, [(1, 1)]), (40, 20, []), (600, 0, [])]
)
@pytest.mark.parametrize("way", [1, -1])
def test_a_slew_below_the_fits_limit_bends_a_stretch_without_a_step(gain_ppm, begin_s, expected, way):
    """A rate that holds throughout is a drift, 40 ppm may be a crystal's."""
    slews = found([(0, 100, STEADY, 0, 0)], gain_ppm=way * gain_ppm, begin_s=begin_s, end_s=60 if begin_s else 100)
    assert [(slew.first, slew.after) for slew in slews] == expected
    assert all(slew.rate_ppm == pytest.approx(way * gain_ppm, rel=0.05) for slew in slews)


def test_two_slews_are_told_apart():
    up = [(20 + 5 * n, 25 + 5 * n, UNSURE, 10, 0.1) for n in range(3)]
    down = [(60 + 5 * n, 65 + 5 * n, UNSURE, -10, 0.1) for n in range(3)]
    slews = found([(0, 20, STEADY, 0, 0), *up, *down], gain_ppm=2000, begin_s=20, end_s=35)
    assert [(slew.first, slew.after) for slew in slews] == [(1, 4), (4, 7)]


def test_many_knots_are_thinned():
    at_ns = np.arange(0, 100 * S, S // 100)
    offset_ns = at_ns * 1000 // 1_000_000
    drawn = stretches((0, 20, STEADY, 0, 0), *((20 + n, 21 + n, UNSURE, 1, 0.1) for n in range(80)))
    (slew,) = find_slews(drawn, at_ns, offset_ns, np.full(len(at_ns), 10_000))
    assert slew.rate_ppm == pytest.approx(1000, rel=1e-3)


def steps(*starts_s, step=10, bound=0.1, drift=UNSURE):
    """A stretch from the begin on and a step (ms) at each of these seconds, the last stretch up to the 100th."""
    ends = [*starts_s[1:], 100]
    after = [(begin, end, drift, step, bound) for begin, end in zip(starts_s, ends, strict=True)]
    return [(0, starts_s[0], STEADY, 0, 0), *after]


@pytest.mark.parametrize("way", [1, -1])
def test_what_a_stretch_says_at_its_edges(way):
    def stretch(drift_ppb=0, step_ns=0, bound=0):
        return Stretch(0, 1, way * drift_ppb, 50_000, way * step_ns, bound)

    assert (Stretch(0, 1, 0.0, 0.0).step_ns, Stretch(0, 1, 0.0, 0.0).step_bound_ns) == (0, 0)
    assert stretch(step_ns=32, bound=11).steps_barely  # within three bounds
    assert not stretch(step_ns=33, bound=11).steps_barely
    assert stretch(150_001).is_fast(way)  # 100 ppm, wherever its drift lies within 50 ppm
    assert not stretch(150_000).is_fast(way)
    assert not stretch(150_001).is_fast(-way)
    assert stretch(50_001).may_be_fast(way)
    assert not stretch(50_000).may_be_fast(way)
    assert not stretch(50_001).may_be_fast(-way)


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize(
    ("drawn", "places"),
    [
        (steps(5, 10, 15), [(1, 4)]),  # near the first stretch, too
        (steps(20, 30, 40), [(1, 4)]),  # ten seconds apart
        (steps(20, 30), []),  # two
        (steps(20, 30, 40 + 1e-9), []),
        (steps(20, 45, 70, step=12, bound=11), [(1, 4)]),  # far apart, barely, and perhaps fast since
        (steps(20, 45, 70), []),  # not barely
        (steps(20, 45, 70, step=12, bound=11, drift=(40_000.0, 50_000.0)), []),  # surely below 100 ppm since
        (steps(40, step=12, bound=11, drift=FAST), [(1, 2)]),  # fast behind the step
        (steps(20, 30, 40, step=1e-6, bound=0), [(1, 4)]),  # a nanosecond
        ([*steps(20, 45, step=12, bound=11)[:2], (25, 30, STEADY, -12, 11), (30, 99, FAST, -12, 11)], []),
        ([*steps(20, 25, 30)[:-1], (30, 40, UNSURE, 10, 0.1), (70, 99, UNSURE, 10, 0.1)], [(1, 4)]),
    ],
)
def test_chains_end_where_they_should(drawn, places, way):
    """A clock that falls back leaves the same chains as one that runs ahead."""
    mirrored = [(begin, end, (way * drift[0], drift[1]), way * step, bound) for begin, end, drift, step, bound in drawn]
    slews = found(mirrored, gain_ppm=way * 600, begin_s=20, end_s=60)
    assert [(slew.first, slew.after) for slew in slews if slew.after > slew.first] == places
    for slew in slews:
        assert slew.rate_ppm * way > 0


CHAIN = [(10, 20, STEADY, 0, 0), *((at, at + 10, UNSURE, 10, 0.1) for at in (20, 25, 30))]


def of_knots(at_s, offset_us, bound_us, way=1, chain=CHAIN):
    drawn = [(begin, end, drift, way * step, bound) for begin, end, drift, step, bound in chain]
    at_ns, offset_ns, bound_ns = (
        np.rint(np.array(each) * scale).astype(np.int64)
        for each, scale in ((at_s, S), (offset_us, way * 1000), (bound_us, 1000))
    )
    return list(find_slews(stretches(*drawn), at_ns, offset_ns, bound_ns))


@pytest.mark.parametrize("way", [1, -1])
def test_the_rate_is_that_of_the_knots_within_the_chain(way):
    # 1 ms in each ten seconds from the 10th to the 40th; what lies outside gains 100 times as fast.
    (slew,) = of_knots([9, 10, 20, 30, 40, 41], [0, 1e4, 1.1e4, 1.2e4, 1.3e4, 2.3e4], [1, 2, 3, 4, 5, 6], way)
    assert (slew.first, slew.after, slew.start_ns, slew.end_ns) == (1, 4, 10 * S, 40 * S)
    assert slew.rate_ppm == pytest.approx(way * 100, rel=1e-12)
    assert slew.bound_ppm == pytest.approx((2 + 5) / 30, rel=1e-12)


@pytest.mark.parametrize("way", [1, -1])
def test_what_is_proven_counts_not_what_is_likely(way):
    # From the 10th to the 20th second 2 ms, of which 0.91 ms are unsure: 109 ppm are proven; to the 30th 2.48 ms: 124 ppm.
    (slew,) = of_knots([10, 20, 30], [0, 2000, 2500], [10, 900, 10], way)
    assert (slew.start_ns, slew.end_ns) == (10 * S, 30 * S)
    assert slew.rate_ppm == pytest.approx(way * 125, rel=1e-12)
    assert slew.bound_ppm == pytest.approx(1, rel=1e-12)
    # The longest that is nearly as fast: 95 of 100 ppm are, 94.9 are not.
    for later_us, end_s in ((1800, 30), (1798, 20)):
        (slew,) = of_knots([10, 20, 30], [0, 1000, later_us + 100], [0, 0, 0], way)
        assert slew.end_ns == end_s * S
    # Less than ten seconds do not count where more are there, and do where not.
    (slew,) = of_knots([10, 11, 21], [0, 1000, 1500], [0, 0, 0], way)
    assert (slew.start_ns, slew.end_ns) == (10 * S, 21 * S)
    (slew,) = of_knots([10, 11, 15], [0, 1000, 1500], [0, 0, 0], way)
    assert slew.end_ns == 15 * S
    (slew,) = of_knots([10, 10], [0, 7], [1, 2], way)  # at one instant: a nanosecond
    assert slew.rate_ppm == pytest.approx(way * 7000 * 1e6)
    (slew,) = of_knots([10, 10, 10], [0, 7, 20], [1, 2, 1], way)  # the fastest of three pairs
    assert slew.rate_ppm == pytest.approx(way * 20_000 * 1e6)


def test_no_knot_or_one_tells_no_rate():
    assert of_knots([], [], []) == of_knots([20], [5], [1]) == []


@pytest.mark.parametrize(("knots", "ends"), [(1000, (1, 998)), (1001, (2, 998)), (2001, (3, 1998))])
def test_of_too_many_knots_every_second_or_third_counts(knots, ends):
    at_ns, bound_ns = 10 * S + np.arange(knots) * 14 * MS, np.full(knots, 10)
    bound_ns[[0, -1]] = S  # so that the longest pair is not the first and the last
    drawn = stretches(*CHAIN)
    (slew,) = find_slews(drawn, at_ns, np.arange(knots) * 1000, bound_ns)
    assert ((slew.start_ns - at_ns[0]) // (14 * MS), (slew.end_ns - at_ns[0]) // (14 * MS)) == ends


def sampled(gain_us, at_s=None, way=1):
    """What is said of samples a second apart whose monotonic clock is ahead of the raw one by so much."""
    monotonic_ns = 7 * S + np.rint(np.array(range(len(gain_us)) if at_s is None else at_s) * 1e9).astype(np.int64)
    gain_ns = way * np.rint(np.array(gain_us) * 1000).astype(np.int64)
    return way * slewed_ppm(monotonic_ns, monotonic_ns - gain_ns - 3 * S)


@pytest.mark.parametrize("way", [1, -1])
def test_a_slew_beside_the_raw_clock_is_the_fastest_window(way):
    seconds = np.arange(31)
    ramp = np.clip(seconds - 5, 0, 4) * 100.0  # 0.4 ms from the 5th second to the 9th
    assert sampled(ramp, way=way) == pytest.approx(40, rel=1e-12)  # in a window of ten seconds
    assert sampled(ramp + 50 * seconds, way=way) == pytest.approx(90, rel=1e-12)  # with the steady 50 ppm
    # 0.2 ms in the middle, 0.15 ms within the last second, which is a window by itself.
    late = np.where(seconds >= 10, 200.0, 0) + np.where(seconds == 30, 150.0, 0)
    assert sampled(late, way=way) == pytest.approx(150, rel=1e-12)
    assert sampled([0, 0, 1500], [0, 1, 11], way) == pytest.approx(150, rel=1e-12)  # three samples can tell


@pytest.mark.parametrize("way", [1, -1])
def test_a_steady_clock_is_not_slewed_and_one_that_is_slewed_throughout_is(way):
    seconds = np.arange(31)
    assert sampled([], way=way) == sampled([0.0, 900.0], way=way) == 0
    assert sampled(100.0 * seconds, way=way) == 0  # the most that a crystal does
    assert sampled(150.0 * seconds, way=way) == pytest.approx(150, rel=1e-12)
    # The middle rate tells that it is, the whole how fast: 150 ppm, and once 450.
    assert sampled(150.0 * seconds + 300 * (seconds > 0), way=way) == pytest.approx(160, rel=1e-12)


@pytest.mark.parametrize("way", [1, -1])
def test_a_tenth_of_a_millisecond_in_a_window_is_a_slew(way):
    jump = np.arange(31) >= 15
    assert sampled(jump * 100.0, way=way) == pytest.approx(10, rel=1e-12)
    assert sampled(jump * 99.999, way=way) == 0
    # Two windows without a sample are one window, and a nanosecond more is a gap that tells nothing.
    at_s = np.array([*range(11), *range(30, 41)])
    gain = np.where(at_s >= 30, 300.0, 0)
    assert sampled(gain, at_s, way) == pytest.approx(15, rel=1e-12)
    assert sampled(gain, np.where(at_s >= 30, at_s + 1e-9, at_s), way) == 0
