from __future__ import annotations

import pytest

from recorder.sweep.commands import half_arguments, ping_arguments
from recorder.sweep.estimate import Remaining, plan_seconds
from recorder.sweep.plan_file import parse_plan
from recorder.sweep.schedule import schedule
from tracefile import OptionError

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


DISTANT = '[devices.relay]\nssh = "pi@robot"\n[devices.ping]\naddress = "192.168.0.5"\n'


def test_bridge_of_halves_has_a_relay_of_its_own_where_that_is_on_another_device():
    text = PLAN.format(order="").replace('"builtin"', '"builtin", "zenoh-bridge-dds"')
    assert [group.bridge for group in schedule(parse_plan(text, "p", "p.toml"))] == [None] * 4
    distant = parse_plan(text + DISTANT, "p", "p.toml")
    groups = schedule(distant)[:4]
    assert [(group.need.reliability, group.bridge, len(group.cells)) for group in groups] == [
        ("reliable", None, 6),  # the builtin bridge is one program, beside the ping
        ("reliable", "zenoh-bridge-dds", 3),
        ("best_effort", None, 6),
        ("best_effort", "zenoh-bridge-dds", 3),
    ]


def test_halves_meet_at_the_pings_address_and_the_ping_leaves_them_running():
    distant = parse_plan(
        PLAN.format(order="").replace("builtin", "zenoh-bridge-dds") + DISTANT, "p", "p.toml"
    )
    group = schedule(distant)[1]
    ping, relay = (" ".join(half_arguments(distant, group, half)) for half in ("ping", "relay"))
    rest = "--from 5 --to 10 --discovery subnet --reliability reliable --durability volatile --depth 10"
    assert ping == f"zenoh-bridge-dds --half ping --listen 0.0.0.0:7447 {rest}"
    assert relay == f"zenoh-bridge-dds --half relay --peer 192.168.0.5:7447 {rest}"
    assert "--bridge-running" in ping_arguments(distant, group.cells[0], 20)
    assert "--bridge-running" not in ping_arguments(distant, schedule(distant)[0].cells[0], 20)


def test_halves_need_to_know_where_to_meet():
    with pytest.raises(OptionError, match=r"\[devices\.ping\] address"):
        parse_plan(
            PLAN.format(order="").replace("builtin", "zenoh-bridge-dds")
            + '[devices.relay]\nssh = "pi@robot"\n',
            "p",
            "p.toml",
        )


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
