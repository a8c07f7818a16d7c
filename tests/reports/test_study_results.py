"""The numbers of docs/results/study.md are those of the traces that are kept with it."""

import tarfile
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from dds_trace.analyzer.pipeline import analyze

FOLDER = Path(__file__).parents[2] / "docs" / "results" / "study"


@pytest.mark.parametrize(("name", "archives"), [("link", 2), ("host", 1)])
def test_the_stored_numbers_are_those_of_the_kept_traces(tmp_path, name, archives):
    files = list(FOLDER.glob(f"{name}*.tar.xz"))
    assert len(files) == archives
    assert max(path.stat().st_size for path in FOLDER.rglob("*.tar.xz")) <= 1_000_000
    for archive in files:
        with tarfile.open(archive) as traces:
            traces.extractall(tmp_path / name, filter="data")
    numbers = pl.read_csv(FOLDER / f"{name}.csv")
    summary = analyze(tmp_path / name).summary.select(numbers.columns).cast(numbers.schema)
    assert_frame_equal(summary, numbers, check_row_order=False)
