import numpy as np
import pytest

from dds_trace.analyzer.clocks import fit, windows
from dds_trace.analyzer.clocks.fit import find_stretches
from dds_trace.analyzer.clocks.lines import DRIFT, OffsetIntervals
from dds_trace.analyzer.clocks.windows import WINDOW_NS

TICK_NS = round(1 / DRIFT)
"""In this time a clock drifts by 1 ns, so that all numbers below are whole and edges are exact."""


def drawn(seed, messages=40):
    """Messages at whole ticks, some at once; a clock that jumps now and then, by no more than what drift explains or just over."""
    draw = np.random.default_rng(seed)
    time = TICK_NS * np.cumsum(draw.integers(0, 4, messages)).astype(float)
    jumps = draw.integers(-6, 7, messages) * (draw.random(messages) < 0.2)
    middle, width = np.cumsum(jumps).astype(float), draw.integers(0, 4, messages).astype(float)
    return OffsetIntervals(time, middle - width, middle + width)


def plain_stretches(points, after_step):
    def is_reached(one, other):
        reach = DRIFT * abs(points.time[other] - points.time[one])
        return points.lower[one] - reach <= points.upper[other] and points.lower[other] <= points.upper[one] + reach

    start, count = 0, len(points)
    while start < count:
        step = start + 1
        while step < count and all(is_reached(before, step) for before in range(start, step)):
            step += 1
        stop = step
        if step < count:
            after = range(step, min(step + after_step, count))
            foreign = [one for one in range(start, step) if not all(is_reached(one, other) for other in after)]
            stop = foreign[-1] + 1 if foreign else step
        yield start, stop
        start = step


@pytest.mark.parametrize(
    ("blocks", "part"), [((1, 1), 1), ((1, 4), 2), ((3, 5), 2), ((4, 8), 3), ((4096, 1 << 17), 32)]
)
def test_stretches_are_those_of_every_message_held_against_every_other(blocks, part, monkeypatch):
    monkeypatch.setattr(fit, "_BLOCKS", blocks)
    monkeypatch.setattr(fit, "_PART", part)
    monkeypatch.setattr(fit, "_MESSAGES_AFTER_STEP", 3)
    found = 0
    for seed in range(25):
        points = drawn(seed)
        expected = list(plain_stretches(points, 3))
        assert list(find_stretches(points)) == expected, seed
        found += len(expected)
    assert found > 50, "clocks that never jump would prove nothing"


@pytest.mark.parametrize(("after", "stop"), [(62, 2), (63, 1)])
def test_the_first_sixty_four_messages_behind_a_step_tell_who_belongs_before_it(after, stop):
    """All at one instant: the first cannot be of the new clock, the second can until one message knows better."""
    new = [(90, 200)] * after + [(150, 200)]
    lower, upper = np.array([(0, 0), (0, 120), (90, 200), *new, (90, 200)], float).T
    points = OffsetIntervals(np.zeros(len(lower)), lower, upper)
    assert list(find_stretches(points)) == [(0, stop), (2, len(lower))]


@pytest.mark.parametrize(
    ("lengths", "blocks"),
    [
        # At most ten messages together, a window of more alone; at most three windows.
        ((5, 5, 5, 5), [(0, 2), (2, 4)]),
        ((5, 6, 5, 5), [(0, 1), (1, 2), (2, 4)]),
        ((20, 5, 11, 10), [(0, 1), (1, 2), (2, 3), (3, 4)]),
        ((1,) * 8, [(0, 3), (3, 6), (6, 8)]),
        ((), []),
    ],
)
def test_windows_are_worked_at_in_blocks_that_hold_each_once(lengths, blocks, monkeypatch):
    monkeypatch.setattr(windows, "_BLOCK_WINDOWS", 3)
    stop = np.cumsum(lengths).astype(np.intp)
    assert list(windows._blocks(stop - np.array(lengths, np.intp), stop, 10)) == blocks


def test_windows_of_several_blocks_tell_their_messages_from_the_first_of_all(monkeypatch):
    monkeypatch.setattr(windows, "_BLOCK_WINDOWS", 1)
    offset = np.repeat([0.0, 50.0, 90.0], 3)
    points = OffsetIntervals(np.arange(9) * TICK_NS * 1.0, offset - 2, offset + 2)
    found = windows.fit_windows(points, [(0, 3), (3, 6), (7, 9)])
    assert (found.start.tolist(), found.stop.tolist()) == ([0, 3, 7], [3, 6, 9])
    assert found.offset.tolist() == [0, 50, 90]


def test_a_stretch_is_cut_into_windows_of_equal_length_none_too_long():
    second = WINDOW_NS / 10
    time = np.arange(40) * second  # each stretch lies between its first message and its last
    assert [side.tolist() for side in windows._cut(time, [(0, 11)])] == [[0], [11]]  # ten seconds are one window
    assert [side.tolist() for side in windows._cut(time, [(0, 12)])] == [[0, 6], [6, 12]]
    several = windows._cut(time, [(2, 5), (5, 36)])
    assert [side.tolist() for side in several] == [[2, 5, 15, 25], [5, 15, 25, 36]]
