"""Rows that were encoded elsewhere: joined, they are the file that one writer would have made of them."""

import pickle
import subprocess
import sys

import duckdb
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from campaigns import write_runs
from polars.testing import assert_frame_equal

from dds_trace.analyzer.cache import parquet_join as row_parts
from dds_trace.analyzer.cache.parquet_join import RowPart, read_rows
from dds_trace.analyzer.pairing import parquet
from dds_trace.analyzer.pairing.parquet import ROUNDTRIPS_SCHEMA, encode_rows, roundtrips_writer
from dds_trace.analyzer.pairing.rows import RowStore
from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.errors import OutputError


@pytest.fixture
def tables(tmp_path):
    """Real rows as three tables of the columns' types as they are written, the second one empty."""
    write_runs(tmp_path / "runs", range(3), groups=2)
    analyze(tmp_path / "runs", out=tmp_path / "analysis")
    whole = read_rows(tmp_path / "analysis/roundtrips.parquet")
    whole = whole.replace_schema_metadata().cast(parquet._AS_WRITTEN).unify_dictionaries()
    return [whole[:50], whole[50:50], whole[50:]]


def written(path, parts):
    with roundtrips_writer(path, {"told": "x"}) as write:
        for part in parts:
            write(part)
    return path.read_bytes()


def test_joined_parts_are_the_same_file_wherever_they_were_encoded(tables, tmp_path):
    here = written(tmp_path / "here.parquet", tables)
    in_memory = [pickle.loads(pickle.dumps(encode_rows([table]))) for table in tables]
    assert written(tmp_path / "memory.parquet", in_memory) == here
    (tmp_path / "parts").mkdir()
    in_files = [encode_rows([table], tmp_path / "parts") for table in tables]
    assert len(list((tmp_path / "parts").iterdir())) == 3
    assert written(tmp_path / "files.parquet", in_files) == here
    assert list((tmp_path / "parts").iterdir()) == []
    assert written(tmp_path / "one.parquet", [encode_rows(tables)]) == here


def test_a_part_may_be_the_end_of_a_file_that_stays(tables, tmp_path):
    parts = []
    for number, table in enumerate(tables):
        path, encoded = tmp_path / f"{number}.rows", memoryview(encode_rows([table]).content)
        path.write_bytes(b"what stands before the rows" + encoded)
        parts.append(RowPart.at_end_of(path, len(encoded), len(table)))
    assert written(tmp_path / "joined.parquet", parts) == written(tmp_path / "here.parquet", tables)
    assert parts[0].load().equals(read_rows(pa.BufferReader(encode_rows(tables[:1]).content)))
    assert len(list(tmp_path.glob("*.rows"))) == 3


def test_every_reader_finds_the_rows_and_what_is_told_of_them(tables, tmp_path, monkeypatch):
    monkeypatch.setattr(parquet, "_ROWS_PER_GROUP", 13)
    path = tmp_path / "rows.parquet"
    written(path, [encode_rows(tables[:1]), encode_rows(tables[1:])])
    whole = pa.concat_tables(tables).cast(ROUNDTRIPS_SCHEMA.remove_metadata())
    found = pq.read_table(path)
    assert found.schema.equals(ROUNDTRIPS_SCHEMA, check_metadata=True)
    assert found.equals(whole)
    assert_frame_equal(pl.read_parquet(path), pl.from_arrow(whole))
    third = f"SELECT sequence, outcome FROM '{path}' OFFSET 70 LIMIT 20"
    assert duckdb.sql(third).fetchall() == list(
        zip(*(whole[name][70:90].to_pylist() for name in ("sequence", "outcome")), strict=True)
    )
    metadata = pq.read_metadata(path)
    groups = [metadata.row_group(number) for number in range(metadata.num_row_groups)]
    assert [group.num_rows for group in groups] == [13, 13, 13, 11, 0, 13, 13, 13, 13, 13, 5]
    assert metadata.metadata[b"told"] == b"x"
    # A reader that goes to one row group alone finds it by its offsets.
    file = pq.ParquetFile(path)
    assert file.read_row_group(7).equals(whole[50 + 2 * 13 : 50 + 3 * 13])


def test_no_rows_are_a_file_of_all_columns(tmp_path):
    written(tmp_path / "none.parquet", [])
    assert pq.read_table(tmp_path / "none.parquet").equals(ROUNDTRIPS_SCHEMA.empty_table())


def test_more_row_groups_than_have_a_number(tables, tmp_path, monkeypatch):
    monkeypatch.setattr(row_parts, "MOST_NUMBERED", 2)
    written(tmp_path / "many.parquet", [tables[0]] * 4)
    assert len(pq.read_table(tmp_path / "many.parquet")) == 4 * 50


@pytest.mark.parametrize("most_held", [10, 1000])
@pytest.mark.parametrize("is_written", [False, True])
def test_a_store_takes_parts_as_it_takes_tables(tables, tmp_path, monkeypatch, most_held, is_written):
    monkeypatch.setattr("dds_trace.analyzer.pairing.rows.MOST_HELD_ROWS", most_held)
    found = []
    for kind in (list, encode_rows):
        with RowStore(tmp_path / f"{kind.__name__}.parquet" if is_written else None) as store:
            for table in tables:
                store.add(kind([table]))
        found.append(store.load())
    assert_frame_equal(*found)


def test_parts_that_a_file_has_are_not_decoded(tables, tmp_path, monkeypatch):
    def decode(*_arguments):
        raise AssertionError("decoded")

    expected = pl.from_arrow(pa.concat_tables(tables))["sequence"]
    monkeypatch.setattr(row_parts.RowPart, "load", decode)
    with RowStore(tmp_path / "rows.parquet") as store:
        for table in tables:
            store.add(encode_rows([table]))
    assert store.load()["sequence"].equals(expected)
    with pytest.raises(AssertionError, match="decoded"), RowStore() as held:
        held.add(encode_rows([tables[0]]))


def test_a_file_that_was_written_anew_is_read_anew(tables, tmp_path):
    path = tmp_path / "rows.parquet"
    for held in (tables[:1], tables[:2]):
        written(path, held)
        assert RowStore.of(path).scan().collect().height == sum(map(len, held))


def test_a_folder_that_takes_no_part_is_one_line(tables, tmp_path):
    with pytest.raises(OutputError, match=r"^rows cannot be kept \(.*\); give a larger folder with TMPDIR$"):
        encode_rows(tables, tmp_path / "absent")


def test_a_disk_that_fills_while_parts_are_joined_leaves_the_old_file(tables, tmp_path, monkeypatch):
    path = tmp_path / "rows.parquet"
    before = written(path, tables[:1])

    def full(*_arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(row_parts, "_read_footer", full)
    with pytest.raises(OutputError, match=r"rows.parquet cannot be written \(No space left on device\)"):
        written(path, tables)
    assert path.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir() if each.suffix == ".part"] == []


def test_rows_are_read_without_pandas(tables, tmp_path):
    """Where it is installed, Arrow's reader of whole datasets loads it: two thirds of a second of every analysis."""
    pytest.importorskip("pandas")
    part = encode_rows(tables, tmp_path)
    code = (
        "import sys; from pathlib import Path; from dds_trace.analyzer.cache.parquet_join import RowPart, read_rows\n"
        "print(read_rows(Path(sys.argv[1])).num_rows, 'pandas' in sys.modules)"
    )
    command = [sys.executable, "-c", code, str(part.content)]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert said == [str(part.num_rows), "False"]
