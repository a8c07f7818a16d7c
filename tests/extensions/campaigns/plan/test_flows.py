from dataclasses import replace

import pytest

from dds_trace.base.errors import OptionError
from dds_trace.extensions.campaigns.plan.commands import ping_arguments, relay_arguments
from dds_trace.extensions.campaigns.plan.flows import FLOW_KEYS, recorded_together
from dds_trace.extensions.campaigns.plan.plan import Order
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan
from dds_trace.extensions.campaigns.plan.schedule import plan_seconds, schedule

HEAD = "[run]\nseconds = 2\n[axes]\nbackend = 'socket'\n"
CAMERA = "[[flows]]\nname = 'camera'\nsize = '1MB'\nrate = 20\n"
IMU = "[[flows]]\nname = 'imu'\ndata = 'imu'\nrate = 100\n"
ODOM = "[[flows]]\nname = 'odom'\ndata = 'string'\nrate = 50\n"


def plan_of(text):
    return parse_plan(text, "p", "p.toml")


def test_each_flow_alone_each_pair_and_all_on_one_relay():
    plan = plan_of(HEAD + CAMERA + IMU + ODOM)
    assert [(cell.flow, cell.with_flows) for cell in plan.cells] == [
        ("camera", ()),
        ("imu", ()),
        ("odom", ()),
        ("camera", ("imu",)),
        ("imu", ("camera",)),
        ("camera", ("odom",)),
        ("odom", ("camera",)),
        ("imu", ("odom",)),
        ("odom", ("imu",)),
        ("camera", ("imu", "odom")),
        ("imu", ("camera", "odom")),
        ("odom", ("camera", "imu")),
    ]
    assert len({cell.name for cell in plan.cells}) == 12
    assert plan.cells[3].name == "socket_same_binary-1MB_20Hz_camera_with-imu"
    assert (plan.cells[0].size, plan.cells[0].rate, plan.cells[1].data) == (1_000_000, 20.0, "imu")
    assert plan.run.order is Order.ALTERNATING
    (group,) = schedule(plan)
    assert [len(cells) for cells in recorded_together(group.cells)].count(1) == 3
    assert sorted(len(cells) for cells in recorded_together(group.cells)) == [1, 1, 1, 2, 2, 2, 3]


@pytest.mark.parametrize("own", [{"priority": "high"}, {"when_full": "drop"}, {"priority": "low", "when_full": "drop"}])
def test_flows_that_differ_in_what_a_flow_may_have_are_sent_together(own):
    assert own.keys() < FLOW_KEYS.keys()
    alike, other = plan_of(HEAD + CAMERA + IMU).cells[2:]
    ((first, second),) = recorded_together([alike, replace(other, **own)])
    assert (first.flow, second.flow) == ("camera", "imu")


def test_two_flows_have_no_set_twice():
    assert len(plan_of(HEAD + CAMERA + IMU).cells) == 4


def test_the_time_of_a_plan_counts_flows_that_run_together_once():
    alone = plan_of(HEAD + CAMERA + IMU)
    each = plan_of(HEAD + "data = ['binary', 'imu', 'string', 'string']\n".replace(", 'string', 'string'", ""))
    assert plan_seconds(alone).seconds < 2.8 * plan_seconds(each).seconds


def test_arguments_name_the_flow_its_topics_and_what_runs_beside_it():
    plan = plan_of(HEAD + CAMERA + IMU)
    alone, together = plan.cells[0], plan.cells[2]
    relay = relay_arguments(plan, alone.relay)
    assert [relay[i + 1] for i, word in enumerate(relay) if word == "--flow"] == ["camera", "imu"]
    of_alone, of_together = (" ".join(ping_arguments(plan, cell, 1.0, None)) for cell in (alone, together))
    for text in (of_alone, of_together):
        assert "--flow camera --setting flow=camera" in text
    assert "with_flows" not in of_alone
    assert "--setting with=imu" in of_together
    assert "--no-own-cost" in of_together  # of several pings at once none measures its own
    assert "--no-own-cost" not in of_alone


@pytest.mark.parametrize(
    ("text", "word"),
    [
        (HEAD + CAMERA, "2 to 8"),
        (HEAD + CAMERA + IMU.replace("imu'\ndata", "camera'\ndata"), "one name"),
        (HEAD + CAMERA + IMU.replace("name = 'imu'\n", ""), "needs a name"),
        (HEAD + CAMERA + IMU.replace("'imu'\ndata", "'my imu'\ndata"), "flow's name"),
        (HEAD + "rate = 5\n" + CAMERA + IMU, "rate"),
        (HEAD.replace("seconds = 2", "messages = 20") + CAMERA + IMU, "seconds"),
        (HEAD + "bridge = 'builtin'\n" + CAMERA + IMU, "bridge"),
        (HEAD + CAMERA + IMU + "qos = 3\n", "qos"),
        (HEAD + CAMERA + IMU.replace("rate = 100", "rate = [100, 200]"), "rate"),
    ],
)
def test_what_flows_cannot_be_is_one_line(text, word):
    with pytest.raises(OptionError) as error:
        plan_of(text)
    assert word in str(error.value)
    assert "\n" not in str(error.value)
