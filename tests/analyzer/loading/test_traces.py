import shutil
import tempfile
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from campaigns import MS, assert_same_results, write_runs
from polars.testing import assert_frame_equal
from trace_files import Message, ping_events, ping_session, relay_events, relay_session, run, write_trace

import dds_trace.analyzer.engines.batches
import dds_trace.analyzer.pairing.rows
import dds_trace.analyzer.verdicts.cases
import dds_trace.tracefile.reading.mcap_walk
import dds_trace.tracefile.reading.reader
from dds_trace.analyzer.loading import traces
from dds_trace.analyzer.loading.spool import SpooledEvents, write_events
from dds_trace.analyzer.loading.traces import TraceSpool, load
from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.errors import OutputError, TraceFormatError
from dds_trace.tracefile.format.events import EVENT_DTYPE, EventColumns


@pytest.fixture
def spool():
    with closing(TraceSpool()) as kept:
        yield kept


@pytest.fixture
def files_read(monkeypatch):
    names = []
    read = traces.read_trace_in_pieces
    monkeypatch.setattr(traces, "read_trace_in_pieces", lambda path, take: names.append(path.name) or read(path, take))
    return names


def test_a_grown_campaign_reads_only_new_files(tmp_path, files_read, spool):
    runs = tmp_path / "runs"
    write_runs(runs, range(3))
    analyze(runs, spool=spool)
    assert sorted(files_read) == ["ping0.mcap", "ping1.mcap", "ping2.mcap", *(f"relay{n}.mcap" for n in range(3))]
    assert not [*spool.folder.iterdir()]  # what fits in memory is not written
    files_read.clear()
    write_runs(runs, range(3, 4))
    grown = analyze(runs, spool=spool)
    assert sorted(files_read) == ["ping3.mcap", "relay3.mcap"]
    assert_same_results(grown, analyze(runs))


def test_a_changed_or_moved_trace_is_read_again_and_its_earlier_events_are_gone(
    tmp_path, monkeypatch, files_read, spool
):
    monkeypatch.setattr(traces, "MOST_EVENTS_IN_MEMORY", 0)
    runs = tmp_path / "runs"
    write_runs(runs, range(2))
    analyze(runs, spool=spool)
    (runs / "ping0.mcap").rename(runs / "other.mcap")
    write_runs(runs, range(1, 2), latency_ns=999)
    again = analyze(runs, spool=spool)
    assert files_read[4:] == ["other.mcap", "ping1.mcap", "relay1.mcap"]
    assert_same_results(again, analyze(runs))
    assert len(list(spool.folder.iterdir())) == 4


def test_events_wait_where_no_other_user_reads_them(spool):
    assert spool.folder.stat().st_mode & 0o777 == 0o700


def test_a_file_that_is_not_a_trace_leaves_no_events(tmp_path, spool):
    (tmp_path / "x.mcap").write_bytes(b"no trace")
    assert isinstance(load(tmp_path / "x.mcap", spool.folder), TraceFormatError)
    assert list(spool.folder.iterdir()) == []


def test_small_memory_changes_nothing(tmp_path, monkeypatch):
    """Events in temporary files, groups in parts, rows in a file: the numbers are those of the whole."""
    runs = tmp_path / "runs"
    write_runs(runs, range(6), groups=2)
    shutil.copy(runs / "ping2.mcap", runs / "copy.mcap")
    whole = analyze(runs, out=tmp_path / "whole")
    monkeypatch.setattr(dds_trace.analyzer.engines.batches, "BATCH_EVENTS", 150)
    monkeypatch.setattr(dds_trace.analyzer.engines.batches, "WHOLE_GROUP_EVENTS", 200)
    monkeypatch.setattr(dds_trace.analyzer.pairing.rows, "MOST_ROWS_IN_MEMORY", 10)
    parts = analyze(runs, out=tmp_path / "parts")
    assert parts.scan_roundtrips().select("latency_ns").collect()["latency_ns"].sum() > 0
    for found in (parts, analyze(runs)):
        (remark,) = (finding for finding in found.findings if finding.code == "group_in_parts")
        assert remark.groups == (0, 1)
        assert_same_results(replace(found, findings=found.findings[:-1]), whole)
        for name in ("intervals", "one_way", "freshness", "outages", "clock_knots", "bridge_costs"):
            assert_frame_equal(getattr(found.details, name), getattr(whole.details, name), check_exact=True)
        assert found.details.answers == whole.details.answers
        assert len(found.details.answers) == 2
        # What no part of a group can say, and its rows do not hold, is left out and not told twice.
        assert found.details.breakdown.is_empty()
        assert found.details.responses.is_empty()
        assert set(whole.details.breakdown["group"]) == {0, 1}


def test_large_batches_say_the_same(tmp_path, monkeypatch):
    runs = tmp_path / "runs"
    write_runs(runs, range(6), groups=2)
    whole = analyze(runs)
    monkeypatch.setattr(dds_trace.analyzer.engines.batches, "BATCH_EVENTS", 10)
    found = analyze(runs)
    assert_same_results(found, whole)
    for name in ("intervals", "one_way", "breakdown", "responses", "freshness", "outages", "clock_knots"):
        assert_frame_equal(getattr(found.details, name), getattr(whole.details, name), check_exact=True)


