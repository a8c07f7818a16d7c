import os
import signal
import subprocess
import sys

import pytest
from middlewares import skip_without
from namespaces import needs_namespaces
from processes import sweep
from waiting import wait_until

from dds_trace.analyzer.pipeline import analyze
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.reading.reader import read_trace

pytestmark = pytest.mark.middleware

FLOWS = """
[run]
seconds = 2
warmup = 2
settle_seconds = 0
domain = {domain}
own_cost_passes = 1
[axes]
backend = "socket"
[[flows]]
name = "images"
size = "200KB"
rate = 20
[[flows]]
name = "odom"
data = "binary"
size = "100"
rate = 100
"""

OUTAGE = """
[run]
warmup = 2
settle_seconds = 0
outage_after_seconds = 0.5
outage_limit_seconds = {limit}
domain = {domain}
{network}
[axes]
backend = "socket"
size = "1KB"
rate = 50
outage = {seconds}
outage_by = "{by}"
"""


def test_two_flows_of_one_kind_of_data_share_a_relay_and_run_together(tmp_path, domain_id):
    assert sweep(tmp_path, FLOWS.format(domain=domain_id))["cells"] == 4
    spans, relays = {}, set()
    for path in (tmp_path / "runs/p").glob("*.ping.mcap"):
        trace = read_trace(path)
        sent = trace.events[Stage.T1].monotonic_ns
        spans[trace.runs[0].labels["cell"]] = int(sent[0]), int(sent[-1])
        relays |= {session.session_id for session in read_trace(str(path).replace(".ping.", ".relay.")).sessions}
    together = [span for name, span in spans.items() if "_with-" in name]
    assert max(start for start, _ in together) < min(end for _, end in together)
    analysis = analyze(tmp_path / "runs/p")
    assert analysis.summary.height == 4
    assert set(analysis.details.interference["flow"]) == {"images", "odom"}
    assert set(analysis.details.head_of_line["other"]) == {"images", "odom"}
    codes = {finding.code for finding in analysis.findings}
    assert not {"overlapping_pings", "forged_or_foreign", "nothing_received"} & codes


def test_a_killed_relay_is_started_anew_and_the_first_reply_after_that_is_timed(tmp_path, domain_id):
    sweep(tmp_path, OUTAGE.format(limit=15, domain=domain_id, network="", seconds=0.5, by="relay"))
    (row,) = analyze(tmp_path / "runs/p").details.recoveries.to_dicts()
    assert (row["by"], row["never"]) == ("relay", False)
    assert row["outage_ns"] >= 500_000_000
    assert row["back_ns"] >= row["out_ns"] > 0
    assert row["lost_within"] > 0


@needs_namespaces("tc", "iproute2")
@pytest.mark.parametrize("by", ["link", "loss", "address"])
def test_a_link_that_is_cut_comes_back(tmp_path, domain_id, by):
    network = "[network]\nnamespaces = true\n"
    sweep(tmp_path, OUTAGE.format(limit=4, domain=domain_id, network=network, seconds=0.4, by=by))
    (row,) = analyze(tmp_path / "runs/p").details.recoveries.to_dicts()
    assert (row["by"], row["never"]) == (by, False)
    assert row["outage_ns"] >= 400_000_000
    # TCP sends again what was lost, but not from another address: there the ping connects again.
    assert (row["lost_within"] > 0) == (by == "address")


STALL = """
import time
from dds_trace.recorder.payloads.stamp import RawStampPlace
reply = RawStampPlace.reply

def stalled(self, message, relay_id_text):
    time.sleep(0.1 if len(message) > 100_000 else 0)
    return reply(self, message, relay_id_text)

RawStampPlace.reply = stalled
"""


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["socket", "cyclonedds"])
def test_a_stall_of_the_large_flow_is_found_in_the_small_one(tmp_path, domain_id, monkeypatch, backend):
    skip_without(backend)
    text = FLOWS.replace("seconds = 2\n", "seconds = 6\nrepeats = 3\n").replace("rate = 20", "rate = 2")
    text = text.replace('"socket"', f'"{backend}"\ndepth = 100').format(domain=domain_id)
    added_ns = []
    for name in ("sound", "stalled"):
        folder = tmp_path / name
        folder.mkdir()
        if name == "stalled":
            (folder / "sitecustomize.py").write_text(STALL)
            monkeypatch.setenv("PYTHONPATH", str(folder))
        sweep(folder, text)
        interference = analyze(folder / "runs/p").details.interference
        (row,) = interference.filter(flow="odom", metric="latency", statistic="p99").to_dicts()
        added_ns.append(row["difference_ns"])
    # A latency is half of the round trip less the relay: between 50 and 100 ms where the way out waited, the way back, or both.
    assert 40e6 < added_ns[1] < 200e6
    assert added_ns[0] < added_ns[1] / 2


