import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from processes import PATIENCE_S
from record_reader import last_json

from dds_trace.analyzer.pipeline import analyze
from dds_trace.recorder.backends import BACKEND_MODULES, open_node
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Discovery
from dds_trace.recorder.options import PingOptions, RecordOptions
from dds_trace.recorder.payloads import IMU
from dds_trace.recorder.payloads.stamp import PROBE_RUN_ID
from dds_trace.recorder.recording import record
from dds_trace.recorder.roles.relay import Relay
from dds_trace.tracefile.reading.reader import read_trace
from dds_trace.tracefile.writing.destination import TraceDestination

MESSAGES = 8


class Silent:
    def note(self, text):
        pass

    def progress(self, progress):
        pass


class PanicError(BaseException):
    """As Rust's under zenoh: not an `Exception`."""


@pytest.mark.parametrize("error", [OSError("ours"), PanicError("ours")], ids=["error", "panic"])
@pytest.mark.parametrize("thread", ["main", "node's"])
def test_a_relay_that_crashed_writes_its_error(monkeypatch, tmp_path, error, thread):
    monkeypatch.setitem(BACKEND_MODULES, "toy", "toy_backend")
    node = NodeOptions(domain_id=3, discovery=Discovery.LOCALHOST)
    relayed = Relay.progress

    def fail(relay, *_):
        if thread == "node's" or relayed(relay).relayed >= MESSAGES:
            raise error
        return relayed(relay)

    monkeypatch.setattr(Relay, *(("progress", fail) if thread == "main" else ("_note", fail)))
    ping = PingOptions("imu", rate_hz=200.0, messages=MESSAGES, warmup=0, wait_s=60.0)
    options = {"node": node, "backend": "toy", "own_cost": False}
    with ThreadPoolExecutor(1) as pool:
        relaying = pool.submit(
            record, RecordOptions(TraceDestination(tmp_path / "relay.mcap"), **options), threading.Event(), Silent()
        )
        pinged = RecordOptions(TraceDestination(tmp_path / "ping.mcap"), ping=ping, **options)
        record(pinged, threading.Event(), Silent())
        assert isinstance(relaying.exception(PATIENCE_S), type(error))
    (session,) = read_trace(tmp_path / "relay.mcap").sessions[-1:]
    assert (session.state, session.extra["error"]) == ("closed", "ours")
    findings = {finding.code: finding.what for finding in analyze(tmp_path).findings}
    assert "ours" in findings["ended_by_error"]


PING = """
import signal
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # the tests may run under `nohup`
from dds_trace.recorder.roles import ping
ping.DRAIN_NS = ping.LONGEST_DRAIN_NS = 10**12
from dds_trace.cli.dds_record import main
main()
"""


@pytest.mark.middleware
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_second_signal_ends_the_wait_for_late_replies(domain_id, tmp_path, number):
    out = tmp_path / "ping.mcap"
    arguments = f"--role ping --backend socket --discovery localhost --domain {domain_id} --no-own-cost --out {out}"
    run = "--data imu --rate 100 --messages 100000 --warmup 0"
    with open_node("socket", NodeOptions(domain_id, discovery=Discovery.LOCALHOST, listens=True)) as node:
        replies = node.create_publisher(IMU.relay_topic, IMU.type_name)
        answered = threading.Event()

        def answer_every_second(message, *_):
            run_id, sequence, _ = IMU.raw.stamp.read(message)
            if run_id == PROBE_RUN_ID or sequence % 2:
                replies.publish(IMU.raw.stamp.reply(message, b"%08x" % 7))
            if run_id != PROBE_RUN_ID and sequence > 20:
                answered.set()

        node.create_subscription(IMU.topic, IMU.type_name, answer_every_second)
        node.start()
        with subprocess.Popen([sys.executable, "-c", PING, *arguments.split(), *run.split()]) as ping:
            try:
                while not answered.wait(0.1):
                    assert ping.poll() is None
                ping.send_signal(number)
                time.sleep(2)
                assert ping.poll() is None  # it waits for what was not answered
                ping.send_signal(number)
                ping.wait(PATIENCE_S)
            finally:
                ping.kill()
    assert ping.returncode >= 0  # it ended by itself, within the patience of a test
    assert last_json(out, "session")["state"] == "closed"
    assert last_json(out, "run")["state"] == "finished"
