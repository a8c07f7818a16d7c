import json
import os
import shutil
import signal
import socket
import time
from contextlib import suppress

import pytest
from processes import PATIENCE_S, counts_in, ping, relay, run, running
from small_disk import needs_root, small_disk

from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.errors import OutputError
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.reading.reader import read_trace

pytestmark = pytest.mark.middleware

SOCKET = ("--backend", "socket", "--discovery", "localhost")


def status(pid):
    """What `dds-record status` tells of the recording of a process, as a list of objects and as text: others may run here."""
    told, listed = run("dds-record", "status"), run("dds-record", "status", "--json")
    assert (told.status, listed.status) == (0, 0), told.stderr
    lines = told.stdout.splitlines()
    first = next((number for number, line in enumerate(lines) if f"  pid {pid}  " in line), len(lines))
    return [each for each in json.loads(listed.stdout) if each["pid"] == pid], "\n".join(lines[first : first + 3])


ROOM = 100_000_000
"""Bytes that recordings may take of a small disk; a ring has 4 MB."""


def run_of(path):
    return read_trace(path).runs[0].run_id


@pytest.fixture
def manager(tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        listener.settimeout(PATIENCE_S)
        yield listener


def test_a_rotated_relay_is_one_recording_to_all_who_ask(domain_id, tmp_path, manager, monkeypatch):
    traces = tmp_path / "traces"
    traces.mkdir()
    (traces / "relay.00001.mcap").write_text("somebody's")
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    monkeypatch.setenv("WATCHDOG_USEC", "30000000")
    rotation = ("--rotate", "1s,100MB")
    with relay(domain_id, traces / "relay.mcap", *SOCKET, *rotation, "--device", "pi5") as command:
        ready = manager.recv(4096).decode().splitlines()
        assert ready[:2] == ["READY=1", "WATCHDOG=1"]
        assert ready[2].startswith("STATUS=0 messages, into ")
        monkeypatch.delenv("NOTIFY_SOCKET")
        done = ping(domain_id, traces / "ping.mcap", *SOCKET, "--messages", 300, "--rate", 100, "--data", "imu")
        assert done.status == 0, done.stderr
        (listed,), text = status(command.pid)
        while "  310 messages, " not in text:  # the relay tells it twice a second
            assert command.is_alive
            (listed,), text = status(command.pid)
        assert (listed["state"], listed["role"], listed["domain_id"]) == ("running", "relay", domain_id)
        assert (listed["pid"], listed["messages"], listed["files"] > 2) == (command.pid, 310, True)
        assert text.startswith(f"relay  domain {domain_id}  socket  pid {command.pid}  310 messages, ")
        assert all(len(line) <= 80 or str(traces) in line for line in text.splitlines())
        manager.setblocking(False)
        with suppress(BlockingIOError):  # room for the last word: nobody listened meanwhile
            while manager.recv(4096):
                pass
        manager.settimeout(PATIENCE_S)
        stopped = command.stop()
    assert stopped.status == 0, stopped.stderr
    assert "the recording continues in relay.00003.mcap" in stopped.stderr
    assert counts_in(stopped.stdout.splitlines()[-1]) == [310, 1]  # messages, runs; no event was dropped
    said = b""
    while b"STOPPING=1" not in said:
        said = manager.recv(4096)
    assert status(command.pid) == ([], "")
    check_traces(traces, tmp_path / "away")


def check_traces(traces, away):
    """The rotated files of a relay are whole, and one recording to the analyzer, until one of them is away."""
    assert (traces / "relay.00001.mcap").read_text() == "somebody's"
    (traces / "relay.00001.mcap").unlink()
    parts = sorted(traces.glob("relay.*.mcap"))
    assert not list(traces.glob("*.ring"))
    read = [read_trace(path) for path in parts]
    assert [trace.sessions[0].extra["part"] for trace in read] == list(range(1, len(parts) + 1))
    assert [trace.sessions[0].state for trace in read] == ["closed"] * len(parts)
    run_in = [len(trace.events[Stage.T3]) for trace in read]
    assert sum(run_in) == 310
    assert sum(count > 0 for count in run_in) > 1  # the run spans two files at least

    analysis = analyze(traces)
    assert analysis.summary["published"].to_list() == analysis.summary["received"].to_list() == [300]
    assert analysis.load_roundtrips()["relay_out_ns"].null_count() == 0
    relays = [each for each in analysis.sessions if each.role == "relay"]
    assert len(relays) == 1
    codes = {finding.code for finding in analysis.findings}
    shutil.rmtree(traces / "analysis", ignore_errors=True)
    about_files = {"missing_files", "unclosed_session", "doubtful_session", "relay_trace_gaps", "restarted_relay"}
    assert not codes & {*about_files, "duplicate_file", "overlapping_files", "ring_recovered", "truncated_file"}
    parts[0].rename(away)
    assert "missing_files" in {finding.code for finding in analyze(traces).findings}


def test_a_killed_relay_is_listed_as_killed_and_its_oldest_files_alone_went(domain_id, tmp_path):
    with relay(domain_id, tmp_path / "relay.mcap", *SOCKET, "--rotate", "1s", "--keep", "2") as command:
        command.wait_for_line("deleted relay.00002.mcap (-o keep=2)")
        command.stop(signal.SIGKILL)
    left = sorted(path.name for path in tmp_path.glob("relay.*"))
    assert "relay.00001.mcap" not in left
    assert len([name for name in left if name.endswith(".mcap")]) in (2, 3)  # killed before the next one was dropped
    said = status(command.pid)[1].splitlines()
    assert said[0].startswith(f"killed: relay  domain {domain_id}  socket  pid {command.pid}  0 messages, ")
    assert f" in the ring: dds-trace recover {tmp_path}/relay.0" in said[2]
    for number in range(2):
        trace = sorted(tmp_path.glob("relay.*.mcap"))[number]
        assert read_trace(trace).sessions[0].role == "relay"


@needs_root
def test_a_relay_stops_writing_and_not_itself_while_the_disk_is_short(domain_id, tmp_path):
    with small_disk(tmp_path / "disk", 4 * ROOM) as disk:
        short_of_disk(domain_id, disk)


def short_of_disk(domain_id, disk):
    keep_free = disk.free_bytes - ROOM
    of_disk = ("--backend", "socket", "--discovery", "localhost", "--keep-free", keep_free)
    traces = disk.outside

    def on_disk(role, name, *more):
        words = ("--role", role, "--domain", domain_id, "--out", disk.inside / name, *of_disk, *more)
        return running("dds-record", *words, prefix=disk.prefix)

    def of_ping(name, *more):
        with on_disk("ping", name, *more) as command:
            return command.finish()

    with on_disk("relay", "relay.mcap") as command:
        command.wait_for_line("serves domain")
        first = of_ping("first.mcap", "--messages", 20, "--rate", 100)
        assert first.status == 0, first.stderr
        with on_disk("ping", "long.mcap", "--messages", 10_000) as long:
            long.wait_for_line("waiting for an echo")
            while not (traces / "long.mcap").exists():
                assert long.is_alive
                time.sleep(0.01)
            with (traces / "filler").open("wb") as filler:
                os.posix_fallocate(filler.fileno(), 0, 2 * ROOM)
            ended = long.finish()
        assert (ended.status, "the run ends here" in ended.stderr) == (OutputError.exit_code, True)
        line = command.wait_for_line("until then events wait in the ring, and the relay keeps replying")
        assert f"{disk.inside}/relay.mcap: the disk has " in line
        second = ping(domain_id, traces.parent / "second.mcap", *SOCKET, "--messages", 20, "--rate", 100)
        assert (second.status, "received 20, lost 0" in second.stdout) == (0, True), second.stderr
        assert "    waiting for disk space: " in status(command.pid)[1]
        short = of_ping("short.mcap", "--messages", 20)
        assert (short.status, (traces / "short.mcap").exists()) == (OutputError.exit_code, False)
        (traces / "filler").unlink()
        command.wait_for_line("there is disk space again: writing continues")
        third = of_ping("third.mcap", "--messages", 5, "--warmup", 0, "--rate", 100)
        assert third.status == 0, third.stderr
        stopped = command.stop()
    assert stopped.status == 0, stopped.stderr  # all of it found room
    assert "must stay free (-o keep_free)" in stopped.stderr
    assert " messages received in 4 runs\n" in stopped.stdout
    trace, cut = read_trace(traces / "relay.mcap"), read_trace(traces / "long.mcap")
    runs = [run_of(path) for path in (traces / "first.mcap", traces.parent / "second.mcap", traces / "third.mcap")]
    of_runs = [trace.events[Stage.T3].run_id.tolist().count(each) for each in runs]
    assert (trace.truncated, trace.sessions[0].state, of_runs) == (None, "closed", [30, 30, 5])
    assert trace.sessions[0].dropped_events == 0
    assert (cut.runs[0].state, cut.sessions[0].state) == ("finished", "closed")
    assert "must stay free" in cut.sessions[0].extra["error"]
    assert "recording_stopped" not in {
        finding.code for finding in analyze(traces, out=traces.parent / "analysis").findings
    }
