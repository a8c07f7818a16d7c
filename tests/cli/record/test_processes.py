"""Real `dds-record` processes over Fast DDS on this machine, read back with the public `mcap` and `rosbags`."""

import json
import os
import re
import signal
import subprocess
import sys
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest
from backend_pairs import ROOMY, SIZES
from event_cdr import unpack_event
from mcap.reader import make_reader
from processes import PATIENCE_S, counts_in, ping, record_pair, relay, run, running, wait_for_chunks
from record_reader import FIELDS

pytest.importorskip("rclpy", reason="no ROS 2 here")
pytestmark = pytest.mark.middleware


class Read:
    """A trace as the public reader gives it: JSON objects and events by topic."""

    def __init__(self, path):
        self.events = {stage: [] for stage in ("t1", "t2", "t3", "t4")}
        self.sessions, self.runs, self.host = [], [], []
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            assert reader.get_header().profile == "ros2"
            for _, channel, message in reader.iter_messages():
                name = channel.topic.removeprefix("/dds_trace/")
                if name in self.events:
                    self.events[name].append(dict(zip(FIELDS, unpack_event(message.data), strict=True)))
                else:
                    kept = {"session": self.sessions, "run": self.runs, "host": self.host}[name]
                    kept.append(json.loads(message.data[8:].rstrip(b"\0")))

    def by_sequence(self, stage, run_id):
        return {each["sequence"]: each for each in self.events[stage] if each["run_id"] == run_id}


def assert_whole(ping_trace, relay_trace, count):
    """Every message went there and back, and its four time stamps are in order: it is one machine, one clock."""
    run_id = int(ping_trace.runs[-1]["run_id"], 16)
    t1, t2, t3, t4 = (
        trace.by_sequence(stage, run_id)
        for trace, stage in ((ping_trace, "t1"), (ping_trace, "t2"), (relay_trace, "t3"), (relay_trace, "t4"))
    )
    assert list(t1) == list(range(count))
    assert set(t1) == set(t2) == set(t3) == set(t4)
    relay_id = relay_trace.sessions[-1]["relay_id"]
    for n in t1:
        times = [events[n]["monotonic_ns"] for events in (t1, t3, t4, t2)]
        assert times == sorted(times)
        assert t1[n]["scheduled_ns"] <= times[0]
        assert (t1[n]["relay_id"], t2[n]["relay_id"]) == (0, relay_id)
        assert t3[n]["relay_id"] == t4[n]["relay_id"] == relay_id
        for received in (t2[n], t3[n]):
            assert 1_600_000_000_000_000_000 < received["source_ns"] <= received["received_ns"]
    sizes = {each["payload_bytes"] for events in (t1, t2, t3, t4) for each in events.values()}
    assert sizes == {ping_trace.runs[-1]["payload_bytes"]}


@pytest.mark.keeps(1)
@pytest.mark.parametrize("serialization", ["raw", "typed"])
def test_all_data_types_go_there_and_back(domain_id, tmp_path, serialization):
    more = ("--serialization", serialization, *ROOMY)
    with relay(domain_id, tmp_path / "relay.mcap", *more) as command:
        for data, size in SIZES.items():
            done = ping(
                *(domain_id, tmp_path / f"{data}.mcap", *more, "--data", data, "--size", size),
                *("--messages", 20, "--warmup", 3, "--rate", 100, "--label", "room=lab", "--device", "pi4"),
            )
            assert done.status == 0, done.stderr
            wrote, counts = done.stdout.splitlines()
            assert wrote == f"Wrote {tmp_path / data}.mcap"
            assert counts_in(counts)[:5] == [20, 20, 3, 20, 0]  # sent, planned, warm-up, received, lost
        done = command.stop()
    assert done.status == 0, done.stderr
    assert counts_in(done.stdout.splitlines()[-1]) == [69, 3]  # messages, runs; no event was dropped

    relay_trace = Read(tmp_path / "relay.mcap")
    first, last = relay_trace.sessions
    assert (first["state"], last["state"], last["role"]) == ("open", "closed", "relay")
    assert (last["backend"], last["vendor"], last["rmw"]) == ("ros2", "fastdds", "rmw_fastrtps_cpp")
    assert (last["connectivity"], last["domain_id"], last["dropped_events"]) == ("loopback", domain_id, 0)
    assert last["host"]["versions"]["rclpy"]
    for data, size in SIZES.items():
        trace = Read(tmp_path / f"{data}.mcap")
        started, finished = trace.runs
        assert (started["state"], finished["state"], finished["published"]) == ("started", "finished", 23)
        assert (finished["data_type"], finished["payload_bytes"]) == (data, size)
        assert (finished["planned_messages"], finished["warmup_messages"]) == (20, 3)
        assert (finished["rate_hz"], finished["serialization"]) == (100.0, serialization)
        assert (finished["bridge"], finished["relay_domain_id"]) == ("none", domain_id)
        assert finished["labels"] == {"room": "lab"}
        assert finished["session_id"] == trace.sessions[-1]["session_id"]
        assert trace.sessions[-1]["device"] == "pi4"
        assert_whole(trace, relay_trace, 23)


