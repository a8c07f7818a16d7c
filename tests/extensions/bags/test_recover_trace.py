import os
import shutil
import struct
from itertools import pairwise
from pathlib import Path

import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.rosbag2 import Reader
from trace_files import ping_session, run, write_trace

from dds_trace.base.errors import OptionError, OutputExistsError, TraceFormatError
from dds_trace.extensions.bags.recover_trace import recover
from dds_trace.tracefile.format.encoding import MAGIC
from dds_trace.tracefile.format.events import HOST_TOPIC, Stage
from dds_trace.tracefile.format.ring import RING_HEADER, ring_path
from dds_trace.tracefile.mcapfile import blocks
from dds_trace.tracefile.mcapfile.file import RecordFile
from dds_trace.tracefile.mcapfile.records import ChannelTable
from dds_trace.tracefile.reading import mcap_source
from dds_trace.tracefile.reading.reader import read_trace
from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink

EVENTS = 180
PART = 30
LARGE_RING = 800
SMALL_RING = 128  # less than all events; its quarter more than a part, so that no thread drains it by itself
TEXTS = 6  # session, run, four host samples


def killed(folder, *, name="a.mcap", ring_slots=LARGE_RING):
    recording = folder / "recording" / name
    destination = TraceDestination(recording, chunk_seconds=3600.0, ring_slots=ring_slots)
    sink = TraceSink(destination, ping_session(state="open"), clock_ns=lambda: 0)
    for sequence in range(EVENTS):
        sink.record(1 + sequence % 2, 1, sequence, 1000 * sequence)
        if sequence == PART - 1:
            sink.write_run(run(state="started"))
        elif sequence % PART == PART - 1 and sequence < EVENTS - 1:
            sink.write_json(HOST_TOPIC, {"cpu": 1})
    shutil.copytree(recording.parent, folder / "left")
    sink.close()
    shutil.rmtree(recording.parent)
    return folder / "left" / name


@pytest.fixture
def trace(tmp_path):
    return killed(tmp_path)


def sequences(path):
    events = read_trace(path).events
    assert len(events[Stage.T3]) == len(events[Stage.T4]) == 0
    return sorted([*events[Stage.T1].sequence.tolist(), *events[Stage.T2].sequence.tolist()])


def boundaries(path):
    file = RecordFile(path)
    found = [len(MAGIC)]
    while found[-1] < file.size:
        found.append(file.header_at(found[-1]).end)
    file.close()
    return found


def test_trace_and_ring_become_a_closed_trace(trace, tmp_path, sentences):
    file_bytes, ring_bytes = trace.read_bytes(), ring_path(trace).read_bytes()
    report = recover(trace)
    assert (report.path, report.recovered) == (trace, trace)
    assert (report.file_events, report.ring_events, report.missing_events, report.dropped_events) == (150, 30, 0, 0)
    assert sorted(p.name for p in trace.parent.iterdir()) == ["a.mcap", "a.mcap.killed", "a.mcap.killed.ring"]
    kept, kept_ring = report.originals
    assert kept.read_bytes() == file_bytes
    assert kept_ring.read_bytes() == ring_bytes

    read = read_trace(trace)
    assert (read.truncated, read.ring_events, read.notes) == (None, 0, ())
    assert sequences(trace) == list(range(EVENTS))
    assert [r.state for r in read.runs] == ["started"]
    assert read.host_samples[0]["cpu"] == 1
    (session,) = read.sessions
    assert session.state == "open"  # it never ended cleanly, and still says so
    assert session.extra["recovered"] == {"file_events": 150, "ring_events": 30, "missing_events": 0}
    with trace.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_summary().statistics.message_count == EVENTS + TEXTS + 1
        assert len(list(reader.iter_messages())) == EVENTS + TEXTS + 1
    sentences(*(line.replace(str(tmp_path), "FOLDER") for line in report.lines()))


