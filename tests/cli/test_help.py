"""Commands load what they need and no more: looked up in `sys.modules` of a fresh process."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

HEAVY = (
    *("numpy", "polars", "pyarrow", "scipy", "pandas", "plotly", "jinja2", "rich", "pygments", "markdown_it"),
    *("rclpy", "cyclonedds", "zenoh", "rti", "rosbags", "mcap", "cramjam", "zstandard", "isal", "psutil"),
    *("dask", "distributed", "fsspec", "s3fs", "pydantic", "sqlite3", "asyncio", "ssl"),
)
NOT_FOR_A_TABLE = {
    *("scipy", "pandas", "plotly", "jinja2", "rclpy", "cyclonedds", "zenoh", "rti", "rosbags", "psutil"),
    *("dask", "distributed", "fsspec", "s3fs", "pydantic", "pygments", "markdown_it"),
}
NOT_FOR_A_PING = {*HEAVY} - {
    "numpy",
    "rich",
    "mcap",
    "cramjam",
    "zstandard",
    "isal",
    "psutil",
    "asyncio",
    "ssl",
}
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
sys.argv = ["command", *words]
code = 0
try:
    importlib.import_module(module).main()
except SystemExit as end:
    code = end.code
print(json.dumps({"code": code, "loaded": [name for name in heavy if name in sys.modules]}))
"""
SAMPLES = Path(__file__).parents[2] / "sample_traces"


def called(module: str, *words: object) -> tuple[list[str], int, set[str]]:
    """Return the lines that a command printed, its exit code and the libraries of `HEAVY` that it loaded."""
    arguments = json.dumps([module, [*map(str, words)], HEAVY])
    ran = subprocess.run([sys.executable, "-c", CALL, arguments], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    *shown, said = ran.stdout.splitlines()
    state = json.loads(said)
    return shown, state["code"], set(state["loaded"])


@pytest.mark.parametrize("command", COMMANDS)
def test_help_loads_no_heavy_library(command):
    module, words = COMMANDS[command]
    shown, code, loaded = called(module, *words, "--help")
    assert any("Usage" in line for line in shown)
    assert (code, loaded) == (0, set())


def test_a_usage_error_loads_no_heavy_library():
    _, code, loaded = called("dds_trace.cli.sweep", "--unknown")
    assert (code, loaded) == (2, set())


def test_a_table_of_a_small_folder_loads_neither_figures_nor_middleware_nor_cluster(tmp_path):
    shown, code, loaded = called("dds_trace.cli.analyze", SAMPLES / "losses", "--out", tmp_path, "--no-cache")
    assert code == 0
    assert f"Wrote {tmp_path / 'summary.parquet'}" in shown
    assert "polars" in loaded
    assert loaded & NOT_FOR_A_TABLE == set()


def test_a_ping_over_sockets_loads_nothing_of_the_analyzer_nor_of_another_middleware(tmp_path):
    ping = ["--role", "ping", "--backend", "socket", "--discovery", "localhost", "--wait", "0.1"]
    _, code, loaded = called("dds_trace.cli.record", *ping, "--out", tmp_path / "ping.mcap")
    assert code != 0  # no relay answers
    assert "numpy" in loaded
    assert loaded & NOT_FOR_A_PING == set()


@pytest.mark.parametrize("columns", [60, 80, 200])
def test_help_keeps_names_whole_and_lines_narrow(columns, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(columns))
    shown, _, _ = called("dds_trace.cli.record", "--help")
    assert max(map(len, shown)) <= min(columns, 120)
    assert "zenoh-bridge-ros2dds," in " ".join(shown).split()
    assert "[bold]" not in "".join(shown)
    assert "\x1b" not in "".join(shown)  # a pipe gets plain text
