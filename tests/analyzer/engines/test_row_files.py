"""Rows that come from a worker process in a file: the same, once, and nothing is left."""

import pickle

import pyarrow as pa
import pytest

from dds_trace.analyzer.engines.row_files import RowFile
from dds_trace.tracefile import OutputError


def table(*texts):
    return pa.table(
        {"a": pa.array(range(len(texts)), pa.int64()), "b": pa.array(texts, pa.string()).dictionary_encode()}
    )


def test_tables_come_back_as_they_were_and_the_file_is_gone(tmp_path):
    tables = [table("x", "y", "x"), table("z"), table("y", "y")]
    rows = pickle.loads(pickle.dumps(RowFile.of(iter(tables), tmp_path)))
    assert len(list(tmp_path.iterdir())) == 1
    taken = list(rows)
    assert list(tmp_path.iterdir()) == []
    assert [each.to_pydict() for each in taken] == [each.to_pydict() for each in tables]


def test_no_table_is_no_file(tmp_path):
    assert list(RowFile.of([], tmp_path)) == []
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_takes_no_file_is_one_line(tmp_path):
    with pytest.raises(OutputError, match=r"^rows cannot be kept \(.*\); give a larger folder with TMPDIR$"):
        RowFile.of([table("x")], tmp_path / "absent")
