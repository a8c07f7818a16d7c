import errno
import os
import threading
import time
from dataclasses import replace

import pytest
from event_cdr import unpack_event
from mcap.reader import make_reader
from trace_files import RELAY_SESSION_ID, relay_session

from dds_trace.base.errors import OutputError, OutputExistsError
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.format.ring import ring_path
from dds_trace.tracefile.reading.mcap_source import read_first_session
from dds_trace.tracefile.reading.reader import read_trace
from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink
from dds_trace.tracefile.writing.writer import TraceFiles

FILES = 6


def destination(folder, number):
    return TraceDestination(folder / f"{number}.mcap", ring_slots=1 << 10, chunk_seconds=0.01)


def open_sink(folder):
    return TraceSink(destination(folder, 1), relay_session(state="open", extra={"part": 1}))


def sequences(path):
    """Of T3, by the public reader, every CRC and the summary's count checked."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = [unpack_event(m.data)[1] for _, _, m in reader.iter_messages(topics=["/dds_trace/t3"])]
        counts = reader.get_summary().statistics.channel_message_counts
        channels = {channel.topic: channel.id for channel in reader.get_summary().channels.values()}
    assert counts.get(channels.get("/dds_trace/t3"), 0) == len(found)
    return found


def test_every_event_is_in_one_file_while_others_stamp(tmp_path):
    sink = open_sink(tmp_path)
    stop, stamped = threading.Event(), 0

    def keep_stamping():
        nonlocal stamped
        while not stop.wait(0.0002):
            sink.record_and_stamp((3, 4), 7, stamped, 1000, 0, 0, 9, 2)
            stamped += 1

    thread = threading.Thread(target=keep_stamping)
    thread.start()
    closed = []
    for number in range(2, FILES + 1):
        before = stamped
        while stamped < before + 20:
            pass
        closed.append(sink.go_on_in(destination(tmp_path, number), asked={"tuned": False}))
    stop.set()
    thread.join()
    closed.append(sink.close(clock={"end": 1}))

    paths = [tmp_path / f"{number}.mcap" for number in range(1, FILES + 1)]
    assert sorted(tmp_path.iterdir()) == paths  # no ring is left
    assert [each.path for each in closed] == paths
    assert sum(each.events for each in closed) == 2 * stamped
    assert [each.error for each in closed] == [None] * FILES
    assert [n for path in paths for n in sequences(path)] == list(range(stamped))
    assert all(each.events > 0 for each in closed[:-1])
    for number, path in enumerate(paths, start=1):
        (session,) = read_trace(path).sessions
        assert (session.session_id, session.state, session.extra["part"]) == (RELAY_SESSION_ID, "closed", number)
        assert session.extra.get("followed", False) is (number < FILES)
        assert ("clock" in session.extra) is (number == FILES)
        assert session.extra["asked"] == {"tuned": False}
        first = read_first_session(path)
        assert (first.session_id, first.state, first.extra["part"]) == (RELAY_SESSION_ID, "open", number)


def test_dropped_events_are_counted_on(tmp_path):
    sink = open_sink(tmp_path)
    sink.record(3, 7, 1 << 64, 0)  # out of range
    assert sink.go_on_in(destination(tmp_path, 2)).dropped_events == 1
    assert read_trace(tmp_path / "2.mcap").sessions[0].dropped_events == 1  # from the ring's header
    sink.record(3, 7, 1 << 64, 0)
    assert read_trace(tmp_path / "2.mcap").sessions[0].dropped_events == 2
    assert sink.close().dropped_events == 2
    assert [read_trace(tmp_path / f"{n}.mcap").sessions[0].dropped_events for n in (1, 2)] == [1, 2]


def test_a_file_that_is_there_or_cannot_be_made_leaves_the_recording_where_it_is(tmp_path, monkeypatch):
    sink = open_sink(tmp_path)
    sink.record(3, 7, 0, 1000)
    (tmp_path / "2.mcap").write_text("somebody's")
    with pytest.raises(OutputExistsError, match=r"2\.mcap is there already"):
        sink.go_on_in(destination(tmp_path, 2))

    def full(*_arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as broken:
        broken.setattr("dds_trace.tracefile.format.ring._fill", full)
        with pytest.raises(OutputError, match="the disk is full"):
            sink.go_on_in(destination(tmp_path, 3))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["1.mcap", "1.mcap.ring", "2.mcap"]
    sink.record(3, 7, 1, 1001)
    assert (sink.close().events, sequences(tmp_path / "1.mcap")) == (2, [0, 1])
    assert (tmp_path / "2.mcap").read_text() == "somebody's"
    assert sink.go_on_in(destination(tmp_path, 4)) is None  # closed


def test_events_that_wait_for_the_disk_keep_the_recording_where_it_is(tmp_path, monkeypatch):
    def fail(_files, _head):
        raise OutputError("the disk failed")

    sink = open_sink(tmp_path)
    with monkeypatch.context() as broken:
        broken.setattr(TraceFiles, "move_chunk", fail)
        sink.record(3, 7, 0, 1000)
        assert sink.go_on_in(destination(tmp_path, 2)) is None
    assert str(sink.error) == "the disk failed"
    assert not (tmp_path / "2.mcap").exists()
    assert (sink.close().events, sequences(tmp_path / "1.mcap")) == (1, [0])


def test_what_cannot_be_written_stays_in_the_old_ring_and_the_recording_goes_on(tmp_path, monkeypatch):
    """The disk fails between the step and the end of the old file."""
    sink = open_sink(tmp_path)
    use = sink._use

    def fail(_files, _head):
        raise OutputError("the disk failed")

    def use_and_fail(files):
        monkeypatch.setattr(type(files), "move_chunk", fail)
        use(files)

    flush = sink._flush
    monkeypatch.setattr(sink, "_flush", lambda: flush() and sink.record(3, 7, 5, 1000) is None)
    monkeypatch.setattr(sink, "_use", use_and_fail)
    closed = sink.go_on_in(destination(tmp_path, 2))
    monkeypatch.undo()
    assert (closed.events, closed.ring_events, str(closed.error)) == (0, 1, "the disk failed")
    assert ring_path(tmp_path / "1.mcap").exists()
    sink.record(3, 7, 6, 1001)
    sink.close()
    found = [read_trace(tmp_path / f"{n}.mcap") for n in (1, 2)]
    assert [trace.events[Stage.T3].sequence.tolist() for trace in found] == [[5], [6]]
    assert [trace.sessions[0].state for trace in found] == ["open", "closed"]


def test_in_a_pause_events_wait_in_the_ring_and_only_those_beyond_it_are_dropped(tmp_path):
    place = replace(destination(tmp_path, 1), ring_slots=8, chunk_seconds=0.01)
    sink = TraceSink(place, relay_session(state="open"))
    sink.record(3, 7, 0, 1000)
    sink.pause()
    size = (tmp_path / "1.mcap").stat().st_size
    for sequence in range(1, 13):
        sink.record(3, 7, sequence, 1000)
    sink.write_json("/dds_trace/host", {"cpu_percent": 1})
    time.sleep(0.1)  # ten times as long as a chunk waits
    assert (tmp_path / "1.mcap").stat().st_size == size
    assert sink.go_on_in(destination(tmp_path, 2)) is None
    left = read_trace(tmp_path / "1.mcap")  # of a recorder that is killed now
    dropped = sink.dropped_events
    assert dropped >= 4
    assert (left.sessions[0].dropped_events, left.event_count) == (dropped, 13 - dropped)
    sink.resume()
    sink.record(3, 7, 13, 1000)
    sink.pause()
    sink.record(3, 7, 14, 1000)
    closed = sink.close()
    assert (closed.events, closed.dropped_events, closed.ring_events) == (15 - dropped, dropped, 0)
    found = read_trace(tmp_path / "1.mcap")
    assert (sequences(tmp_path / "1.mcap")[-2:], len(found.host_samples)) == ([13, 14], 0)
    sink.resume()
    sink.record(3, 7, 15, 1000)
    assert sink.dropped_events == dropped + 1  # closed is closed
