"""docs/results/study.md: the table of its link follows from the traces that are kept with it."""

import re
import tarfile
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.units import format_duration, format_size

PAGE = Path(__file__).parents[2] / "docs" / "results" / "study.md"
FOLDER = PAGE.with_suffix("")
SETUPS = (("fastdds", "none"), ("fastdds", "builtin"), ("cyclonedds", "none"))
LABELS = {65_400: "87 KB", 151_875: "33 KB", 2_330_025: "1 MB"}
"""Sizes that the programs sent -> those of the text."""


def rows_of(summary):
    for label in ("33 KB", "87 KB", "1 MB"):
        for rate in (4.0, 20.0):
            for depth in (10, 1):
                cells = [
                    summary.row(by_predicate=condition, named=True)
                    for condition in (
                        (pl.col("vendor") == vendor)
                        & (pl.col("bridge") == bridge)
                        & (pl.col("rate_hz") == rate)
                        & (pl.col("depth") == depth)
                        & (pl.col("label") == label)
                        for vendor, bridge in SETUPS
                    )
                ]
                size = format_size(cells[0]["payload_bytes"]) if depth == 10 else f"{cells[0]['payload_bytes']:,} B"
                yield f"| {size} | {rate:g} Hz | {depth} | {' | '.join(map(cell, cells))} |"


def cell(row):
    share = "all" if row["received"] == row["planned"] else f"**{row['received']} of {row['planned']}**"
    return f"{share}, {format_duration(round(row['latency_p50_ns']))}"


def stored():
    return pl.read_csv(FOLDER / "link.csv").with_columns(
        label=pl.col("payload_bytes").map_elements(lambda size: LABELS.get(size) or format_size(size), pl.String)
    )


def test_every_row_of_the_table_is_that_of_the_stored_numbers():
    rows = re.findall(r"^\| [\d,]+ [KM]?B \| \d+ Hz \| .*$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert rows == list(rows_of(stored()))


@pytest.mark.parametrize(("name", "archives"), [("link", 2), ("host", 1)])
def test_the_stored_numbers_are_those_of_the_kept_traces(tmp_path, name, archives):
    files = list(FOLDER.glob(f"{name}*.tar.xz"))
    assert len(files) == archives
    for archive in files:
        assert archive.stat().st_size <= 1_000_000
        with tarfile.open(archive) as traces:
            traces.extractall(tmp_path / name, filter="data")
    numbers = pl.read_csv(FOLDER / f"{name}.csv")
    summary = analyze(tmp_path / name).summary.select(numbers.columns).cast(numbers.schema)
    assert_frame_equal(summary, numbers, check_row_order=False)
