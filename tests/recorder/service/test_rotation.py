from __future__ import annotations

import re

import pytest
from trace_files import RELAY_SESSION_ID, relay_session, write_trace

from dds_trace.recorder.option_values import KeepFree
from dds_trace.recorder.service.rotation import RotatedFiles, find_shortage
from dds_trace.tracefile.reading.mcap_source import read_first_session
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
