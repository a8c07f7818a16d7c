"""Lines through windows: by hand, and many windows at once against one after another told plainly."""

from dataclasses import fields

import numpy as np
import plain_clock_fit
import pytest
from plain_clock_fit import find_windows

from dds_trace.analyzer.clocks.lines import DRIFT, Lines, OffsetIntervals, lower_hulls, lowest_of_parts, part_edges
from dds_trace.analyzer.clocks.windows import _are_bent, fit_windows

S = 1_000_000_000


def intervals(*messages):
    return OffsetIntervals(*(np.array(each, float) for each in zip(*messages, strict=True)))


def lines_of(*messages):
    return Lines.through(intervals(*messages), np.array([0]), np.array([len(messages)]))


def test_two_clocks_that_are_slewed_by_500_ppm_each_part_by_1100_ppm_at_most():
    assert DRIFT == 1.1e-3
    lines = lines_of((2e6, -10, 10))
    assert lines.exist.tolist() == [True]
    assert lines.steepness.tolist() == [[-1.1e-3, 1.1e-3]]
    low, high = lines.range_at(np.array([[2e6, 3e6, 1e6]]))
    assert low.tolist() == [[-10, -1110, -1110]]
    assert high.tolist() == [[10, 1110, 1110]]


def test_lines_through_two_messages():
    # From a in [0, 10] at the first to b in [20, 30] at the second: 2a - b before them, 2b - a behind, (a + b) / 2 between.
    lines = lines_of((0, 0, 10), (1e5, 20, 30))
    assert lines.steepness == pytest.approx(np.array([[1e-4, 3e-4]]), rel=1e-12)
    low, high = lines.range_at(np.array([[-1e5, 0, 5e4, 1e5, 2e5]]))
    assert low == pytest.approx(np.array([[-30, 0, 10, 20, 30]]), abs=1e-9)
    assert high == pytest.approx(np.array([[0, 10, 20, 30, 60]]), abs=1e-9)


def test_messages_that_contradict_each_other_by_no_more_than_rounding_have_a_line():
    assert lines_of((0, -5, 0), (0, 0.001, 5)).exist.tolist() == [True]
    assert lines_of((0, -5, 0), (0, 0.0010001, 5)).exist.tolist() == [False]


@pytest.mark.parametrize("twice", [0, 1e5])
@pytest.mark.parametrize("slow_first", [True, False])
def test_of_two_messages_at_one_instant_the_faster_one_counts(twice, slow_first):
    fast, slow = (twice, -5, 5), (twice, -10, 10)
    both = (slow, fast) if slow_first else (fast, slow)
    lines = lines_of(*both, (1e5, -5, 5)) if twice == 0 else lines_of((0, -5, 5), *both)
    assert lines.exist.tolist() == [True]
    assert lines.steepness == pytest.approx(np.array([[-1e-4, 1e-4]]), rel=1e-12)
    low, high = lines.range_at(np.array([[-1e5, 0, 5e4, 1e5, 2e5]]))
    assert low == pytest.approx(np.array([[-15, -5, -5, -5, -15]]), abs=1e-9)
    assert high == pytest.approx(np.array([[15, 5, 5, 5, 15]]), abs=1e-9)


@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_message_that_contradicts_itself_is_in_no_window(place):
    messages = [(0, 0, 10), (1e6, 2, 8), (2e6, 1, 9)]
    messages[place] = (place * 1e6, 5, 4.9)
    points = intervals(*messages)
    found = fit_windows(points, [(0, 3)])
    assert place not in {
        message
        for start, stop in zip(found.start.tolist(), found.stop.tolist(), strict=True)
        for message in range(start, stop)
    }
    assert (found.stop - found.start).sum() == 2
    assert (points.lower[place], points.upper[place]) == (5, 4.9)


def test_without_a_stretch_there_is_no_window():
    found = fit_windows(intervals((0, 0, 10)), [])
    assert [found.start.shape, found.stop.shape, found.time.shape] == [(0,)] * 3
    assert [found.steepness.shape, found.first.shape, found.last.shape] == [(0, 2)] * 3


def test_a_half_that_agrees_exactly_does_not_bend():
    """Sixteen messages that know little, and sixteen that took no time."""
    bound = np.repeat([10.0, 0.0], 16)
    points = OffsetIntervals(np.arange(32) * S / 4, -bound, bound)
    start, stop = np.array([0]), np.array([32])
    assert _are_bent(points, start, stop, Lines.through(points, start, stop)).tolist() == [False]