def test_the_killed_pair_is_still_a_trace(tmp_path):
    report = recover(killed(tmp_path))
    (tmp_path / "again").mkdir()
    again = shutil.copy(report.originals[0], tmp_path / "again" / "a.mcap")
    shutil.copy(report.originals[1], tmp_path / "again" / "a.mcap.ring")
    assert sequences(tmp_path / "again" / "a.mcap") == list(range(EVENTS))
    assert again.stat().st_size == report.originals[0].stat().st_size


def test_a_file_cut_anywhere_gives_every_event_once(tmp_path):
    whole = killed(tmp_path)
    data, ring = whole.read_bytes(), ring_path(whole).read_bytes()
    at_records = boundaries(whole)
    middles = [(begin + end) // 2 for begin, end in pairwise(at_records)]
    cuts = {0, 1, *at_records, *(at + 5 for at in at_records), *middles}
    for cut in sorted(cut for cut in cuts if cut <= len(data)):
        folder = tmp_path / str(cut)
        folder.mkdir()
        trace = folder / "a.mcap"
        trace.write_bytes(data[:cut])
        ring_path(trace).write_bytes(ring)
        report = recover(trace, folder / "whole.mcap")
        assert report.file_events + report.ring_events == EVENTS, cut
        assert report.missing_events == 0
        assert sequences(folder / "whole.mcap") == list(range(EVENTS))
        assert trace.read_bytes() == data[:cut]
        shutil.rmtree(folder)


def test_a_small_ring_cannot_make_good_what_the_disk_lost(tmp_path):
    trace = killed(tmp_path, ring_slots=SMALL_RING)
    cut = boundaries(trace)[2]  # only the session is left: a power failure
    trace.write_bytes(trace.read_bytes()[:cut])
    report = recover(trace, tmp_path / "whole.mcap")
    assert (report.file_events, report.ring_events, report.missing_events) == (0, 128, 52)
    assert sequences(tmp_path / "whole.mcap") == list(range(52, EVENTS))


def test_a_damaged_chunk_is_left_out_and_its_events_do_not_come_from_elsewhere(tmp_path):
    trace = killed(tmp_path, ring_slots=SMALL_RING)
    data = bytearray(trace.read_bytes())
    first_events = boundaries(trace)[3]  # magic, header, session chunk and its index
    data[first_events + 200] ^= 0xFF
    trace.write_bytes(data)
    report = recover(trace, tmp_path / "whole.mcap")
    assert (report.file_events, report.damaged_chunks) == (120, 1)
    assert (report.ring_events, report.missing_events) == (30, 30)
    assert sequences(tmp_path / "whole.mcap") == list(range(30, EVENTS))


def test_without_its_ring_the_file_is_closed_alone(trace):
    ring_path(trace).unlink()
    report = recover(trace)
    assert (report.file_events, report.ring_events, len(report.originals)) == (150, 0, 1)
    assert sequences(trace) == list(range(150))


def test_a_closed_trace_is_left_alone(tmp_path):
    trace = write_trace(tmp_path / "a.mcap", ping_session(), [run()])
    before = trace.read_bytes()
    report = recover(trace)
    assert report.recovered is None
    assert "nothing to recover" in report.lines()[0]
    assert trace.read_bytes() == before


def test_recovering_twice_changes_nothing(trace):
    recover(trace)
    before = trace.read_bytes()
    assert recover(trace).recovered is None
    assert trace.read_bytes() == before


def test_a_ring_left_by_a_kill_at_the_very_end_is_removed(trace):
    ring = ring_path(trace).read_bytes()
    recover(trace)
    ring_path(trace).write_bytes(ring)
    report = recover(trace)
    assert (report.recovered, report.file_events) == (None, EVENTS)
    assert not ring_path(trace).exists()


def test_a_second_kill_under_the_same_name_keeps_both_originals(trace):
    data, ring = trace.read_bytes(), ring_path(trace).read_bytes()
    recover(trace)
    trace.write_bytes(data)
    ring_path(trace).write_bytes(ring)
    report = recover(trace)
    assert report.originals[0].name == "a.mcap.killed2"
    assert (trace.parent / "a.mcap.killed").exists()


def test_a_disk_without_hard_links(trace, monkeypatch):
    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr("dds_trace.extensions.bags.recover_trace.os.link", refuse)
    data = trace.read_bytes()
    report = recover(trace)
    assert report.originals[0].read_bytes() == data
    assert sequences(trace) == list(range(EVENTS))


def test_a_bag_gets_its_metadata(tmp_path):
    killed(tmp_path, name="bag")
    folder = tmp_path / "left" / "bag"
    report = recover(folder)
    assert (report.path, report.file_events + report.ring_events) == (folder, EVENTS)
    with Reader(folder) as bag:
        assert bag.message_count == EVENTS + TEXTS + 1
        assert len(list(bag.messages())) == EVENTS + TEXTS + 1


def test_a_trace_that_is_being_recorded_is_left_alone(tmp_path):
    sink = TraceSink(TraceDestination(tmp_path / "a.mcap"), ping_session(state="open"))
    with pytest.raises(OptionError, match="still being recorded"):
        recover(tmp_path / "a.mcap")
    assert sink.close().error is None


def test_an_existing_destination_is_refused(trace):
    with pytest.raises(OutputExistsError):
        recover(trace, trace)


def test_a_dangling_link_in_the_place_of_the_destination_is_refused_and_stays(tmp_path):
    trace, link = killed(tmp_path), tmp_path / "new.mcap"
    link.symlink_to(tmp_path / "not mounted")
    with pytest.raises(OutputExistsError):
        recover(trace, link)
    assert link.is_symlink()


def test_the_ring_of_another_recording_is_not_mixed_in(trace):
    write_trace(trace, ping_session(session_id=77, state="open"), truncate_at=-50)
    with pytest.raises(TraceFormatError, match="another recording"):
        recover(trace)


@pytest.mark.parametrize("content", [b"", MAGIC, b"\x89MCAP"])
def test_nothing_but_a_beginning(tmp_path, content):
    (tmp_path / "a.mcap").write_bytes(content)
    with pytest.raises(TraceFormatError, match="no event"):
        recover(tmp_path / "a.mcap")


@pytest.mark.parametrize("content", [b"some text", None])
def test_no_trace_at_all(tmp_path, content):
    if content is not None:
        (tmp_path / "a.mcap").write_bytes(content)
    with pytest.raises(TraceFormatError):
        recover(tmp_path / "a.mcap")


def test_a_file_of_another_program_is_left_alone(tmp_path):
    path = tmp_path / "bag.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="a camera driver")
        writer.finish()
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(TraceFormatError, match="a camera driver"):
        recover(path)
    assert [p.name for p in tmp_path.iterdir()] == ["bag.mcap"]


def test_the_ring_alone_gives_what_it_holds(trace):
    trace.unlink()
    ring = ring_path(trace).read_bytes()
    report = recover(trace)
    assert (report.file_events, report.ring_events, report.missing_events) == (0, EVENTS, 0)
    assert [original.name for original in report.originals] == ["a.mcap.killed.ring"]
    assert report.originals[0].read_bytes() == ring
    assert sequences(trace) == list(range(EVENTS))


def test_a_small_ring_alone_says_what_is_missing(tmp_path):
    trace = killed(tmp_path, ring_slots=SMALL_RING)
    trace.unlink()
    report = recover(ring_path(trace), tmp_path / "whole.mcap")  # its own name will do
    assert (report.ring_events, report.missing_events) == (SMALL_RING, EVENTS - SMALL_RING)
    assert sequences(tmp_path / "whole.mcap") == list(range(EVENTS - SMALL_RING, EVENTS))
    assert ring_path(trace).exists()


def test_a_bag_whose_file_is_gone_gets_one_from_its_ring(tmp_path):
    trace = killed(tmp_path, name="bag") / "bag_0.mcap"
    trace.unlink()
    assert recover(trace.parent).ring_events == EVENTS
    assert sequences(trace.parent) == list(range(EVENTS))


DAMAGED_HEADERS = [
    (0, b"NOTARING", "not a ring file", EVENTS),
    (16, b"\0\0\0\0\0\1\0\0", "shorter than its header says", EVENTS),
    (40, b"\0\0\0\0\0\1\0\0", "shorter than its header says", EVENTS),
    (48, b"[", "names no session", EVENTS),
    (8, b"\7", "ring of version 7", EVENTS - PART),  # nobody knows where its slots are
    (24, b"\0\0\0\0\0\1\0\0", "shorter than its header says", EVENTS - PART),
    (39, b"\x80", "dropped events is damaged", EVENTS),
]


@pytest.mark.parametrize(("offset", "value", "fault", "events"), DAMAGED_HEADERS)
def test_beside_a_damaged_ring_all_that_is_whole_is_kept(trace, offset, value, fault, events):
    data = bytearray(ring_path(trace).read_bytes())
    data[offset : offset + len(value)] = value
    ring_path(trace).write_bytes(data)
    report = recover(trace)
    assert fault in (report.ring_fault or "")
    assert any(fault in line for line in report.lines())
    assert sequences(trace) == list(range(events))
    assert report.originals[1].read_bytes() == data


@pytest.mark.keeps(10)
@pytest.mark.parametrize("at", [*range(RING_HEADER.size), RING_HEADER.size + 20, RING_HEADER.size + 150])
def test_a_flipped_bit_of_the_rings_header_leaves_a_trace_that_is_read(trace, tmp_path, at):
    ring, file = ring_path(trace).read_bytes(), trace.read_bytes()
    for bit in range(8):
        data = bytearray(ring)
        data[at] ^= 1 << bit
        ring_path(trace).write_bytes(data)
        destination = tmp_path / f"{bit}.mcap"
        report = recover(trace, destination)
        assert len(sequences(destination)) == report.file_events + report.ring_events >= EVENTS - PART
        assert report.dropped_events < 1 << 40
        as_it_lies = read_trace(trace)
        assert as_it_lies.event_count >= EVENTS - PART
        assert as_it_lies.sessions[0].dropped_events < 1 << 40
    assert trace.read_bytes() == file


def test_what_was_recovered_is_read_before_it_is_called_well(trace, monkeypatch):
    before = [path.read_bytes() for path in (trace, ring_path(trace))]
    monkeypatch.setattr("dds_trace.extensions.bags.recover_trace.read_trace_in_pieces", lambda *_: None)
    with pytest.raises(TraceFormatError, match="what was recovered cannot be read"):
        recover(trace)
    assert [path.read_bytes() for path in (trace, ring_path(trace))] == before
    assert sorted(path.name for path in trace.parent.iterdir()) == [trace.name, ring_path(trace).name]


@pytest.mark.parametrize("slots", [0, 1, 100, EVENTS - 1, LARGE_RING - 1])
def test_of_a_ring_that_was_cut_off_the_whole_slots_are_used(trace, slots):
    ring = ring_path(trace)
    cut = ring.stat().st_size - LARGE_RING * 64 + slots * 64 + 40  # in the middle of a slot
    ring.write_bytes(ring.read_bytes()[:cut])
    trace.unlink()
    report = recover(trace)
    assert report.ring_fault is not None
    assert report.ring_events == min(slots, EVENTS)
    assert sequences(trace) == list(range(min(slots, EVENTS)))


def test_a_damaged_ring_alone_whose_session_is_lost_is_an_error(trace):
    trace.unlink()
    data = bytearray(ring_path(trace).read_bytes())
    data[48:49] = b"["
    ring_path(trace).write_bytes(data)
    with pytest.raises(TraceFormatError, match="has no whole ring"):
        recover(trace)
    assert ring_path(trace).read_bytes() == data


NO_RINGS = {
    "pipe": os.mkfifo,
    "folder": Path.mkdir,
    "device": lambda path: path.symlink_to("/dev/zero"),
    "holes": lambda path: (path.touch(), os.truncate(path, 1 << 40)),
    "text": lambda path: path.write_text("not a ring at all " * 10),
    "deep": lambda path: path.write_bytes(
        struct.pack("<8sIIQQQQ", b"DDSRING\n", 1, 64, 1, 8192, 0, 5000).ljust(48)
        + (b'{"session":' + b"[" * 4989).ljust(8192 + 64 - 48)
    ),
}


@pytest.mark.parametrize("kind", NO_RINGS)
@pytest.mark.parametrize("is_alone", [True, False])
def test_what_lies_in_the_place_of_a_ring_ends_in_one_line(trace, kind, is_alone):
    ring_path(trace).unlink()
    NO_RINGS[kind](ring_path(trace))
    if is_alone:
        trace.unlink()
        with pytest.raises(TraceFormatError, match="has no whole ring") as error:
            recover(trace)
        assert "\n" not in str(error.value)
    else:
        assert len(read_trace(trace).notes) == 1
        report = recover(trace)
        assert report.ring_fault is not None
        assert (report.file_events, report.ring_events) == (EVENTS - PART, 0)
    assert os.path.lexists(ring_path(trace)) or os.path.lexists(ring_path(report.originals[0]))


def test_a_damaged_ring_beside_a_closed_trace_is_left_alone(trace):
    ring = ring_path(trace).read_bytes()
    recover(trace)
    ring_path(trace).write_bytes(b"NOTARING" + ring[8:-32])
    report = recover(trace)
    assert report.recovered is None
    assert "left as it is" in report.lines()[1]
    assert ring_path(trace).exists()


def packed_chunk(records):
    packed = zstandard.compress(records)
    fields = struct.pack("<QQQII", 0, 0, len(records), 0, 4) + b"zstd" + struct.pack("<Q", len(packed))
    return struct.pack("<BQ", 6, len(fields) + len(packed)) + fields + packed


SMALL_RECORD = struct.pack("<BQ", 0x80, 0)


@pytest.mark.parametrize(
    ("hostile", "why"),
    [
        pytest.param(packed_chunk(b"") * 200, "small records", id="empty chunks"),
        pytest.param(SMALL_RECORD * 5000, "small records", id="records outside of chunks"),
        pytest.param(packed_chunk(SMALL_RECORD * 5000), "small records", id="records of a chunk"),
        pytest.param(packed_chunk(bytes(1 << 20)) * 3, "unpacks to more", id="bombs"),
    ],
)
def test_a_file_made_to_keep_the_recovery_busy_is_refused(trace, tmp_path, monkeypatch, hostile, why):
    whole = trace.read_bytes()
    trace.write_bytes(whole + hostile)
    assert recover(trace, tmp_path / "first.mcap").file_events > 0
    if why == "small records":
        monkeypatch.setattr(mcap_source, "_UNSUSPECTED_STEPS", 1000)
        monkeypatch.setattr(mcap_source, "_STEP_BYTES", 1 << 40)
    else:
        monkeypatch.setattr(blocks, "_UNSUSPECTED_FILE_BYTES", 0)
    with pytest.raises(TraceFormatError, match=why):
        recover(trace, tmp_path / "second.mcap")
    trace.write_bytes(whole)
    assert recover(trace, tmp_path / "third.mcap").file_events > 0


def test_channels_by_the_thousand_cost_no_square_of_their_number(tmp_path, monkeypatch):
    trace, looks = killed(tmp_path), []
    channels = b"".join(
        struct.pack("<BQHHI", 4, 19, number, 0, 1) + b"x" + struct.pack("<I", 2) + b"js" + bytes(4)
        for number in range(100, 5100)
    )
    trace.write_bytes(trace.read_bytes() + packed_chunk(channels))
    plain = ChannelTable.items
    monkeypatch.setattr(ChannelTable, "items", lambda table: looks.append(1) or plain(table))
    assert recover(trace, tmp_path / "recovered.mcap").file_events > 0
    assert len(looks) < 10  # of the reading of the new file, which has six channels