def test_two_pings_and_two_relays_at_once(domain_id, tmp_path):
    with ExitStack() as stack:
        relays = [
            stack.enter_context(relay(domain_id, tmp_path / f"relay{n}.mcap", "--relay-id", n, *ROOMY)) for n in (1, 2)
        ]
        pings = [
            stack.enter_context(
                running(
                    *("dds-record", "--role", "ping", "--domain", domain_id, "--out", tmp_path / f"{data}.mcap"),
                    *("--data", data, "--messages", 40, "--warmup", 0, "--rate", 50, "--json", "--relays", 2, *ROOMY),
                )
            )
            for data in ("binary", "imu")
        ]
        results = [json.loads(command.finish().stdout) for command in pings]
        for command in relays:
            assert command.stop().status == 0
    assert [(each["sent"], each["received"]) for each in results] == [(40, 40), (40, 40)]
    relay_traces = [Read(tmp_path / f"relay{n}.mcap") for n in (1, 2)]
    for data in ("binary", "imu"):
        trace = Read(tmp_path / f"{data}.mcap")
        run_id = int(trace.runs[-1]["run_id"], 16)
        assert sorted({each["relay_id"] for each in trace.events["t2"]}) == [1, 2]
        assert len(trace.events["t2"]) == 80
        assert [len(each.by_sequence("t3", run_id)) for each in relay_traces] == [40, 40]
        assert {each["run_id"] for each in trace.events["t2"]} == {run_id}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_closes_the_trace(domain_id, tmp_path, number):
    out = tmp_path / "ping.mcap"
    with relay(domain_id, tmp_path / "relay.mcap", "--history", "keep_all") as other:
        with running(
            *("dds-record", "--role", "ping", "--domain", domain_id, "--out", out),
            *("--data", "imu", "--messages", 100_000, "--rate", 100, "--history", "keep_all"),
        ) as command:
            wait_for_chunks(out)
            done = command.stop(number)  # a second one would end the wait for replies: test_ends.py
        assert done.status == 0, done.stderr
        assert done.stdout.startswith(f"Wrote {out}\n")
        other.send_signal(number)
        done = other.stop(number)  # however often it comes
        assert done.status == 0, done.stderr
    trace, relay_trace = Read(out), Read(tmp_path / "relay.mcap")
    assert trace.sessions[-1]["state"] == relay_trace.sessions[-1]["state"] == "closed"
    assert trace.runs[-1]["state"] == "finished"
    published = trace.runs[-1]["published"]
    assert 0 < published < 100_000
    assert_whole(trace, relay_trace, published)


