"""`--help` answers before any heavy library is loaded: looked up in `sys.modules` of a fresh process."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

HEAVY = ("numpy", "polars", "pyarrow", "plotly", "rclpy", "zstandard", "psutil", "jinja2")
COMMANDS = {
    "dds-record": ("dds_trace.cli.record", []),
    "dds-sweep": ("dds_trace.cli.sweep", []),
    "dds-bridge": ("dds_trace.cli.bridge", []),
    "dds-analyze": ("dds_trace.cli.analyze", []),
    "dds-analyze compare": ("dds_trace.cli.analyze", ["compare"]),
    "dds-analyze watch": ("dds_trace.cli.analyze", ["watch"]),
}
CALL = """
import importlib, json, sys
module, words, heavy = json.loads(sys.argv[1])
sys.argv = ["command", *words, "--help"]
try:
    importlib.import_module(module).main()
except SystemExit as end:
    print(json.dumps({"code": end.code, "loaded": [name for name in heavy if name in sys.modules]}))
"""


@pytest.mark.parametrize("command", COMMANDS)
def test_help_loads_no_heavy_library(command):
    module, words = COMMANDS[command]
    arguments = json.dumps([module, words, HEAVY])
    ran = subprocess.run([sys.executable, "-c", CALL, arguments], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    *shown, told = ran.stdout.splitlines()
    assert any("Usage" in line for line in shown)
    assert json.loads(told) == {"code": 0, "loaded": []}
