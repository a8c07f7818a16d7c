from dataclasses import replace
from itertools import pairwise

import pytest

from dds_trace.base.errors import OptionError
from dds_trace.extensions.campaigns.plan.commands import half_arguments, ping_arguments
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan
from dds_trace.extensions.campaigns.plan.schedule import Estimate, Remaining, plan_seconds, schedule, schedule_pass
from dds_trace.recorder.options import DEFAULT_MESSAGES

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
    assert [(group.need.reliability, len(group.cells)) for group in groups] == [("reliable", 6), ("best_effort", 6)] * 2
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


ALTERNATING = 'order = "alternating"\nseed = 1'


def unnumbered(groups):
    return [replace(cell, repeat=1).name for group in groups for cell in group.cells]


def test_alternating_pass_is_run_backwards_and_each_pair_of_passes_has_an_order_of_its_own():
    asked = plan(ALTERNATING)
    first, second, third, fourth = (unnumbered(schedule_pass(asked, asked.cells, n)) for n in (1, 2, 3, 4))
    assert second == first[::-1]
    assert fourth == third[::-1]
    assert first != third
    assert sorted(first) == sorted(third) == sorted(cell.name for cell in asked.cells)


def test_linear_drift_over_two_alternating_passes_meets_every_cell_alike():
    groups = schedule(plan(ALTERNATING))
    places = {}
    for place, name in enumerate(unnumbered(groups)):
        places.setdefault(name, []).append(place)
    assert len(places) == 12
    assert {sum(of_cell) for of_cell in places.values()} == {23}  # the mean of 0 .. 23 is 11.5
    assert [group.number for group in groups] == [1, 2, 3, 4]


def test_pass_is_a_label_of_the_pings_run_by_which_the_analyzer_pairs_runs():
    """The recorder and the analyzer share no import, so this is the one place that holds both to one word."""
    asked = plan(ALTERNATING)
    cell = replace(asked.cells[0], repeat=3)
    arguments = ping_arguments(asked, cell, 20, None)
    assert "pass=3" in [value for option, value in pairwise(arguments) if option == "--label"]


def test_plan_without_a_length_has_the_default_number_of_messages():
    asked = parse_plan("[run]\nwarmup = 0\n[axes]\nrate = 10\n", "p", "p.toml")
    assert asked.run.messages == DEFAULT_MESSAGES == 1000
    with pytest.raises(OptionError, match="give one of them"):
        parse_plan("[run]\nmessages = 0\n[axes]\nrate = 10\n", "p", "p.toml")


DISTANT = '[devices.relay]\nssh = "pi@robot"\n'


@pytest.mark.parametrize("elsewhere", [DISTANT, "[network]\nnamespaces = true\n"])
def test_bridge_of_halves_has_a_relay_of_its_own_where_that_is_on_another_device(elsewhere):
    text = PLAN.format(order="").replace('"builtin"', '"builtin", "zenoh-bridge-dds"')
    assert [group.bridge for group in schedule(parse_plan(text, "p", "p.toml"))] == [None] * 4
    groups = schedule(parse_plan(text + elsewhere, "p", "p.toml"))[:4]
    assert [(group.need.reliability, group.bridge, len(group.cells)) for group in groups] == [
        ("reliable", None, 6),  # the builtin bridge is one program, beside the ping
        ("reliable", "zenoh-bridge-dds", 3),
        ("best_effort", None, 6),
        ("best_effort", "zenoh-bridge-dds", 3),
    ]


def test_half_beside_the_relay_waits_and_the_pings_half_goes_there(sentences):
    distant = parse_plan(PLAN.format(order="").replace("builtin", "zenoh-bridge-dds") + DISTANT, "p", "p.toml")
    same, crossing = schedule(distant)[:2]
    sentences(" ".join(half_arguments(distant, crossing)))
    arguments = ping_arguments(distant, crossing.cells[0], 20, "robot")
    assert arguments[arguments.index("--bridge-peer") + 1] == "robot:7447"
    assert "--bridge-peer" not in ping_arguments(distant, same.cells[0], 20, "robot")


@pytest.mark.parametrize(("backend", "told"), [("ros2", False), ("zenoh", True), ("socket", True)])
def test_ping_gets_the_relays_address_if_its_backend_does_not_look_for_it(backend, told):
    plan = parse_plan(f'[run]\nmessages = 1\n[axes]\nbackend = "{backend}"\n', "p", "p.toml")
    (cell,) = plan.cells
    assert ("--peer" in ping_arguments(plan, cell, 20, "10.213.0.2")) is told
    assert "--peer" not in ping_arguments(plan, cell, 20, None)


def test_relays_address_is_that_of_ssh_or_has_to_be_given():
    text = PLAN.format(order="").replace("builtin", "zenoh-bridge-dds")
    assert parse_plan(text + DISTANT, "p", "p.toml").relay.reached_at == "robot"
    other = parse_plan(text + DISTANT + 'address = "10.0.0.7"\n', "p", "p.toml")
    assert other.relay.reached_at == "10.0.0.7"
    with pytest.raises(OptionError, match=r"give \[devices\.relay\] an address"):
        parse_plan(text, "p", "p.toml", by_hand=True)


def test_estimate_is_schedules_plus_overheads():
    # 24 runs of 10 s and 1 s to settle are 264 s; 2 s each to start, own cost included, 5 s for each of 12 bridged; 4 relays at 1 s
    assert plan_seconds(plan()).seconds == 24 * 11 + 24 * 2 + 12 * 5 + 4 * 1


def test_remaining_time_in_words():
    assert [str(Remaining(seconds)) for seconds in (0.4, 59, 61, 3599, 7260)] == [
        "0 s",
        "59 s",
        "1 min 01 s",
        "59 min 59 s",
        "2 h 01 min",
    ]


def test_estimate_learns_what_a_run_costs_beside_its_schedule():
    plan = parse_plan("[run]\nmessages = 90\nwarmup = 10\nsettle_seconds = 1\n[axes]\nrate = [10, 100]\n", "p", "p")
    estimate = Estimate(plan)
    slow, fast = plan.cells
    assert estimate.cell_seconds(slow) == 10 + 2 + 1
    estimate.measured(slow, 12.0)
    estimate.measured(fast, 5.0)
    # overheads of 2 and 4 s
    assert estimate.cell_seconds(fast) == 1 + 3 + 1
    assert estimate.remaining([slow, fast]).seconds == 14 + 5
