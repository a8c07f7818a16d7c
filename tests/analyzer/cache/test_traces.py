"""What the second analysis of a grown campaign reads, and that nothing it keeps changes a number."""

import shutil
import tempfile
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from campaigns import MS, assert_same_results, write_runs
from polars.testing import assert_frame_equal
from trace_files import Message, ping_events, ping_session, relay_events, relay_session, run, write_trace

import dds_trace.analyzer.cache.traces
import dds_trace.analyzer.engines.batches
import dds_trace.analyzer.engines.local
import dds_trace.analyzer.engines.process
import dds_trace.analyzer.pairing.rows
import dds_trace.analyzer.verdicts.cases
import dds_trace.tracefile.mcapfile.blocks
import dds_trace.tracefile.reading.reader
from dds_trace.analyzer.cache.events import EventsFile, StoredEvents
from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.errors import OutputError
from dds_trace.tracefile.format.events import EVENT_DTYPE, EventColumns


def test_a_grown_campaign_reads_only_new_files(tmp_path, files_read):
    runs, out = tmp_path / "runs", tmp_path / "out"
    write_runs(runs, range(3))
    analyze(runs, out=out, cache=True)
    assert sorted(files_read) == ["ping0.mcap", "ping1.mcap", "ping2.mcap", *(f"relay{n}.mcap" for n in range(3))]
    files_read.clear()
    write_runs(runs, range(3, 4))
    grown = analyze(runs, out=out, cache=True)
    assert sorted(files_read) == ["ping3.mcap", "relay3.mcap"]
    assert_same_results(grown, analyze(runs))


def test_a_file_that_was_moved_is_known_and_one_that_changed_is_not(tmp_path, files_read):
    runs, out = tmp_path / "runs", tmp_path / "out"
    write_runs(runs, range(2))
    first = analyze(runs, out=out, cache=True)
    files_read.clear()
    (runs / "ping0.mcap").rename(runs / "other.mcap")
    again = analyze(runs, out=out, cache=True)
    assert files_read == []
    assert again.load_roundtrips().equals(first.load_roundtrips())
    assert "other.mcap" in {source.path for source in again.sources}
    write_runs(runs, range(1, 2), latency_ns=999)
    assert not analyze(runs, out=out, cache=True).load_roundtrips().equals(first.load_roundtrips())
    assert files_read == ["ping1.mcap"]  # the relay saw the same


def test_small_memory_changes_nothing(tmp_path, monkeypatch):
    """Events in temporary files, groups in parts, rows in a file: the numbers are those of the whole."""
    runs = tmp_path / "runs"
    write_runs(runs, range(6), groups=2)
    shutil.copy(runs / "ping2.mcap", runs / "copy.mcap")
    whole = analyze(runs, out=tmp_path / "whole")
    monkeypatch.setattr(dds_trace.analyzer.cache.traces, "MOST_EVENTS_IN_MEMORY", 100)
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


@pytest.mark.parametrize("cache", [False, True])
def test_a_large_batch_measured_side_by_side_says_the_same(tmp_path, monkeypatch, cache):
    runs = tmp_path / "runs"
    write_runs(runs, range(6), groups=2)
    whole = analyze(runs)
    threads = set()

    def measure_batch(*of_batch):
        threads.add(threading.current_thread().name.partition("_")[0])
        return measure(*of_batch)

    measure = dds_trace.analyzer.engines.process.measure_batch
    monkeypatch.setattr(dds_trace.analyzer.engines.process, "measure_batch", measure_batch)
    monkeypatch.setattr(dds_trace.analyzer.engines.batches, "BATCH_EVENTS", 10)
    found = analyze(runs, cache=cache)
    assert threads == {"measure"}
    assert_same_results(found, whole)
    for name in ("intervals", "one_way", "breakdown", "responses", "freshness", "outages", "clock_knots"):
        assert_frame_equal(getattr(found.details, name), getattr(whole.details, name), check_exact=True)


