"""Several relays of one cell, with stand-ins: a trace for each, and what is missing is recorded again."""

from collections import Counter

from sweep_desk import PLAN, files_of

from dds_trace.recorder.sweep.run.state import Status

THREE = PLAN.replace("[100, 200]", "100") + "relays = 3\n"
CELL = "ros2_same_binary_100Hz_relays-3"


def test_each_relay_has_a_trace_of_its_own(desk):
    assert desk.sweep(THREE).missing == {}
    assert desk.started == {CELL: 1, "relay": 3}
    assert desk.traces == sorted([*files_of(CELL), f"{CELL}.relay-2.mcap", f"{CELL}.relay-3.mcap"])
    numbers = [
        words[words.index("--relay-id") + 1] for start in desk.starts if "--relay-id" in (words := start["arguments"])
    ]
    assert sorted(numbers) == ["1", "2", "3"]
    assert desk.state(CELL, THREE).status is Status.COMPLETE


def test_a_relay_that_dies_is_started_again_with_the_others(desk):
    desk.script(**{CELL: ["slow"], "relay": ["relay", "relay", "die"]})
    assert desk.sweep(THREE).missing == {}
    assert desk.started == {CELL: 2, "relay": 6}


def test_a_resumed_sweep_has_nothing_to_do(desk):
    desk.sweep(THREE)
    before = Counter(desk.started)
    assert desk.sweep(THREE).missing == {}
    assert desk.started == before
