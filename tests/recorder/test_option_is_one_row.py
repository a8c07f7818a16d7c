import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from dds_trace.extensions.campaigns.plan.plan import RunSettings
from dds_trace.extensions.campaigns.station.station import Station
from dds_trace.recorder.option_table import OPTIONS
from dds_trace.recorder.options import DEFAULT_WAIT_S, DEFAULT_WARMUP, PingOptions

TOP = Path(__file__).parents[2]
ROW = """
    toy_level: int | None = option(
        None, "--toy-level N", "How much of a toy it is.", limit=limits.DEPTH, axis=Axis()
    )
"""
USES = """
import json
from generated.commands import commands
from generated.plan_keys import plan_keys
from dds_trace.cli.record import command
from dds_trace.recorder.options import side_settings
from dds_trace.extensions.campaigns.plan.cells import Cell
from dds_trace.extensions.campaigns.plan.commands import ping_arguments, relay_arguments
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan
from dds_trace.extensions.campaigns.plan.schema import plan_schema

taken = []
arguments = ["--role", "relay", "--out", "x.mcap", "--toy-level", "3"]
command.app(arguments, obj=taken.append, standalone_mode=False)
plan = parse_plan("[axes]\\ntoy_level = [1, 2]", "toy", "toy.toml")
cell = plan.cells[-1]
print(json.dumps({
    "value": taken[0].node.toy_level,
    "settings": side_settings(taken[0], "loopback"),
    "cells": [cell.name for cell in plan.cells],
    "ping": "--toy-level 2" in " ".join(ping_arguments(plan, cell, 1.0, None)),
    "relay": "--toy-level 2" in " ".join(relay_arguments(plan, cell.relay)),
    "schema": "toy_level" in plan_schema()["$defs"],
    "reference": [word in page for word, page in (("-o toy_level=N", commands()), ("`toy_level`", plan_keys()))],
}))
"""


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """Runs Python with the copy of the code that has the row; what it prints, and its errors."""
    folder = tmp_path_factory.mktemp("copy")
    shutil.copytree(TOP / "src", folder / "src", ignore=shutil.ignore_patterns("__pycache__"))
    table = folder / "src/dds_trace/recorder/backends/node.py"
    text = table.read_text(encoding="utf-8")
    above = '    name: str = field(default="dds_trace", metadata=OUTSIDE_OF_KEY)\n'
    assert text.count(above) == 1
    table.write_text(text.replace(above, ROW + above), encoding="utf-8")
    paths = os.pathsep.join(map(str, (folder / "src", TOP / "docs")))
    environment = {**os.environ, "PYTHONPATH": paths, "COLUMNS": "100"}

    def run(*arguments, **variables):
        command, variables = [sys.executable, *arguments], {**environment, **variables}
        done = subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True, check=False)
        return done.stdout, done.stderr

    run.folder = folder
    return run


RECORD = ("-m", "dds_trace.cli.record")


def test_it_is_in_the_help_and_among_the_defaults(ran):
    assert "toy_level=N " in ran(*RECORD, "-o", "help")[0]
    config, _ = ran(*RECORD, "--print-config", "--toy-level", "7")
    assert ["-o", "toy_level", "7", "option"] in [line.split() for line in config.splitlines()]
    (ran.folder / "dds-trace.toml").write_text("[record]\ntoy-level = 4\n")
    config, _ = ran(*RECORD, "--print-config", DDS_TRACE_CONFIG="dds-trace.toml")
    assert ["-o", "toy_level", "4", "dds-trace.toml"] in [line.split() for line in config.splitlines()]


def test_it_is_checked(ran):
    refused = ran(*RECORD, "--role", "relay", "--out", "x.mcap", "--toy-level", "0")[1]
    assert "--toy-level 0: " in refused


def test_it_reaches_recordings_plans_and_the_reference(ran):
    pytest.importorskip("sphinx", reason="the extra [docs] is not installed")
    out, err = ran("-c", USES)
    assert out, err
    used = json.loads(out.splitlines()[-1])
    assert used == {
        "value": 3,
        "settings": {"toy_level": 3},
        "cells": ["ros2_same_binary_10Hz_toy_level-1", "ros2_same_binary_10Hz_toy_level-2"],
        "ping": True,
        "relay": True,
        "schema": True,
        "reference": [True, True],
    }


def test_defaults_that_several_modules_need_are_one_number():
    assert PingOptions().wait_s == DEFAULT_WAIT_S == Station((), None).wait_s
    assert PingOptions().warmup == RunSettings().warmup == DEFAULT_WARMUP
    assert OPTIONS["wait_s"].field_default == DEFAULT_WAIT_S