def test_a_message_whose_offset_two_others_know_exactly_is_narrowed_to_it():
    points = intervals((0, 5, 5), (1e6, 0, 10), (2e6, 5, 5))
    fit_windows(points, [(0, 3)])
    assert (points.lower.tolist(), points.upper.tolist()) == ([5, 5, 5], [5, 5, 5])


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize(("messages", "is_bent"), [(30, False), (31, True), (32, True)])
def test_halves_of_sixteen_messages_are_asked_whether_the_clock_bends(messages, is_bent, way):
    """From the middle on the clock gains 100 ppm; a line reaches all messages, but puts the first ones off."""
    time = np.arange(messages) * S / 4
    offset = way * np.maximum(time - time[messages // 2], 0) * 1e-4
    bound = 1.4e-5 * time[-1]
    points = OffsetIntervals(time, offset - bound, offset + bound)
    start, stop = np.array([0]), np.array([messages])
    lines = Lines.through(points, start, stop)
    assert lines.exist.tolist() == [True]
    assert _are_bent(points, start, stop, lines).tolist() == [is_bent]


@pytest.mark.parametrize("way", [1, -1])
def test_messages_that_only_a_steeper_line_joins_have_that_one(way):
    lines = lines_of((0, 0, 0), (1e5, way * 51, way * 51))  # where rounding leaves one of two, it is both
    assert lines.exist.tolist() == [True]
    assert lines.steepness == pytest.approx(np.full((1, 2), way * 5.1e-4))
    low, high = lines.range_at(np.array([[0, 1e5, 2e5]]))
    assert low == pytest.approx(high, abs=1e-9)
    assert low == pytest.approx(np.array([[0, way * 51, way * 102]]), abs=1e-9)


def drawn(seed, lengths=(1, 2, 3, 40, 70, 7, 150), fast=40.0):
    draw, stretches, time, first = np.random.default_rng(seed), [], [], 0
    begin = 0.0
    for length in lengths:
        count = length + int(draw.integers(0, 3))
        time.append(begin + np.cumsum(draw.integers(1, 5, count)) * 5e7)
        begin = time[-1][-1] + 3e10
        stretches.append((first, first + count - int(draw.integers(0, 2)) * (length > 10)))
        first += count
    at = np.concatenate(time)
    theta = draw.integers(-300, 300) * at / 1e9 + 1e-4 * np.abs(at - time[-1].mean()) * (at >= time[-1][0])
    below, above = (np.rint(fast + draw.exponential(3e4, len(at))) for _ in range(2))
    return OffsetIntervals(at, theta - below, theta + above), stretches


def test_many_windows_are_fitted_as_one_after_another():
    halved = 0
    for seed in range(5):
        points, stretches = drawn(seed)
        lower, upper = points.lower.copy(), points.upper.copy()
        plain = [each for start, stop in stretches for each in find_windows(points, start, stop)]
        low, high = lower.copy(), upper.copy()
        for start, stop, lines in plain:
            lowest, highest = lines.range_at(points.time[start:stop])
            low[start:stop], high[start:stop] = (
                np.maximum(low[start:stop], lowest),
                np.minimum(high[start:stop], highest),
            )
        windows = fit_windows(points, stretches)
        assert [windows.start.tolist(), windows.stop.tolist()] == [list(each) for each in zip(*plain, strict=True)][:2]
        assert points.lower == pytest.approx(low, abs=1e-4)
        assert points.upper == pytest.approx(high, abs=1e-4)
        untouched = np.ones(len(low), np.bool_)
        for place, (start, stop, lines) in enumerate(plain):
            untouched[start:stop] = False
            assert windows.steepness[place] == pytest.approx([lines.slope.min(), lines.slope.max()], abs=1e-12)
            time = points.time[start:stop]
            ends = np.array(lines.range_at(time[[0, -1]]))
            assert windows.first[place] == pytest.approx([ends[:, 0].mean(), np.ptp(ends[:, 0]) / 2], abs=1e-4)
            assert windows.last[place] == pytest.approx([ends[:, 1].mean(), np.ptp(ends[:, 1]) / 2], abs=1e-4)
            best = plain_clock_fit._Best.of(points.part(start, stop), lines)
            assert (windows.time[place], windows.offset[place], windows.bound[place]) == pytest.approx(
                (best.time, best.offset, best.bound), rel=1e-9, abs=1e-4
            )
        assert np.array_equal(points.lower[untouched], lower[untouched])
        assert np.array_equal(points.upper[untouched], upper[untouched])
        halved += len(plain) > len(stretches) + 1
    assert halved > 1, "clocks that never bend would prove little"


def test_messages_without_a_common_line_are_windows_of_their_own():
    points = intervals((0, -5, 0), (0, 0.01, 5))
    windows = fit_windows(points, [(0, 2)])
    assert (windows.start.tolist(), windows.stop.tolist()) == ([0, 1], [1, 2])
    assert windows.offset.tolist() == pytest.approx([-2.5, 2.505])
    assert windows.bound.tolist() == pytest.approx([2.5, 2.495])
    nothing = fit_windows(points, [])
    assert {len(getattr(nothing, field.name)) for field in fields(nothing)} == {0}


def test_windows_are_cut_into_equal_parts_of_whole_messages():
    edges = part_edges(np.array([0, 7, 50, 200]), np.array([5, 47, 114, 233]))
    assert edges.shape == (4, 33)
    assert edges[0].tolist() == [0, 1, 2, 3, 4, 5, *[5] * 27]  # a part for each message, then empty ones
    assert edges[1].tolist() == [7 + place * 40 // 32 for place in range(33)]
    assert edges[2].tolist() == list(range(50, 115, 2))
    assert edges[3].tolist() == [200 + place * 33 // 32 for place in range(33)]
    short = part_edges(np.array([0, 3]), np.array([3, 5]))
    assert short.tolist() == [[0, 1, 2, 3], [3, 4, 5, 5]]


def test_the_lowest_point_of_each_part_is_the_first_of_the_lowest():
    draw, empty, equal = np.random.default_rng(1), 0, 0
    for _ in range(40):
        height = draw.integers(0, 5, 60).astype(float)
        # Three windows with gaps between them; the first part of each has a message, others may have none.
        inside = np.sort(draw.integers(1, 20, (3, 4)), axis=1)
        first = draw.integers(0, 2, (3, 1)) * inside[:, :1] // 2
        edges = np.append(first, inside, axis=1) + np.array([[0], [20], [40]])
        edges[-1, -1] = draw.choice([edges[-1, -1], 60])  # the last window may end with the messages, or before
        found = lowest_of_parts(height, edges)
        for row, lowest in zip(edges.tolist(), found.tolist(), strict=True):
            before = None
            for begin, end, place in zip(row[:-1], row[1:], lowest, strict=True):
                part = height[begin:end].tolist()
                before = begin + part.index(min(part)) if part else before  # an empty part takes the point before it
                assert place == before
                empty += not part
                equal += bool(part) and part.count(min(part)) > 1
    assert min(empty, equal) > 10


def is_lower_hull(time, height, corners):
    """Whether the line through the corners lies below every point, rises ever more steeply and joins first and last."""
    if (corners[0], corners[-1]) != (0, len(time) - 1) or sorted(set(corners)) != corners:
        return False
    slopes = np.diff(height[corners]) / np.diff(time[corners])
    return bool(
        (np.diff(slopes) > 1e-12).all() and (np.interp(time, time[corners], height[corners]) <= height + 1e-9).all()
    )


def test_the_corners_of_every_row_are_its_lower_hull():
    draw = np.random.default_rng(2)
    several = set()
    for points in (1, 2, 3, 5, 9, 20):
        time = np.cumsum(draw.integers(1, 4, (30, points)), axis=1).astype(float)
        height = draw.integers(-5, 6, (30, points)).astype(float)
        found = lower_hulls(time, height)
        for row in range(30):
            corners = found[row].tolist()
            whole = corners[: corners.index(points - 1) + 1]
            assert set(corners[len(whole) :]) <= {points - 1}  # the last one is repeated
            assert is_lower_hull(time[row], height[row], whole)
            several.add(len(whole))
    assert several >= {1, 2, 3, 4, 5}


def test_of_points_at_one_time_the_lower_one_comes_next_or_none():
    time = np.array([[0.0, 0.0, 1.0, 2.0, 3.0], [0.0, 0.0, 1.0, 2.0, 2.0], [0.0, 1.0, 1.0, 2.0, 2.0]])
    height = np.array([[3.0, 1.0, 2.0, 1.0, 1.0], [1.0, 1.0, 5.0, 2.0, 1.0], [0.0, 0.0, -1.0, 0.0, 4.0]])
    assert lower_hulls(time, height).tolist() == [
        [0, 1, 4, 4],  # down to the lowest of the first instant; of points on one line the last
        [0, 4, 4, 4],
        [0, 2, 3, 4],  # the last point is always one
    ]
