"""Real plans over real middleware: killed and resumed, across a shaped link, over ssh, with a person's help."""

import json
import os
import shlex
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path

import loopback_sshd
import psutil
import pytest
from namespaces import needs_namespaces
from processes import own_port
from waiting import wait_until

from dds_trace.extensions.bridges.base import load_bridge
from dds_trace.extensions.campaigns.station.emulation import ip
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.reading.reader import read_trace

pytest.importorskip("rclpy", reason="no ROS 2 here")
pytestmark = pytest.mark.middleware

skipped = needs_namespaces("tc", "iproute2")
BIN = Path(sys.executable).parent


class Sweep:
    def __init__(self, folder, domains, text):
        self.folder = folder
        self.plan = folder / "small.toml"
        head = f"[run]\nmessages = 20\nwarmup = 2\nsettle_seconds = 0\ndomain = {domains.take()}\nping_domain = {domains.take()}\n"
        # All messages of a run wait for a side that is held up: of ten it would have the last ten.
        for table in ("[axes]\n", "[[matrix]]\n"):
            text = text.replace(table, f"{table}depth = 25\n")
        self.plan.write_text(head + text)
        self.runs = folder / "runs" / "small"

    def start(self, *options, command="sweep"):
        return subprocess.Popen(
            [sys.executable, "-m", "dds_trace", command, self.plan, "--out", self.folder / "runs", *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, *options):
        with self.start(*options) as process:
            stdout, stderr = process.communicate()
        return process.returncode, stdout, stderr

    @property
    def cells(self):
        path = self.runs / "state.json"
        return json.loads(path.read_text())["cells"] if path.exists() else {}

    def statuses(self):
        return Counter(cell["status"] for cell in self.cells.values())

    def traces(self, role):
        return {path.name.removesuffix(f".{role}.mcap"): read_trace(path) for path in self.runs.glob(f"*.{role}.mcap")}


@pytest.fixture
def sweep(tmp_path, domains):
    return lambda text: Sweep(tmp_path, domains, text)


def check_pairs(sweep, cells):
    pings, relays = sweep.traces("ping"), sweep.traces("relay")
    assert set(pings) == set(relays) == set(cells)
    for name, ping in pings.items():
        (run,) = ping.runs
        assert run.labels["cell"] == name
        assert run.state == "finished"
        assert run.qos.depth > 22
        assert len(ping.events[Stage.T1]) == 22
        for stage in (Stage.T3, Stage.T4):
            assert set(relays[name].events[stage].run_id.tolist()) == {run.run_id}
            assert sorted(relays[name].events[stage].sequence.tolist()) == list(range(22))
    assert len({ping.runs[0].run_id for ping in pings.values()}) == len(cells)
    assert [path.name for path in sweep.runs.rglob("*.mcap") if path.parent != sweep.runs] == []


def test_killed_in_the_middle_and_resumed_each_cell_is_there_once(sweep):
    small = sweep(
        '[[matrix]]\ndata = "imu"\nrate = [50, 100]\n[[matrix]]\ndata = "string"\nbridge = "builtin"\nrate = 50\n'
    )
    first = small.start()
    wait_until(lambda: small.statuses()["recorded"] >= 1 and small.statuses()["running"] == 1)
    children = psutil.Process(first.pid).children(recursive=True)
    assert children
    first.send_signal(signal.SIGKILL)
    first.communicate()
    before = {name: cell["run_id"] for name, cell in small.cells.items() if cell["status"] == "recorded"}

    code, stdout, stderr = small.run()
    assert code == 0, stderr
    assert "3 of 3 recordings are complete" in stdout
    check_pairs(small, small.cells)
    assert small.statuses() == {"complete": 3}
    assert {name: small.cells[name]["run_id"] for name in before} == before
    assert not [child for child in children if child.is_running() and child.status() != psutil.STATUS_ZOMBIE]

    after = small.cells
    assert small.run()[0] == 0
    assert small.cells == after


@pytest.mark.thorough
@skipped
@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="the relay needs a processor of its own")
def test_a_half_of_a_bridge_is_on_each_side_and_the_relays_processor_is_slowed(sweep):
    pytest.importorskip("cyclonedds")
    pytest.importorskip("zenoh")
    cell = 'backend = "cyclonedds"\nbridge = "builtin-zenoh"\ndata = "imu"\nrate = 50\nload = "emulated-pi3"\n'
    small = sweep(f"[network]\nnamespaces = true\n[[matrix]]\n{cell}")
    code, _, stderr = small.run()
    assert code == 0, stderr
    check_pairs(small, small.cells)
    ((name, ping),) = small.traces("ping").items()
    (half,) = ping.sessions[-1].extra["bridge"]["programs"]
    assert half["half"] == "ping"  # the relay's runs in the other namespace
    load = small.traces("relay")[name].sessions[-1].extra["load"]
    assert (load["kind"], load["program"]) == ("emulated-pi3", "own")
    assert load["cpu_s"] > 0


