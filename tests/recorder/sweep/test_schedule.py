from __future__ import annotations

from recorder.sweep.estimate import Remaining, plan_seconds
from recorder.sweep.plan_file import parse_plan
from recorder.sweep.schedule import schedule

PLAN = """
[run]
seconds = 10
warmup = 0
settle_seconds = 1
repeats = 2
{order}
[axes]
reliability = ["reliable", "best_effort"]
bridge = ["none", "builtin"]
rate = [1, 10, 100]
"""


def plan(order=""):
    return parse_plan(PLAN.format(order=order), "p", "p.toml")


def names(groups):
    return [cell.name for group in groups for cell in group.cells]


def test_listed_order_goes_through_each_relay_once_a_repeat():
    groups = schedule(plan())
    assert [(group.need.reliability, len(group.cells)) for group in groups] == [
        ("reliable", 6),
        ("best_effort", 6),
    ] * 2
    assert [cell.rate for cell in groups[0].cells] == [1, 10, 100] * 2
    assert {cell.repeat for cell in groups[2].cells} == {2}


def test_shuffled_order_is_a_permutation_that_the_seed_decides():
    first, again, other = (schedule(plan('order = "shuffled"\nseed = ' + seed)) for seed in ("1", "1", "2"))
    assert first == again
    assert names(first) != names(other)
    assert sorted(names(first)) == sorted(names(other)) == sorted(names(schedule(plan())))
    # each repeat is a pass of its own, with every cell once
    repeats = [cell.repeat for group in first for cell in group.cells]
    assert repeats == sorted(repeats)


def test_bridge_splits_groups_only_where_half_of_it_runs_beside_a_distant_relay():
    distant = parse_plan(PLAN.format(order="") + '[devices.relay]\nssh = "pi@robot"\n', "p", "p.toml")
    assert [(group.need.reliability, group.bridge) for group in schedule(distant)][:4] == [
        ("reliable", None),
        ("reliable", "builtin"),
        ("best_effort", None),
        ("best_effort", "builtin"),
    ]


def test_estimate_is_schedules_plus_overheads():
    # 24 runs of 10 s and 1 s to settle are 264 s; 3.5 s each to start, 2 s for each of 12 bridged; 4 relays at 1.5 s
    assert plan_seconds(plan()).seconds == 24 * 11 + 24 * 3.5 + 12 * 2 + 4 * 1.5


def test_remaining_time_in_words():
    assert [str(Remaining(seconds)) for seconds in (0.4, 59, 61, 3599, 7260)] == [
        "0 s",
        "59 s",
        "1 min 01 s",
        "59 min 59 s",
        "2 h 01 min",
    ]
