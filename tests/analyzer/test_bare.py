"""The analyzer against `bare.py`, which computes its rows and its summary with mcap, numpy and polars alone."""

import ast
import re
import sys
import tarfile
from pathlib import Path

import bare
import polars as pl
import pytest
from trace_files import SAMPLE_NAMES, SAMPLES

from dds_trace.analyzer.model.parameters import PARAMETER_COLUMNS
from dds_trace.analyzer.pipeline import analyze

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "docs" / "results"
OF_OTHERS = {"drive/traces"}
"""A bag without our events."""
QUICK = {"two-clocks/traces", "two-machines/traces", "fan-out/traces"}
BY_MORE = {"fan-out/traces", "flows/traces", "lossy-link/traces", "lossy-link-held/traces", "outages/traces"}
BY_MORE |= {"two-machines/traces", "stacks/links", "stacks/nodes", "stacks/rmw-zenoh"}
"""Campaigns that vary more than the settings of `bare.SETTINGS`: these groups are the analyzer's."""
RESTARTED = {"outages/traces"}
"""Campaigns in which one relay follows another within a run, so that a message has one row."""
CAMPAIGNS = {str(path.relative_to(RESULTS)).removesuffix(".tar.xz"): path for path in RESULTS.glob("*/*.tar.xz")}
ROWS = ("publish_ns", "receive_ns", "relay_in_ns", "relay_out_ns", "rtt_ns", "intermediate_ns", "latency_ns")
ROWS += ("response_ns", "outcome", "duplicates")


def cases():
    yield from SAMPLE_NAMES
    for name in sorted(CAMPAIGNS.keys() - OF_OTHERS):
        yield name if name in QUICK else pytest.param(name, marks=pytest.mark.slow)


def differing(theirs, ours, columns):
    """The columns with a row that differs; of float64, by more than rounding of sums in another order."""
    assert theirs.height == ours.height > 0
    return [
        name
        for name in columns
        if not (
            theirs[name].is_null().eq(ours[name].is_null()).all()
            and (theirs[name] - ours[name]).abs().le(1e-11 * ours[name].abs() + 1e-6).all()
            if ours.schema[name].is_float()
            else theirs[name].cast(ours.schema[name]).eq_missing(ours[name]).all()
        )
    ]


@pytest.mark.parametrize("name", list(cases()))
def test_the_analyzer_gives_what_sixty_lines_give(name, tmp_path):
    folder = SAMPLES / name
    if name in CAMPAIGNS:
        folder = tmp_path / "traces"
        with tarfile.open(CAMPAIGNS[name]) as packed:
            packed.extractall(folder, filter="data")
    analysis = analyze(folder, out=tmp_path / "out")
    events, runs = bare.load(folder)
    ours, message = analysis.load_roundtrips(), bare.MESSAGE
    if name in RESTARTED:
        events = {kind: frame.with_columns(relay_id=pl.lit(0, pl.UInt32)) for kind, frame in events.items()}
        message = ("run_id", "sequence")
    ours, rows = ours.sort(message), bare.pair(events, runs)

    assert rows.select(message).rows() == ours.select(message).rows()
    assert differing(rows, ours, ROWS) == []

    by = bare.SETTINGS
    if name in BY_MORE:
        by = tuple(column.name for column in PARAMETER_COLUMNS)
        assert bare.summarize(rows).height < analysis.summary.height
        rows = pl.concat([rows.drop(by, strict=False), ours.select(by)], how="horizontal")
    found = bare.summarize(rows, by)
    columns = [column for column in found.columns if column not in by]
    assert len(columns) == 41
    assert differing(found, analysis.summary.sort(by), columns) == []


def test_it_imports_nothing_of_ours_and_the_page_has_its_length():
    text = Path(bare.__file__).read_text(encoding="utf-8")
    imports = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Import | ast.ImportFrom)]
    names = {node.module if isinstance(node, ast.ImportFrom) else node.names[0].name for node in imports}
    assert {name.partition(".")[0] for name in names} - sys.stdlib_module_names == {"mcap", "numpy", "polars"}
    page = (ROOT / "docs/explanation/analyzer.md").read_text(encoding="utf-8")
    assert re.search(r"in (\d+) lines", page)[1] == str(sum(map(bool, text.splitlines())))
