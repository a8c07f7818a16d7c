import json
import sys
from pathlib import Path

import pytest
from processes import relay, run
from typer.testing import CliRunner

from dds_trace.analyzer.pipeline import analyze
from dds_trace.extensions.bridges import BRIDGE_MODULES, command
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan
from dds_trace.tracefile.reading.reader import read_trace

SUPPORT = Path(__file__).parents[2] / "support"
WITH_TOY = f"""
import sys
sys.path.insert(0, {str(SUPPORT)!r})
from dds_trace.extensions.bridges import BRIDGE_MODULES
BRIDGE_MODULES["toy"] = "toy_bridge"
from dds_trace.cli.dds_record import main
main()
"""
"""`dds-record` with one more row; the row is all that it has more."""

MESSAGES = 10


@pytest.fixture
def toy_row(monkeypatch):
    monkeypatch.setitem(BRIDGE_MODULES, "toy", "toy_bridge")


@pytest.mark.middleware
def test_a_toy_bridge_carries_a_ping_and_its_relay_to_a_trace_that_analyzes(domains, tmp_path):
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    near, far = domains.take(), domains.take()
    program = Path(sys.executable).name
    with relay(far, tmp_path / "relay.mcap", "--depth", 1000) as echo:
        done = run(
            *(program, "-c", WITH_TOY, "--role", "ping", "--domain", near, "--out", tmp_path / "ping.mcap"),
            *("--bridge", "toy", "--relay-domain", far, "--data", "imu", "--rate", 50, "--depth", 1000),
            *("--messages", MESSAGES, "--warmup", 0),
        )
        assert done.status == 0, done.stderr
        assert echo.stop().status == 0
    bridge = read_trace(tmp_path / "ping.mcap").sessions[-1].extra["bridge"]
    assert (bridge["bridge"], bridge["state"], bridge["failure"]) == ("toy", "stopped", None)
    (ran,) = bridge["programs"]
    assert (ran["version"], ran["environment"]) == ("1.0-toy", {"TOY": "yes"})
    assert ran["log_tail"].startswith("bridging toys")
    (group,) = analyze(tmp_path).summary.to_dicts()
    assert (group["bridge"], group["domain_mode"]) == ("toy", "different")
    assert (group["published"], group["received"]) == (MESSAGES, MESSAGES)


@pytest.mark.usefixtures("toy_row")
def test_a_toy_bridge_is_listed_and_shows_its_configuration():
    (check,) = [check for check in command.installed() if check[1] == "toy"]
    assert check == ("bridges", "toy", True, "1.0-toy (tried: in this test)")
    shown = CliRunner().invoke(command.app, ["toy", "--config", "--from", "3", "--to", "4"])
    assert json.loads(shown.output)["relay_domain_id"] == 4


@pytest.mark.usefixtures("toy_row")
def test_a_toy_bridge_is_a_value_of_a_plans_axis():
    plan = parse_plan('[run]\nmessages = 1\n[axes]\nbridge = ["none", "toy"]\n', "plan", "plan.toml", by_hand=True)
    same, through = plan.cells
    assert through.name == "ros2_toy_binary_10Hz"
    assert not plan.runs_halves(through)  # as its own fact `halves` says
    assert not same.crosses_domains


def test_help_names_a_toy_bridge():
    done = run(Path(sys.executable).name, "-c", WITH_TOY, "--help", environment={"COLUMNS": "300"})
    assert "domain_bridge or toy." in " ".join(done.stdout.split())
