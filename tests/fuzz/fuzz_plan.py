"""Fuzz target `plan`: a plan is read, scheduled and made into commands, or refused with an `OptionError` that names its file."""

from pathlib import Path
from typing import Any

from fuzz_shapes import changed_fields, must_name, shaped, shaped_seeds

from dds_trace.base.errors import OptionError
from dds_trace.base.toml_table import TomlTable
from dds_trace.extensions.campaigns.plan.commands import half_arguments, ping_arguments, relay_arguments
from dds_trace.extensions.campaigns.plan.plan_file import read_plan
from dds_trace.extensions.campaigns.plan.schedule import Estimate, schedule

PLAN = """
name = "fuzzed"
description = "a plan with every table"
[run]
messages = 10
warmup = 2
settle_seconds = 0.5
cutoff_seconds = 3.0
order = "alternating"
seed = 1
repeats = 2
attempts = 2
discovery = "localhost"
domain = 10
ping_domain = 5
[axes]
backend = ["socket", "ros2"]
bridge = ["none", "builtin"]
rate = [10, 2.5]
depth = 5
[[matrix]]
data = "binary"
size = ["33KB", 100]
[[matrix]]
data = "imu"
reliability = "best_effort"
[[exclude]]
backend = "socket"
bridge = "builtin"
reason = "no ROS 2"
[devices]
connectivity = "loopback"
[devices.ping]
options = ["--realtime", "5"]
[devices.relay]
name = "other"
[link]
preset = "wifi-54"
loss_percent = 1.0
[search]
min_rate = 1
max_rate = 20.0
"""
INSTALLED = [("socket", None), ("ros2", "rmw_fastrtps_cpp")]
MOST_SCHEDULED = 1000
"""Runs of a plan beyond which it is not scheduled here: the schedule is a list of all runs."""


class Target:
    def __init__(self, folder: Path) -> None:
        self._path = folder / "plan.toml"
        self._shapes = (self._text, self._changed)

    def try_input(self, data: bytes) -> None:
        """Read the plan that the bytes stand for; make the commands of its runs."""
        shaped(self._shapes, data)
        try:
            plan = read_plan(self._path, lambda: INSTALLED)
        except OptionError as err:
            must_name(self._path, err)
            if "\n" in str(err):
                raise AssertionError(f"the error has several lines: {err}") from err
            return
        if len(plan.cells) * plan.run.repeats > MOST_SCHEDULED:
            return
        estimate = Estimate(plan)
        for group in schedule(plan):
            texts = relay_arguments(plan, group.need)
            if group.bridge:
                texts += half_arguments(plan, group)
            for cell in group.cells:
                texts += ping_arguments(plan, cell, 20.0, plan.relay.reached_at)
            if not all(isinstance(text, str) for text in texts):
                raise AssertionError(f"an argument is no text: {texts}")
        str(estimate.remaining(plan.cells))

    def seeds(self) -> dict[str, bytes]:
        return shaped_seeds(self._shapes, {self._text: PLAN.encode(), self._changed: bytes(3)})

    def _text(self, data: bytes) -> None:
        self._path.write_bytes(data)

    def _changed(self, data: bytes) -> None:
        self._path.write_text(
            toml(changed_fields(dict(TomlTable.parse(PLAN, "the plan").values), data)), errors="replace"
        )


def toml(table: dict[str, Any]) -> str:
    """Return a table as TOML with inline tables; None, which TOML has not, is an empty text."""
    return "".join(f"{text(key)} = {text(value)}\n" for key, value in table.items())


def text(value: object) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{text(key)} = {text(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(text, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    escaped = "".join(c if c.isalnum() and c.isascii() else f"\\U{ord(c):08x}" for c in value or "")
    return f'"{escaped}"'
