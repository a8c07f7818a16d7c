import gc
import shutil

import polars as pl
import pytest
from polars.testing import assert_frame_equal
from roundtrip_frames import MS, steady
from trace_files import Message, run, write_pair

import dds_trace.analyzer.pairing.rows
from dds_trace.analyzer.pairing.rows import RowStore, RowWriter
from dds_trace.analyzer.pipeline import analyze


@pytest.fixture
def analysis(tmp_path):
    for number, messages in enumerate((3, 2), 1):
        folder = tmp_path / "traces" / str(number)
        folder.mkdir(parents=True)
        timeline = [Message(s, t0=s * MS, t1=s * MS, t3=s * MS, t4=s * MS, t2=s * MS + number) for s in range(messages)]
        write_pair(folder, timeline, runs=[run(run_id=number, payload_bytes=100 * number)])
    return analyze(tmp_path / "traces", details=False)


def test_rows_are_found_by_group(analysis):
    rows = analysis.rows
    assert rows.groups.select("group", "payload_bytes", "first", "published").rows() == [(0, 100, 0, 3), (1, 200, 3, 2)]
    assert rows.frame(rows.groups[1], ["payload_bytes", "rtt_ns"]).rows() == [(200, 2), (200, 2)]
    assert rows.frame(rows.groups, ["sequence"])["sequence"].to_list() == [0, 1, 2, 0, 1]
    assert rows.frame(rows.groups.head(0)).columns == rows.load().columns


def test_a_file_gives_what_memory_gives(analysis, tmp_path):
    path = tmp_path / "roundtrips.parquet"
    analysis.rows.load().write_parquet(path)
    stored = RowStore.of(path, analysis.summary)
    assert stored.has_rows
    assert_frame_equal(stored.load(), analysis.rows.load())
    assert_frame_equal(stored.frame(stored.groups[1]), analysis.rows.load()[3:])


def test_many_rows_leave_memory_for_a_temporary_file_that_goes_away(analysis, tmp_path, monkeypatch):
    monkeypatch.setattr(dds_trace.analyzer.pairing.rows, "MOST_ROWS_IN_MEMORY", 4)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    again = analyze(tmp_path / "traces", details=False)
    (folder,) = tmp_path.glob("dds-analyze-*")
    assert [file.name for file in folder.iterdir()] == ["roundtrips.parquet"]
    assert_frame_equal(again.rows.load(), analysis.rows.load())
    del again
    gc.collect()
    assert not folder.exists()


def test_rows_up_to_the_bound_stay_in_memory(analysis, tmp_path, monkeypatch):
    monkeypatch.setattr(dds_trace.analyzer.pairing.rows, "MOST_ROWS_IN_MEMORY", 5)
    monkeypatch.setattr(dds_trace.analyzer.pairing.rows, "TemporaryFolder", None)  # there is no other place
    again = analyze(tmp_path / "traces", details=False)
    assert_frame_equal(again.rows.load(), analysis.rows.load())


@pytest.mark.usefixtures("analysis")
def test_a_temporary_file_may_be_gone_already(tmp_path, monkeypatch):
    monkeypatch.setattr(dds_trace.analyzer.pairing.rows, "MOST_ROWS_IN_MEMORY", 4)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    again = analyze(tmp_path / "traces", details=False)
    (folder,) = tmp_path.glob("dds-analyze-*")
    shutil.rmtree(folder)
    told = []
    monkeypatch.setattr("sys.unraisablehook", told.append)
    del again
    gc.collect()
    assert told == []


def test_a_writer_of_no_rows_gives_their_columns():
    with RowWriter() as writer:
        writer.write([])
    rows = writer.store()
    assert not rows.has_rows
    assert rows.load().columns == RowStore.of(steady([MS])).load().columns
    assert isinstance(rows.scan(), pl.LazyFrame)


def test_a_file_that_was_written_again_is_read_again(analysis, tmp_path):
    path = tmp_path / "rows.parquet"
    for rows in (analysis.rows.load()[:2], analysis.rows.load()):
        rows.write_parquet(path)
        assert RowStore.of(path).scan().collect().height == len(rows)