def test_kinds_of_messages_too_large_to_compare_have_no_answer_and_a_finding(tmp_path, monkeypatch):
    write_runs(tmp_path / "runs", range(3), groups=2)  # 80 messages of the first size, 40 of the second
    whole = analyze(tmp_path / "runs")
    monkeypatch.setattr(dds_trace.analyzer.verdicts.cases, "MOST_COMPARED_ROWS", 79)
    found = analyze(tmp_path / "runs")
    assert found.details.answers == whole.details.answers[1:]
    assert [f.groups for f in found.findings if f.code == "not_compared"] == [(0,)]
    assert found.summary.equals(whole.summary)


@pytest.fixture
def runs_in_turns(tmp_path):
    """A ping and a relay with two runs whose messages take turns, in chunks of some ten events, and two runs in small files."""
    runs = tmp_path / "runs"
    write_runs(runs, range(2))
    messages = [Message(n, t1=n * MS, t3=n * MS + 50, t4=n * MS + 60, t2=n * MS + 200 + n) for n in range(40)]
    described = [run(run_id=number, planned_messages=40, published=40) for number in (98, 99)]
    for name, session, events in (
        ("ping", ping_session(session_id=98), ping_events),
        ("relay", relay_session(session_id=99), relay_events),
    ):
        both = [events(messages, run_id=number, payload_bytes=64) for number in (98, 99)]
        taking_turns = {
            stage: [event for two in zip(*(each[stage] for each in both), strict=True) for event in two]
            for stage in both[0]
        }
        write_trace(runs / f"{name}_two.mcap", session, described, taking_turns, chunk_bytes=1000)
    return runs


@pytest.fixture
def _in_pieces(monkeypatch):
    monkeypatch.setattr(dds_trace.tracefile.reading.reader, "PIECE_EVENTS", 10)
    monkeypatch.setattr(dds_trace.tracefile.reading.mcap_walk, "_BLOCK_CHUNKS", 1)
    monkeypatch.setattr(traces, "MOST_EVENTS_IN_MEMORY", 0)


@pytest.mark.usefixtures("_in_pieces")
@pytest.mark.parametrize("most_events", [30, 100, 150, 1000])
def test_events_in_memory_say_the_same_as_on_the_disk(runs_in_turns, monkeypatch, most_events):
    found = analyze(runs_in_turns)
    monkeypatch.setattr(traces, "MOST_EVENTS_IN_MEMORY", most_events)
    assert_same_results(found, analyze(runs_in_turns))
    spool = TraceSpool()
    for _ in range(2):
        assert_same_results(found, analyze(runs_in_turns, spool=spool))
        assert 0 <= spool.room() <= most_events
    spool.close()


@pytest.mark.usefixtures("_in_pieces")
def test_traces_in_pieces_say_the_same(runs_in_turns, monkeypatch):
    pieces = []
    write = traces.write_events
    monkeypatch.setattr(traces, "write_events", lambda *args: pieces.append(write(*args)) or pieces[-1])
    found = analyze(runs_in_turns)
    assert len(pieces) > 2 * 2 * 2 * 3  # two files, two stages, two runs, each in more than three pieces
    monkeypatch.undo()
    whole = analyze(runs_in_turns)
    assert_same_results(found, whole)
    assert_frame_equal(found.details.intervals, whole.details.intervals, check_exact=True)


@pytest.mark.usefixtures("_in_pieces")
@pytest.mark.parametrize("room", [0, 3])
def test_a_disk_that_fills_between_two_pieces(runs_in_turns, tmp_path, monkeypatch, room):
    written = []

    def write(stream, events):
        written.append(events)
        if len(written) > room:
            raise OSError(28, "No space left on device")
        return really_write(stream, events)

    really_write = traces.write_events
    monkeypatch.setattr(traces, "write_events", write)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(OutputError, match=r"\.mcap cannot be written .*No space left on device.*TMPDIR"):
        analyze(runs_in_turns)
    assert not list(tmp_path.glob("dds-analyze-*"))


def test_columns_come_back_however_they_are_kept(tmp_path):
    records = np.zeros(5, EVENT_DTYPE)
    records["run_id"] = 2**64 - 1
    records["sequence"] = np.arange(2**63, 2**63 + 5, dtype=np.uint64)
    records["monotonic_ns"] = [5, -3, 2**62, 0, 1]
    records["relay_id"] = 2**32 - 1
    columns = EventColumns.from_records(records)
    short = columns.take(np.array([1]))
    records["relay_id"] = 7
    other = EventColumns.from_records(records)
    with (tmp_path / "x.events").open("wb") as stream:
        first, second, third = (write_events(stream, each) for each in (columns, short, other))
    assert (tmp_path / "x.events").stat().st_size == 2 * 5 * 8
    for pieces, parts in (
        ((first, third), [columns, other]),
        ((first,), [columns]),
        ((second,), [short]),
        ((first, second, first), [columns, short, columns]),
    ):
        spooled, expected = SpooledEvents(tmp_path / "x.events", pieces), EventColumns.concatenate(parts)
        events = spooled.load()
        assert spooled.count == len(expected)
        assert events.run_id.strides == (0,)  # takes no memory
        for name in EVENT_DTYPE.names:
            found = getattr(events, name)
            assert found.dtype == EVENT_DTYPE[name]
            assert found.tolist() == getattr(expected, name).tolist()
    (tmp_path / "x.events").write_bytes(b"short")
    with pytest.raises(OSError, match="shorter"):
        spooled.load()