HEAD = """
[run]
messages = 20
warmup = 2
settle_seconds = 0
domain = {domain}
own_cost_passes = 1
"""
HOSTS = "wire = true\nrepeats = 3\n[network]\nnamespaces = true\n[axes]\nrate = 20\nsize = '1KB'\nhosts = 3\n"


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
    (tmp_path / "p.toml").write_text(text)
    command = [sys.executable, "-m", "dds_trace", "sweep", tmp_path / "p.toml", "--out", tmp_path / "runs"]
    running = subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL)
    wait_until(lambda: len(list(folder.glob("*.ping.mcap"))) >= 2 or running.poll() is not None)
    assert running.poll() is None
    os.kill(running.pid, signal.SIGKILL)
    running.wait()
    assert sweep(tmp_path, text)["cells"] == 6
    assert len(list(folder.glob("*.relay*.mcap"))) == 18
    once, each = analyze(tmp_path / "runs").details.fan_out.sort("wire_bytes_per_receiver").iter_rows(named=True)
    assert (once["receivers"], each["receivers"], each["runs"]) == (3, 3, 3)
    assert 2 < each["wire_bytes_per_receiver"] / once["wire_bytes_per_receiver"] < 4
    assert each["discovery_bytes_p50"] > 0


THROUGHPUT = """
[run]
seconds = 0.5
settle_seconds = 0
domain = {domain}
own_cost_passes = 1
[axes]
backend = "{backend}"
size = "1KB"
rate = "max"
ping_share = 0.05
depth = 100
"""
"""The last 100 messages have 5 pings: of the usual 10, to which a relay without a processor gets, none may be one."""


@pytest.mark.parametrize("backend", ["socket", "cyclonedds"])
def test_throughput_and_latency_come_from_one_run(tmp_path, domain_id, backend):
    skip_without(backend)
    sweep(tmp_path, THROUGHPUT.format(backend=backend, domain=domain_id))
    (path,) = (tmp_path / "runs/p").glob("*_max_*.ping.mcap")
    trace = read_trace(path)
    run, sent = trace.runs[-1], trace.events[Stage.T1]
    assert (run.rate_hz, run.ping_every) == (0, 20)
    assert run.planned_messages == run.published - run.warmup_messages > 100
    assert not sent.scheduled_ns.any()
    assert not (trace.events[Stage.T2].sequence % 20).any()
    relay = read_trace(str(path).replace(".ping.", ".relay."))
    assert not (relay.events[Stage.T4].sequence % 20).any()

    analysis = analyze(tmp_path / "runs/p")
    (row,) = analysis.summary.to_dicts()
    assert (row["rate_hz"], row["unsent"], row["response_p50_ns"]) == (0, 0, None)
    assert row["published"] <= row["sent"] / 20 + 1
    assert 0 < row["reached"] <= row["sent"]
    assert row["reached"] == len(relay.events[Stage.T3].take(relay.events[Stage.T3].sequence >= run.warmup_messages))
    assert row["transfer_rate_bytes_per_s"] == pytest.approx(1000 * row["reached_rate_hz"])
    assert row["latency_p50_ns"] > 0
    if backend == "socket":  # TCP loses nothing
        assert row["reached"] == row["sent"]
    sender, codes = run.extra["sender"], {finding.code for finding in analysis.findings}
    assert 0 < sender["cpu_ns"] <= sender["elapsed_ns"]
    if backend == "cyclonedds":  # its writer waits for nobody
        assert "client_bound" in codes
    assert not {"late_sends", "schedule_not_held", "no_schedule", "orphan_events", "missing_publications"} & codes