@skipped
def test_latencies_show_the_link_between_two_namespaces(sweep):
    if not Path("/dev/net/tun").exists():
        pytest.skip("no TAP devices here")
    small = sweep('[axes]\nsize = "33KB"\nrate = 10\n[link]\nrate_mbit_s = 54\ndelay_ms = 10\n')
    code, _, stderr = small.run()
    assert code == 0, stderr
    check_pairs(small, small.cells)
    ((name, ping),) = small.traces("ping").items()
    sent, replies = ping.events[Stage.T1], ping.events[Stage.T2]
    rtt_ms = [
        (receive_ns - dict(zip(sent.sequence.tolist(), sent.monotonic_ns.tolist(), strict=True))[sequence]) / 1e6
        for sequence, receive_ns in zip(replies.sequence.tolist(), replies.monotonic_ns.tolist(), strict=True)
    ]
    # Each way: 10 ms of delay, and 33,000 bytes at 54 Mbit/s of which 3,028 pass at once.
    assert min(rtt_ms) > 2 * (10 + (33_000 - 3_028) * 8 / 54e6 * 1e3)
    assert ping.sessions[0].connectivity == "emulated-custom"
    assert "54 Mbit/s, delay 10 ms" in ping.runs[0].labels["link"]
    (link,) = [sample for sample in small.traces("relay")[name].host_samples if "link" in sample]
    assert link["link"]["delay_ms"] == 10
    assert link["ping"]["sent_bytes"] > 22 * 33_000
    if link["forwarder"]:
        assert link["forwarder"]["from_relay"]["lateness_p99_us"] > 0
    assert f"ddstrace-{os.getpid()}" not in ip("netns", "list")


@pytest.fixture
def robot(tmp_path, domain_id):
    """The `[devices]` of a plan whose relay is reached through ssh; it is this machine after all."""
    return (
        '[devices]\nconnectivity = "wireless"\n'
        + loopback_sshd.robot(tmp_path)
        + f"bridge_port = {own_port(domain_id)}\n"
    )


def test_relay_over_ssh(sweep, robot, tmp_path):
    # On one machine after all: nothing is to leave it.
    small = sweep('discovery = "localhost"\n[axes]\ndata = "imu"\nrate = [50, 100]\n' + robot)
    code, _, stderr = small.run()
    assert code == 0, stderr
    check_pairs(small, small.cells)
    assert {trace.sessions[0].device for trace in small.traces("relay").values()} == {"robot"}
    assert {trace.sessions[0].connectivity for trace in small.traces("ping").values()} == {"wireless"}
    assert list((tmp_path / "home").rglob("*.mcap")) == []


@pytest.mark.thorough
def test_half_of_a_bridge_beside_the_relay_over_ssh(sweep, robot):
    pytest.importorskip("zenoh", reason="no zenoh here")
    small = sweep(
        'discovery = "localhost"\n[axes]\ndata = "imu"\nrate = 50\nbridge = ["none", "builtin-zenoh"]\n' + robot
    )
    code, _, stderr = small.run()
    assert code == 0, stderr
    check_pairs(small, small.cells)
    domains = {trace.runs[0].bridge: trace.sessions[0].domain_id for trace in small.traces("ping").values()}
    assert domains["none"] != domains["builtin-zenoh"]


def test_person_starts_what_is_printed_and_the_sweep_goes_on_by_echo(sweep, tmp_path):
    small = sweep(
        'discovery = "localhost"\n[devices.relay]\nssh = "nobody@127.0.0.1"\n[axes]\ndata = "imu"\nrate = [50, 100]\n'
    )
    process = small.start("--print", "relay")
    lines = []
    while not lines or not lines[-1].startswith("start on the other device: "):
        lines.append(process.stderr.readline())
        assert lines[-1], f"ended: {lines}"
    assert lines[0].startswith("relay 1: DDS_TRACE_CONFIG= dds-trace record relay")
    command = shlex.split(lines[-1].removeprefix("start on the other device: DDS_TRACE_CONFIG= "))
    with subprocess.Popen([BIN / command[0], *command[1:]], cwd=tmp_path, stderr=subprocess.DEVNULL) as relay:
        stdout, stderr = process.communicate()
        relay.terminate()
    assert process.returncode == 0, stderr
    assert "2 of 2 recordings are complete" in stdout
    pings = small.traces("ping")
    assert len(pings) == 2
    served = read_trace(tmp_path / "relay-1.mcap").events[Stage.T3].run_id.tolist()
    assert set(served) == {trace.runs[0].run_id for trace in pings.values()}


def test_cells_that_cannot_be_recorded_are_named_and_the_exit_code_tells(sweep):
    if load_bridge("routing-service").find() is not None:
        pytest.skip("RTI Routing Service is installed here")
    small = sweep('[axes]\ndata = "imu"\nrate = 50\nbridge = ["none", "routing-service"]\n')
    code, stdout, stderr = small.run()
    assert code == 10
    assert "1 of 2 recordings are complete" in stdout
    assert "the bridge routing-service is not installed" in stderr.splitlines()[-1]


@pytest.mark.slow
def test_highest_rate_is_what_the_link_carries(sweep):
    """100 KB in 70 segments of at most 1448 bytes are 105 KB on the wire: 100 Mbit/s carry 119 a second."""
    if os.geteuid() != 0:
        pytest.skip("network namespaces need root")
    small = sweep(
        '[axes]\nbackend = "socket"\nsize = "100KB"\n[link]\nrate_mbit_s = 100\n'
        "[search]\nmin_rate = 10\nmax_rate = 1000\ndeadline_ms = 100\nseconds = 3\n"
    )
    code, stdout, stderr = small.run("--json", command="capacity")
    assert code == 0, stderr
    (found,) = json.loads(stdout)
    assert found["answer"] == "found"
    assert float(found["max_rate_hz"]) < 119.5
    assert (small.runs.parent / "small-max-rate" / "max_rate.svg").exists()
