"""Flows that a sweep records at the same time, with stand-ins: they succeed, fail and go on together."""

from __future__ import annotations

from collections import Counter

from dds_trace.recorder.sweep.run.state import Status

PLAN = """
[run]
seconds = 0.01
warmup = 1
settle_seconds = 0
cutoff_seconds = 0
order = "listed"
[[flows]]
name = "a"
rate = 100
[[flows]]
name = "b"
rate = 200
"""
A, B = "ros2_same_binary_100Hz_a", "ros2_same_binary_200Hz_b"
A_WITH_B, B_WITH_A = f"{A}_with-b", f"{B}_with-a"


def argument(start, name):
    return start["arguments"][start["arguments"].index(name) + 1]


def test_alone_then_together_with_one_start_for_all(desk):
    outcome = desk.sweep(PLAN)
    assert outcome.missing == {}
    assert desk.started == {A: 1, B: 1, A_WITH_B: 1, B_WITH_A: 1, "relay": 1}
    pings = {start["cell"]: start for start in desk.starts if start["cell"] != "relay"}
    assert "--start-at" not in pings[A]["arguments"]
    assert argument(pings[A_WITH_B], "--start-at") == argument(pings[B_WITH_A], "--start-at")


def test_one_that_fails_fails_its_neighbour_and_both_are_tried_again(desk):
    desk.script(**{A_WITH_B: ["fail", "ok"]})
    outcome = desk.sweep(PLAN)
    assert outcome.missing == {}
    assert desk.state(A_WITH_B, PLAN).attempts == desk.state(B_WITH_A, PLAN).attempts == 2


def test_a_resumed_sweep_records_both_again_if_one_has_no_recording(desk):
    desk.script(**{A_WITH_B: ["fail", "fail"]})
    first = desk.sweep(PLAN)
    assert set(first.missing) == {A_WITH_B, B_WITH_A}
    before = Counter(desk.started)
    desk.script(number=4)
    assert desk.sweep(PLAN).missing == {}
    assert desk.started - before == {A_WITH_B: 1, B_WITH_A: 1, "relay": 1}
    assert desk.state(B_WITH_A, PLAN).status is Status.COMPLETE