def test_a_duration_ends_a_ping(domain_id, tmp_path):
    with relay(domain_id, tmp_path / "relay.mcap", *ROOMY, "--json") as command:
        done = ping(domain_id, tmp_path / "ping.mcap", "--data", "imu", "--rate", 50, "--duration", 1, *ROOMY)
        assert done.status == 0, done.stderr
        relayed = json.loads(command.stop().stdout)
    trace = Read(tmp_path / "ping.mcap")
    assert trace.runs[-1]["planned_messages"] == 40
    assert trace.runs[-1]["state"] == "finished"
    assert relayed["relayed"] == trace.runs[-1]["published"] <= 50
    assert relayed["relay_id"] == Read(tmp_path / "relay.mcap").sessions[-1]["relay_id"] != 0


def test_a_duration_ends_a_relay(domain_id, tmp_path):
    with relay(domain_id, tmp_path / "relay.mcap", "--duration", 0.5, "--cpu-affinity", 0) as command:
        done = command.finish()
    assert done.status == 0, done.stderr
    assert done.stdout.startswith(f"Wrote {tmp_path / 'relay.mcap'}\n0 messages received")
    trace = Read(tmp_path / "relay.mcap")
    assert (trace.sessions[-1]["state"], trace.sessions[-1]["cpu_affinity"]) == ("closed", [0])
    assert trace.host


def test_progress_is_drawn_on_a_terminal_alone(domain_id, tmp_path):
    arguments = ("--data", "imu", "--messages", 60, "--rate", 50, *ROOMY)
    with relay(domain_id, tmp_path / "relay.mcap", *ROOMY) as command:
        done = ping(domain_id, tmp_path / "plain.mcap", *arguments)
        assert [line.partition(" of ")[0] for line in done.stderr.splitlines()] == ["waiting for an echo"]
        ours, theirs = os.openpty()
        drawn = subprocess.Popen(
            [
                *(Path(sys.executable).with_name("dds-record"), "--role", "ping", "--domain", str(domain_id)),
                *("--out", tmp_path / "drawn.mcap", *map(str, arguments)),
            ],
            stdout=subprocess.PIPE,
            stderr=theirs,
            text=True,
            env={**os.environ, "TERM": "xterm", "COLUMNS": "100"},
        )
        os.close(theirs)
        seen = b""
        with suppress(OSError):  # the other end is closed: Linux answers EIO
            while part := os.read(ours, 4096):
                seen += part
        os.close(ours)
        stdout, _ = drawn.communicate(timeout=PATIENCE_S)
        assert drawn.returncode == 0
        command.stop()
    assert b"waiting for an echo" in seen
    assert re.search(rb"sent \d+/60 \(\+10 warm-up\), received \d+, lost 0, round trip p50 [\d.]+ ms, p99", seen)
    assert stdout.startswith(f"Wrote {tmp_path / 'drawn.mcap'}\n")
    assert "\x1b" not in stdout


def test_a_folder_is_a_rosbag(domain_id, tmp_path):
    highlevel = pytest.importorskip("rosbags.highlevel")
    with relay(domain_id, tmp_path / "relay") as command:
        done = ping(domain_id, tmp_path / "ping", "--data", "string", "--messages", 5, "--warmup", 0, "--rate", 50)
        assert done.status == 0, done.stderr
        assert done.stdout.startswith(f"Wrote {tmp_path / 'ping'}\n")
        command.stop()
    with highlevel.AnyReader([tmp_path / "ping"]) as reader:
        counts = {each.topic: each.msgcount for each in reader.connections}
        assert counts.pop("/dds_trace/host") >= 1
        assert counts == {"/dds_trace/t1": 5, "/dds_trace/t2": 5, "/dds_trace/session": 2, "/dds_trace/run": 2}
        events = [
            reader.deserialize(data, connection.msgtype)
            for connection, _, data in reader.messages()
            if connection.topic == "/dds_trace/t2"
        ]
    assert [event.sequence for event in events] == [0, 1, 2, 3, 4]
    assert {event.payload_bytes for event in events} == {91}


