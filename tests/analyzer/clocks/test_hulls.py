"""Hulls of many windows at once: parts by hand, and every hull held against what a hull is."""

from __future__ import annotations

import numpy as np

from dds_trace.analyzer.clocks.lines import lower_hulls, lowest_of_parts, part_edges


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
