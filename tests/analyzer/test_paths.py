import shutil
from pathlib import Path

import pytest

from dds_trace import (
    analyze,
    analyze_topics,
    export_tables,
    find_traces,
    iter_event_batches,
    read_trace,
    recover,
    write_derived,
    write_reports,
)

LOSSES = Path(__file__).parents[2] / "sample_traces" / "losses"


@pytest.fixture
def trace(tmp_path):
    return Path(shutil.copy(find_traces(LOSSES)[0], tmp_path / "copy.mcap"))


def test_traces_are_found_and_read_by_text(trace):
    assert find_traces(str(trace.parent)) == [trace]
    assert find_traces(str(trace.parent), skip=[str(trace)]) == []
    by_path, by_text = read_trace(trace), read_trace(str(trace))
    assert by_text.path == by_path.path
    assert {stage: len(events) for stage, events in by_text.events.items()} == {
        stage: len(events) for stage, events in by_path.events.items()
    }
    batches = zip(iter_event_batches(trace), iter_event_batches(str(trace)), strict=True)
    assert all(one[0] is other[0] and len(one[1]) == len(other[1]) for one, other in batches)


def test_a_trace_is_recovered_by_text(trace, tmp_path):
    trace.write_bytes(trace.read_bytes()[:-200])
    target = tmp_path / "whole.mcap"
    recover(str(trace), str(target))
    assert not read_trace(str(target)).truncated


def test_results_are_written_by_text(tmp_path):
    analysis = analyze(str(LOSSES))
    folder = str(tmp_path / "out")
    assert all(path.is_file() for path in export_tables(analysis, "csv", folder))
    assert write_reports(analysis, ["json"], folder) == [Path(folder) / "report.json"]
    derived = write_derived(analysis.load_roundtrips(), f"{folder}/latency.mcap")
    assert derived.path == Path(folder) / "latency.mcap"


def test_topics_are_analyzed_by_text(trace):
    by_path, by_text = analyze_topics(trace), analyze_topics(str(trace))
    assert by_text.sources == by_path.sources
    assert analyze_topics([str(trace)], skip=[str(trace.parent / "none")]).sources == by_path.sources


def test_drafts_of_a_killed_analysis_are_removed_by_the_next_and_files_of_others_are_not(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    for name in ("roundtrips.parquet", "report.html", "notes.txt"):
        (out / f"{name}.0123abcd.part").write_text("half")
    analyze(LOSSES, out=out)
    assert {file.name for file in out.iterdir()} == {"roundtrips.parquet", "summary.parquet", "notes.txt.0123abcd.part"}
