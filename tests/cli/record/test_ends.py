import json
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import psutil
import pytest
from middlewares import needs
from processes import PATIENCE_S, ping, relay, running, wait_for_chunks
from record_reader import events_of, last_json

from dds_trace.tracefile.format.ring import ring_path

pytestmark = pytest.mark.middleware

LONG = ("--data", "imu", "--messages", 100_000, "--warmup", 0, "--rate", 50)
SOCKET = ("--backend", "socket", "--discovery", "localhost")


@needs("ros2")
def test_a_bridge_that_is_killed_ends_the_run_with_the_reason(domains, tmp_path):
    near, far, out = domains.take(), domains.take(), tmp_path / "ping.mcap"
    arguments = (*LONG, "--bridge", "builtin", "--relay-domain", far, "--depth", 1000, "--json")
    with (
        relay(far, tmp_path / "relay.mcap", "--depth", 1000),
        running("dds-record", "--role", "ping", "--domain", near, "--out", out, *arguments) as command,
    ):
        wait_for_chunks(out)
        guard = next(
            child for child in psutil.Process(command.pid).children() if "guard.py" in " ".join(child.cmdline())
        )
        (program,) = guard.children()
        program.kill()
        done = command.finish()
    reason = "the bridge builtin was killed by signal 9 (SIGKILL)"
    assert done.status == 9
    assert reason in done.stderr
    told, session, run = json.loads(done.stdout), last_json(out, "session"), last_json(out, "run")
    assert told["error"].startswith(reason)
    assert session["error"] == told["error"]
    assert (session["state"], session["bridge"]["state"]) == ("closed", "died")
    (described,) = session["bridge"]["programs"]
    assert described["log_tail"].startswith("bridging domains")
    assert run["state"] == "finished"
    assert 0 < run["published"] < 100_000


def test_a_relay_whose_reader_is_gone_serves_on_and_closes_its_trace(domain_id, tmp_path):
    out = tmp_path / "relay.mcap"
    relays = [Path(sys.executable).with_name("dds-record"), *("--role", "relay", "--domain", str(domain_id))]
    with subprocess.Popen(
        [*relays, "--out", out, *SOCKET], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as command:
        try:
            assert "serves domain" in command.stdout.readline()
            command.stdout.close()
            few = ("--data", "imu", "--messages", 20, "--warmup", 0, "--rate", 100)
            done = ping(domain_id, tmp_path / "ping.mcap", *SOCKET, *few)
            command.terminate()
            command.wait(PATIENCE_S)
        finally:
            command.kill()
    assert done.status == 0, done.stderr
    assert last_json(out, "session")["state"] == "closed"
    assert [event["sequence"] for event in events_of(out, "t4")] == list(range(20))


def test_losses_within_the_limit_are_no_error(domain_id, tmp_path):
    with relay(domain_id, tmp_path / "relay.mcap", *SOCKET):
        done = ping(
            *(domain_id, tmp_path / "ping.mcap", *SOCKET, "--data", "imu", "--messages", 5, "--warmup", 0),
            *("--fail-if-lost", "0%"),
        )
    assert done.status == 0, done.stderr
    assert last_json(tmp_path / "ping.mcap", "session")["error"] is None


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stop_before_the_first_echo_leaves_no_file(domain_id, tmp_path, number):
    out = tmp_path / "traces" / "ping.mcap"
    with running("dds-record", "--role", "ping", "--domain", domain_id, "--out", out, *SOCKET, *LONG) as command:
        command.wait_for_line("waiting for an echo")
        done = command.stop(number)
    assert (done.status, done.stdout, "nothing was written" in done.stderr) == (130, "", True)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("times", [1, 2, 3, 6])
def test_ctrl_c_and_sigterm_close_the_trace_however_often_they_come(domain_id, tmp_path, times):
    """The promise of docs/troubleshooting.md, while replies are awaited and while the trace is being closed."""
    out = tmp_path / "ping.mcap"
    with (
        relay(domain_id, tmp_path / "relay.mcap", *SOCKET) as other,
        running("dds-record", "--role", "ping", "--domain", domain_id, "--out", out, *SOCKET, *LONG) as command,
    ):
        wait_for_chunks(out)
        other.send_signal(signal.SIGSTOP)
        for number in range(times):
            with suppress(ProcessLookupError):
                command.send_signal((signal.SIGINT, signal.SIGTERM)[number % 2])
        command.finish()
        other.send_signal(signal.SIGCONT)
    assert last_json(out, "session")["state"] == "closed"
    assert not ring_path(out).exists()