@pytest.mark.parametrize("data", ["binary", "imu"])
def test_best_effort_on_both_sides(domain_id, tmp_path, data):
    with relay(domain_id, tmp_path / "relay.mcap", "--reliability", "best_effort", "--depth", 50) as command:
        done = ping(
            *(domain_id, tmp_path / "ping.mcap", "--reliability", "best_effort", "--depth", 5),
            *("--data", data, "--messages", 10, "--rate", 20),
        )
        assert done.status == 0, done.stderr
        command.stop()
    assert Read(tmp_path / "ping.mcap").runs[-1]["qos"]["reliability"] == "best_effort"


def test_quality_of_service_that_never_matches_ends_the_wait_and_is_named(domain_id, tmp_path):
    done = record_pair(domain_id, tmp_path, more=("--reliability", "best_effort", "--wait", PATIENCE_S * 10))
    assert done.status == 8
    assert "best_effort offered, reliable requested" in done.stderr
    assert "the same --reliability" in done.stderr
    assert not (tmp_path / "ping.mcap").exists()


def test_a_ping_without_a_relay_names_what_it_looked_for(domain_id, tmp_path):
    done = ping(domain_id, tmp_path / "ping.mcap", "--wait", 1)
    assert done.status == 8
    assert done.stdout == ""
    assert "dds-record: no echo within 1 s\n" in done.stderr
    assert f"binary_image (sensor_msgs/msg/Image) in domain {domain_id}" in done.stderr
    assert "middleware rmw_fastrtps_cpp, discovery range localhost" in done.stderr
    assert f"dds-trace record relay --backend ros2 --domain {domain_id} --discovery localhost" in done.stderr
    assert not (tmp_path / "ping.mcap").exists()


def test_a_bridge_joins_two_domains(domains, tmp_path):
    ping_domain, relay_domain = domains.take(), domains.take()
    with relay(relay_domain, tmp_path / "relay.mcap", *ROOMY) as command:
        done = ping(
            *(ping_domain, tmp_path / "ping.mcap", "--bridge", "builtin", "--relay-domain", relay_domain),
            *("--messages", 20, "--warmup", 2, "--rate", 50, *ROOMY),
        )
        assert done.status == 0, done.stderr
        command.stop()
    trace, relay_trace = Read(tmp_path / "ping.mcap"), Read(tmp_path / "relay.mcap")
    assert_whole(trace, relay_trace, 22)
    assert (trace.runs[-1]["bridge"], trace.runs[-1]["relay_domain_id"]) == ("builtin", relay_domain)
    assert (trace.sessions[-1]["domain_id"], relay_trace.sessions[-1]["domain_id"]) == (ping_domain, relay_domain)
    assert trace.sessions[-1]["bridge"]["state"] == "stopped"  # by us, after it had served
    assert {"self", "bridge"} <= set(trace.host[-1]["processes"])


@pytest.mark.parametrize(
    ("arguments", "status", "line"),
    [
        (("--size", "3KQ"), 2, "dds-record: --size '3KQ' is not understood"),
        (("--domain", 233), 2, "dds-record: --domain 233: a DDS domain id must be between 0 and 232"),
        (("--bridge", "wormhole"), 2, "wormhole"),
    ],
)
def test_wrong_value_is_one_line(tmp_path, arguments, status, line):
    done = run("dds-record", "--role", "ping", "--out", tmp_path / "x.mcap", *arguments)
    assert done.status == status, done.stderr
    assert line in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "x.mcap").exists()


def test_an_existing_file_needs_force(domain_id, tmp_path):
    out = tmp_path / "relay.mcap"
    out.write_text("precious")
    done = run("dds-record", "--role", "relay", "--domain", domain_id, "--out", out)
    assert done.status == 5
    assert "is there already" in done.stderr
    assert out.read_text() == "precious"
    with relay(domain_id, out, "--force") as command:
        assert command.stop().status == 0
    assert Read(out).sessions[-1]["state"] == "closed"


def test_a_folder_that_cannot_be_made_is_one_line(domain_id, tmp_path):
    (tmp_path / "file").write_text("")
    done = run("dds-record", "--role", "relay", "--domain", domain_id, "--out", tmp_path / "file" / "x.mcap")
    assert done.status == 6
    assert len(done.stderr.splitlines()) == 1