@pytest.mark.parametrize("cache", [False, True])
def test_a_large_trace_waits_in_a_file_and_a_small_one_in_memory(tmp_path, monkeypatch, cache):
    runs = tmp_path / "runs"
    write_runs(runs, range(2))
    in_files = []

    def process(batch, parts, *options):
        in_files.extend(not isinstance(part.events, EventColumns) for of_key in parts.values() for part in of_key)
        return dds_trace.analyzer.engines.process.process(batch, parts, *options)

    monkeypatch.setattr(dds_trace.analyzer.engines.local, "process", process)
    whole = analyze(runs)
    assert in_files
    assert not any(in_files)
    in_files.clear()
    monkeypatch.setattr(dds_trace.analyzer.cache.traces, "LARGEST_TRACE_IN_MEMORY", 1)
    assert_same_results(analyze(runs, cache=cache), whole)
    assert in_files
    assert all(in_files)


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
    """All events go into files, some ten at a time."""
    monkeypatch.setattr(dds_trace.analyzer.engines.local, "BYTES_FOR_FILES", 0)
    monkeypatch.setattr(dds_trace.tracefile.reading.reader, "PIECE_EVENTS", 10)
    monkeypatch.setattr(dds_trace.tracefile.mcapfile.blocks, "_BLOCK_CHUNKS", 1)


@pytest.mark.usefixtures("_in_pieces")
@pytest.mark.parametrize("cache", [False, True])
def test_traces_in_pieces_say_the_same(runs_in_turns, monkeypatch, files_read, cache):
    pieces = []
    write = EventsFile.write
    monkeypatch.setattr(EventsFile, "write", lambda *args: pieces.append(write(*args)) or pieces[-1])
    found = [analyze(runs_in_turns, cache=cache) for _ in range(2)]
    assert len(pieces) > 2 * 2 * 2 * 2 * 3  # twice: two files, two stages, two runs, each in more than three pieces
    assert files_read == [path.name for path in sorted(runs_in_turns.iterdir())] * (1 if cache else 2)
    monkeypatch.undo()
    whole = analyze(runs_in_turns)
    for each in found:
        assert_same_results(each, whole)
        assert_frame_equal(each.details.intervals, whole.details.intervals, check_exact=True)


@pytest.mark.usefixtures("_in_pieces")
@pytest.mark.parametrize("room", [0, 3])
def test_a_disk_that_fills_between_two_pieces(runs_in_turns, tmp_path, monkeypatch, room):
    """What the cache has no room for goes into a temporary file; where that has none, the analysis says so."""
    whole = analyze(runs_in_turns)
    full, written = ["traces"], []

    def write(file, events):
        folder = Path(file._stream.name).parent.name
        written.append(folder)
        if written.count(folder) > room and folder.startswith(tuple(full)):
            raise OSError(28, "No space left on device")
        return really_write(file, events)

    really_write = EventsFile.write
    monkeypatch.setattr(EventsFile, "write", write)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert_same_results(analyze(runs_in_turns, cache=True), whole)
    assert {folder.rpartition("-")[0] for folder in written} == {"", "dds-analyze"}
    full.append("dds-analyze-")
    with pytest.raises(OutputError, match=r"\.mcap cannot be written .*No space left on device.*TMPDIR"):
        analyze(runs_in_turns, cache=True)
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
        file = EventsFile(stream)
        first, second, third = file.write(columns), file.write(short), file.write(other)
    assert (tmp_path / "x.events").stat().st_size == 2 * 5 * 8
    for pieces, parts in (
        ((first, third), [columns, other]),
        ((first,), [columns]),
        ((second,), [short]),
        ((first, second, first), [columns, short, columns]),
    ):
        stored, expected = StoredEvents(tmp_path / "x.events", pieces), EventColumns.concatenate(parts)
        events = stored.load()
        assert stored.count == len(expected)
        assert events.run_id.strides == (0,)  # takes no memory
        for name in EVENT_DTYPE.names:
            found = getattr(events, name)
            assert found.dtype == EVENT_DTYPE[name]
            assert found.tolist() == getattr(expected, name).tolist()
        written = [array.tolist() for part in parts for array in ([part.monotonic_ns] if len(part) > 1 else [])]
        assert [array.tolist() for array in stored.arrays(events)] == written
    (tmp_path / "x.events").write_bytes(b"short")
    with pytest.raises(OSError, match="shorter"):
        stored.load()
