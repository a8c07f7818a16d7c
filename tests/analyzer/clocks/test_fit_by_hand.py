"""Fits of a few messages, every number by hand."""

import numpy as np
import pytest

from dds_trace.analyzer.clocks.fit import RelayedMessages, fit_clocks

S = 1_000_000_000


def fitted(*messages, **names):
    stamps = np.array(messages, np.int64).reshape(-1, 4).T
    ((fit, offsets),) = fit_clocks([RelayedMessages(*stamps, **names)])
    return fit, offsets


def test_a_message_that_took_no_time_tells_the_offset():
    fit, offsets = fitted((100, 105, 105, 100))
    assert (offsets.offset_ns.tolist(), offsets.bound_ns.tolist()) == ([5], [1])
    assert (fit.segments[0].start_ns, fit.segments[0].end_ns, fit.segments[0].messages) == (100, 100, 1)
    told = fit.segments[0].drift_ppb, fit.segments[0].drift_bound_ppb
    assert told == pytest.approx((0, 1_100_000), rel=1e-12)


def test_two_messages_that_took_no_time_tell_the_drift():
    fit, _ = fitted((0, 0, 0, 0), (S, S + 100_000, S + 100_000, S))
    assert fit.segments[0].drift_ppb == pytest.approx(100_000, rel=1e-12)
    assert fit.segments[0].drift_bound_ppb == pytest.approx(0, abs=1e-6)


def test_one_machine_may_take_no_time_either_way():
    for message in ((100, 100, 105, 110), (100, 105, 110, 110)):
        assert fitted(message, same_boot=True)[0].same_clock
    for message in ((100, 99, 105, 110), (100, 105, 111, 110)):  # received before it was sent
        assert not fitted(message, same_boot=True)[0].same_clock
    assert not fitted()[0].same_clock


def test_the_drift_of_one_window_is_the_middle_of_its_lines():
    # After one second the relay's clock is 100 us ahead, each time within 10 ns.
    messages = [(at, at + 10 + ahead, at + 10 + ahead, at + 20) for at, ahead in ((0, 0), (S, 100_000))]
    fit, offsets = fitted(*messages)
    assert fit.segments[0].drift_ppb == pytest.approx(100_000, abs=0.1)
    assert fit.segments[0].drift_bound_ppb == pytest.approx(20, abs=0.1)
    assert offsets.offset_ns.tolist() == [0, 100_000]
    assert fitted(*messages[::-1])[1].offset_ns.tolist() == [100_000, 0]


def test_a_step_lies_between_the_messages_that_surely_know_one_clock():
    # 3 ms ahead from the third message on, 10 ns each way, a second apart: clocks part by 1.1 ms in between.
    messages = [
        (at * S, at * S + 10 + ahead, at * S + 10 + ahead, at * S + 20)
        for at, ahead in enumerate([0, 0, 3 * 10**6, 3 * 10**6])
    ]
    fit, _ = fitted(*messages)
    (step,) = fit.steps
    assert (step.after_ns, step.before_ns) == (S + 10, 2 * S + 10)
    assert (step.size_ns, step.bound_ns) == (3 * 10**6, 1_100_021)
    assert [segment.messages for segment in fit.segments] == [2, 2]
