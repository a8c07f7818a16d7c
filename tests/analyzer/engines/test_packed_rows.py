"""Rows outside of memory: whole, a column at a time, in a file or on their way, they are what was paired."""

import pickle

import pytest
from campaigns import write_runs
from polars.testing import assert_frame_equal

from dds_trace.analyzer.engines import process
from dds_trace.analyzer.engines.packed_rows import packed
from dds_trace.analyzer.pairing import roundtrips
from dds_trace.analyzer.pairing.parquet import tables_of
from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.errors import OutputError
from dds_trace.tracefile.format.events import Stage


@pytest.fixture
def paired(tmp_path, monkeypatch):
    """The rows of three runs, in frames of 50 rows; only replies have stamps of the middleware."""
    rows = []

    def pair_exchanges(*arguments, **options):
        rows.append(pair(*arguments, **options))
        return rows[-1]

    pair = process.pair_exchanges
    monkeypatch.setattr(process, "pair_exchanges", pair_exchanges)
    monkeypatch.setattr(roundtrips, "ROWS_PER_FRAME", 50)
    write_runs(tmp_path / "runs", range(3), received=[Stage.T2])
    analyze(tmp_path / "runs")
    return rows[0]


@pytest.mark.parametrize("in_file", [False, True])
def test_packed_rows_are_what_was_packed(paired, tmp_path, in_file):
    rows = pickle.loads(pickle.dumps(packed(paired, tmp_path if in_file else None)))
    loaded = rows.load()
    assert_frame_equal(loaded.measured, paired.measured, check_exact=True, check_column_order=False)
    assert loaded.outcome.tolist() == paired.outcome.tolist()
    assert loaded.outcome.dtype == paired.outcome.dtype
    for other in (rows, loaded):
        assert other.bounds.tolist() == paired.bounds.tolist()
        assert other.counts.equals(paired.counts)
        assert other.clock_knots.equals(paired.clock_knots)
        assert other.stamp_names == paired.stamp_names == {"reply_source_ns", "reply_received_ns"}
    assert [stamps.to_list() for stamps in loaded.stamps] == [stamps.to_list() for stamps in paired.stamps]
    for name in ("sequence", "latency_ns", "reordered", "reply_received_ns"):
        assert rows.column(name).equals(paired.column(name)), name
    tables = list(tables_of(rows))
    assert len(tables) == 3
    assert tables == list(tables_of(paired))
    rows.remove()
    assert not list(tmp_path.glob("*.rows"))


def test_a_file_that_is_gone_is_one_line(paired, tmp_path):
    rows = packed(paired, tmp_path)
    rows.remove()
    with pytest.raises(OutputError, match=r"\.rows was removed while it was needed; analyze again$"):
        rows.column("latency_ns")


def test_a_folder_that_takes_no_rows_is_one_line(paired, tmp_path):
    with pytest.raises(OutputError, match=r"absent .*; give a larger folder with TMPDIR$"):
        packed(paired, tmp_path / "absent")
