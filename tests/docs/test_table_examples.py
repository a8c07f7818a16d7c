"""The examples of docs/how-to/tables.md, each run on a sample: programs of others read what the files say."""

import runpy
import sys
from pathlib import Path

import polars as pl
import pytest

from dds_trace.analyzer.exports.kinds import export_tables
from dds_trace.analyzer.pipeline import analyze

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "docs/examples").glob("tables_*.py"))


@pytest.fixture(scope="module")
def analyzed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tables")
    analysis = analyze(ROOT / "sample_traces/losses", out=folder)
    export_tables(analysis, "csv", folder)
    return folder, analysis


@pytest.fixture
def run_example(analyzed, capsys, monkeypatch):
    def run(name):
        pytest.importorskip(name)
        monkeypatch.setattr(sys, "argv", [name, str(analyzed[0])])
        runpy.run_path(str(ROOT / f"docs/examples/tables_{name}.py"))
        return capsys.readouterr().out

    return run


def test_every_example_is_on_the_page_and_run_here():
    page = (ROOT / "docs/how-to/tables.md").read_text(encoding="utf-8")
    assert [path.stem for path in EXAMPLES] == ["tables_duckdb", "tables_pandas", "tables_polars"]
    for path in EXAMPLES:
        assert f"```{{literalinclude}} ../examples/{path.name}\n" in page


def test_duckdb_finds_the_slowest_messages_and_reads_the_metadata(run_example, analyzed):
    said = run_example("duckdb").splitlines()
    slowest = analyzed[1].load_roundtrips().sort("latency_ns", descending=True, nulls_last=True).row(0, named=True)
    sent = f"{slowest['publish_utc']:%Y-%m-%d %H:%M:%S.%f}"
    row = f"{sent} {slowest['vendor']} {slowest['data_type']} {slowest['sequence']} {slowest['latency_ns'] / 1e6}"
    assert said[1] == row
    assert sum(line.startswith("dds_trace.") for line in said) == 5
    assert any(line.startswith('dds_trace.sources {"folder": "losses", "count": ') for line in said)


def test_pandas_counts_the_losses_and_knows_the_unit(run_example, analyzed):
    said = run_example("pandas").splitlines()
    rows = analyzed[1].load_roundtrips()
    lost = (rows["outcome"] != "completed").sum()
    assert lost > 0
    assert said[0] == f"{lost} of {len(rows)} messages lost"
    assert f"{rows['publish_utc'][0]:%Y-%m-%d %H:%M:%S}+00:00" in said[2]
    assert said[-1].startswith("ns (rtt - intermediate) // 2")


def test_polars_gives_our_own_p99(run_example, analyzed):
    said = run_example("polars")
    for latency_ns in analyzed[1].summary["latency_p99_ns"].drop_nulls():
        assert f"{latency_ns / 1e6:.6f}"[:6] in said
    assert "docs/trace-format.md, format 1" in said
    assert "ping " in said


def test_csv_has_the_same_rows_and_times_in_iso(analyzed):
    folder, analysis = analyzed
    read = pl.read_csv(folder / "roundtrips.csv", schema_overrides={"run_id": pl.String, "publish_utc": pl.String})
    rows = analysis.load_roundtrips()
    assert read.columns == rows.columns
    assert read["run_id"].to_list() == [f"{run_id:016x}" for run_id in rows["run_id"]]
    assert read["latency_ns"].to_list() == rows["latency_ns"].to_list()
    as_times = read["publish_utc"].str.to_datetime("%Y-%m-%dT%H:%M:%S%.9fZ", time_unit="ns", time_zone="UTC")
    assert as_times.to_list() == rows["publish_utc"].to_list()
