import os
import signal
import subprocess
import sys
import time

import pytest
from namespaces import needs_namespaces
from processes import sweep

from dds_trace.analyzer.pipeline import analyze

pytestmark = pytest.mark.middleware

HEAD = """
[run]
messages = 20
warmup = 2
settle_seconds = 0
domain = {domain}
own_cost_passes = 1
"""
HOSTS = "wire = true\nrepeats = 3\n[network]\nnamespaces = true\n[axes]\nrate = 20\nsize = '1KB'\nhosts = 3\n"


def command(folder, text):
    plan = folder / "p.toml"
    plan.write_text(text)
    return [sys.executable, "-m", "dds_trace", "sweep", plan, "--out", folder / "runs", "--json"]


def test_three_relays_answer_each_message(tmp_path, domain_id):
    pytest.importorskip("cyclonedds")
    sweep(
        tmp_path,
        HEAD.format(domain=domain_id)
        + "[axes]\nbackend = 'cyclonedds'\nrate = 20\nsize = '1KB'\ndepth = 25\nrelays = 3\n",
    )
    details = analyze(tmp_path / "runs").details
    (row,) = details.fan_out.iter_rows(named=True)
    assert (row["receivers"], row["complete"], row["recorders"], row["bound_ns"]) == (3, 20, 4, 0)
    assert 0 < row["first_receiver_p50_ns"] < row["last_receiver_p50_ns"]
    assert row["matched_p50_ns"] > 0
    assert details.fan_out_positions["relay_id"].to_list() == [1, 2, 3]
    assert details.fan_out_positions["first_share"].sum() == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("axis", ["pings", "topics"])
def test_two_senders_run_at_the_same_time_on_one_relay(tmp_path, domain_id, axis):
    sweep(
        tmp_path, HEAD.format(domain=domain_id) + f"[axes]\nbackend = 'socket'\nrate = 20\nsize = '1KB'\n{axis} = 2\n"
    )
    analysis = analyze(tmp_path / "runs")
    assert len(analysis.runs) == 2
    assert analysis.summary["received"].to_list() == [20, 20]
    assert analysis.details.fan_out["senders"].to_list() == [2, 2]
    assert all(f"{axis}=2" in setting for setting in analysis.summary["setting"])


@pytest.mark.slow
@needs_namespaces("tc", "iproute2")
def test_multicast_sends_once_for_three_hosts_and_a_killed_sweep_goes_on(tmp_path, domain_id):
    pytest.importorskip("cyclonedds")
    text = HEAD.format(domain=domain_id) + HOSTS + "backend = 'cyclonedds'\nmulticast = [true, false]\n"
    folder = tmp_path / "runs/p"
    running = subprocess.Popen(command(tmp_path, text), start_new_session=True, stdout=subprocess.DEVNULL)
    while len(list(folder.glob("*.ping.mcap"))) < 2:
        assert running.poll() is None
        time.sleep(0.2)
    os.kill(running.pid, signal.SIGKILL)
    running.wait()
    assert sweep(tmp_path, text)["cells"] == 6
    assert len(list(folder.glob("*.relay*.mcap"))) == 18
    once, each = analyze(tmp_path / "runs").details.fan_out.sort("wire_bytes_per_receiver").iter_rows(named=True)
    assert (once["receivers"], each["receivers"], each["runs"]) == (3, 3, 3)
    assert 2 < each["wire_bytes_per_receiver"] / once["wire_bytes_per_receiver"] < 4
    assert each["discovery_bytes_p50"] > 0
