"""The plan of the committee's questions, as it is and as docs/results/tsc.md changes it for two boards."""

from __future__ import annotations

import re
from pathlib import Path

from dds_trace.recorder.sweep.plan.plan_file import parse_plan

TEXT = (Path(__file__).parents[4] / "plans" / "tsc.toml").read_text()
BOARDS = '[devices.ping]\nname = "robot"\n[devices.relay]\nname = "base"\nssh = "user@base"\nsetup = ". /opt/ros/jazzy/setup.sh"\n'


def test_each_group_of_results_is_below_its_question():
    groups = TEXT.split("[[matrix]]")[:-1]
    assert all(re.search(r"\n# (Performance|WiFi): [^\n]+\n$", group) for group in groups)


def test_two_boards_have_the_same_results_without_namespaces():
    own = TEXT[: TEXT.rindex("[[matrix]]")]  # without outages
    text = own.replace("[network]\nnamespaces = true\n", "").replace("hosts = [2, 5]\n", "")
    plan = parse_plan(text + BOARDS, "tsc", "tsc.toml")
    assert plan.has_two_devices
    assert not plan.namespaces
    assert {cell.backend for cell in plan.cells} == {"ros2", "cyclonedds", "zenoh"}
