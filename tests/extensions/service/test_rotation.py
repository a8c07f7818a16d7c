import os
import re
import socket
import time
from pathlib import Path

import pytest
from trace_files import RELAY_SESSION_ID, relay_session, write_trace

from dds_trace.base.errors import OutputError
from dds_trace.extensions.service import upkeep
from dds_trace.extensions.service.rotation import RotatedFiles, find_shortage
from dds_trace.extensions.service.upkeep import STATUS_PERIOD_S, ServiceManager
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.option import KeepFree
from dds_trace.recorder.options import RecordOptions
from dds_trace.tracefile.reading.mcap_source import read_first_session
from dds_trace.tracefile.reading.reader import read_trace
from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink


def record(path, **changes):
    TraceSink(TraceDestination(path, ring_slots=16), relay_session(state="open", **changes)).close()
    return path


@pytest.fixture
def files(tmp_path):
    return RotatedFiles(TraceDestination(tmp_path / "relay.mcap"), RELAY_SESSION_ID)


def test_numbers_go_on_behind_the_highest_that_is_taken(files, tmp_path):
    assert files.next().path == tmp_path / "relay.00001.mcap"
    for name in ("relay.00001.mcap", "relay.mcap", "relay.9.mcap", "arelay.00050.mcap", "relay.00060.mcap.bak"):
        (tmp_path / name).touch()
    assert files.next().path.name == "relay.00002.mcap"
    (tmp_path / "relay.00007.mcap.ring").touch()  # of a killed recorder that had not even begun its trace
    assert files.next().path.name == "relay.00008.mcap"
    (tmp_path / "relay.99999.mcap").symlink_to("nowhere")
    assert files.next().path.name == "relay.100000.mcap"


def test_only_the_oldest_of_this_recording_go(files, tmp_path):
    ours = [record(tmp_path / f"relay.{number:05d}.mcap") for number in (2, 3, 5, 8)]
    spared = [
        record(tmp_path / "relay.00001.mcap", session_id=7),  # another recording of the same name
        record(tmp_path / "relay.1.mcap"),  # not as we name them
        record(tmp_path / "other.00001.mcap"),
    ]
    (tmp_path / "relay.00004.mcap").write_bytes(b"\x89MCAP0\r\n no trace")
    (tmp_path / "relay.00006.mcap").write_text("")
    (tmp_path / "relay.00000.mcap").symlink_to(ours[0])
    (tmp_path / "relay.00009.mcap").mkdir()
    (tmp_path / "relay.00002.mcap.ring").touch()  # of the oldest: its events are not all in it
    before = set(tmp_path.iterdir())

    assert files.drop_oldest(keep=4) == []
    assert files.drop_oldest(keep=2) == [ours[1]]  # the second oldest: the oldest has a ring
    assert before - set(tmp_path.iterdir()) == {ours[1]}
    (tmp_path / "relay.00002.mcap.ring").unlink()
    assert files.drop_oldest(keep=1) == [ours[0], ours[2]]
    assert set(tmp_path.iterdir()) >= {*spared, ours[3]}


def test_a_session_is_read_from_the_first_chunk_of_our_files_and_of_no_others(tmp_path):
    assert read_first_session(record(tmp_path / "a.mcap", device="gamma")).device == "gamma"
    write_trace(tmp_path / "b.mcap", relay_session(), chunked=False)  # another writer's
    assert read_first_session(tmp_path / "b.mcap") is None
    text = (tmp_path / "a.mcap").read_bytes()
    for end in range(0, 400, 7):
        (tmp_path / "cut.mcap").write_bytes(text[:end])
        assert read_first_session(tmp_path / "cut.mcap") is None
    assert read_first_session(tmp_path / "nowhere.mcap") is None


@pytest.mark.parametrize(
    ("keep_free", "disk_bytes", "floor_bytes"),
    [
        (KeepFree(), 10**12, 10**9),
        (KeepFree(), 4 * 10**9, 2 * 10**8),
        (KeepFree(0.5, None), 10**12, 5 * 10**11),
        (KeepFree(1.0, 0), 10**12, 0),
    ],
)
def test_what_is_kept_free_is_a_share_or_a_size_whichever_is_less(keep_free, disk_bytes, floor_bytes):
    assert keep_free.floor_bytes(disk_bytes) == floor_bytes


def test_a_shortage_says_what_is_free_and_what_to_do(tmp_path, sentences):
    trace = tmp_path / "not" / "yet" / "relay.mcap"
    assert find_shortage(trace, KeepFree(1.0, 0)) is None
    said = str(find_shortage(trace, KeepFree(1.0, None)))
    assert said.startswith(f"{trace}: the disk has ")
    sentences(re.sub(r"[\d.]+ [kMGT]?B", "SIZE", said.partition(": ")[2]))


@pytest.mark.parametrize("looks_meanwhile", [True, False])
@pytest.mark.parametrize(("events", "is_lost"), [(6, False), (20, True)])
def test_a_short_disk_is_an_error_once_an_event_found_no_room_in_the_ring(
    tmp_path, monkeypatch, events, is_lost, looks_meanwhile
):
    short, said = [None], []
    monkeypatch.setattr(upkeep, "find_shortage", lambda *_, **__: short[0])
    options = RecordOptions(TraceDestination(tmp_path / "relay.mcap", ring_slots=8), NodeOptions())
    with upkeep.Upkeep(options, relay_session(state="open"), time.monotonic_ns, said.append) as kept:
        kept.look(0, dict)
        short[0] = OutputError("the disk is short")
        kept.look(0, dict)
        for sequence in range(events):
            kept.sink.stamp(3, 7, sequence)
        if looks_meanwhile:
            kept.look(0, dict)
            assert kept.shortage is (short[0] if is_lost else None)
        short[0] = None
        kept.look(0, dict)
        closed = kept.close_trace()
    assert [line.partition(":")[0].partition(";")[0] for line in said] == [
        "the disk is short",
        "there is disk space again",
    ]
    (session,) = read_trace(Path(closed.path)).sessions
    assert (closed.events, closed.dropped_events) == (min(events, 8), max(0, events - 8))
    assert session.extra.get("stopped") == ("the disk is short" if is_lost else None)


@pytest.fixture(params=["path", "abstract"])
def listening(tmp_path, request):
    address = str(tmp_path / "notify") if request.param == "path" else f"@dds-trace-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(address.replace("@", "\0"))
        listener.setblocking(False)
        yield listener, address


def test_ready_once_then_status_now_and_then_and_the_watchdog_at_each_look(listening):
    listener, address = listening
    now_s = 100.0
    environment = {"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "2000000", "WATCHDOG_PID": str(os.getpid()), "A": "b"}
    manager = ServiceManager(environment, lambda: now_s)
    assert environment == {"A": "b"}  # nobody speaks for us
    manager.notify("1 message")
    manager.notify("2 messages")
    now_s += STATUS_PERIOD_S
    manager.notify("3 messages")
    manager.close()
    manager.notify("closed")
    said = [listener.recv(4096).decode() for _ in range(4)]
    assert said == [
        "READY=1\nWATCHDOG=1\nSTATUS=1 message",
        "WATCHDOG=1",
        "WATCHDOG=1\nSTATUS=3 messages",
        "STOPPING=1",
    ]
    with pytest.raises(BlockingIOError):
        listener.recv(4096)


def test_a_watchdog_of_another_process_is_none_of_ours(listening):
    listener, address = listening
    manager = ServiceManager({"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "1", "WATCHDOG_PID": "1"})
    manager.notify("x")
    manager.close()
    assert listener.recv(4096) == b"READY=1\nSTATUS=x"


def test_nobody_who_listens_holds_nobody_up(tmp_path):
    for environment in ({}, {"NOTIFY_SOCKET": str(tmp_path / "gone")}, {"NOTIFY_SOCKET": "@nobody-here"}):
        manager = ServiceManager(environment)
        manager.notify("x")
        manager.close()
