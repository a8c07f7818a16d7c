import json
from dataclasses import fields, replace
from pathlib import Path

import polars as pl
import pytest
from analyses import EVERY_ANALYSIS
from trace_files import SAMPLE_NAMES, SAMPLES, copy_sample
from wording import report_as

from dds_trace.analyzer.analysis import DETAIL_FRAMES, Details, load_analysis
from dds_trace.analyzer.pipeline import analyze
from dds_trace.analyzer.saving.folder import MANIFEST
from dds_trace.analyzer.verdicts.job import make_job
from dds_trace.base.errors import OutputError, OutputExistsError, TraceError, TraceFormatError
from dds_trace.reports.reporters import REPORT_MODULES

JOB = make_job(data="binary", size="33KB", rate="20", deadline="50ms", reliability="0.9")
WAYS = {
    "plain": {},
    "deadline and job": {"deadline_ns": 5_000_000, "job": JOB},
    "without details": {"details": False},
    "sketch": {"sketch": True},
}


@pytest.mark.keeps(3)
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", SAMPLE_NAMES)
def test_every_report_of_a_loaded_analysis_equals_that_of_the_fresh_one(tmp_path, name, way):
    fresh = analyze(SAMPLES / name, out=tmp_path / "out", **WAYS[way])
    fresh.save(tmp_path / "saved")
    loaded = load_analysis(tmp_path / "saved")
    for kind in REPORT_MODULES:
        assert report_as(kind, loaded) == report_as(kind, fresh), kind
    assert loaded.load_roundtrips().equals(fresh.load_roundtrips())
    assert loaded.load_roundtrips().schema == fresh.load_roundtrips().schema
    for frame in ("summary", "distributions", "run_times", "timeline"):
        assert getattr(loaded, frame).equals(getattr(fresh, frame)), frame
        assert getattr(loaded, frame).schema == getattr(fresh, frame).schema, frame
    for frame in DETAIL_FRAMES:
        assert getattr(loaded.details, frame).equals(getattr(fresh.details, frame)), frame
        assert getattr(loaded.details, frame).schema == getattr(fresh.details, frame).schema, frame
    assert (loaded.sessions, loaded.runs) == (fresh.sessions, fresh.runs)
    assert (loaded.details.answers, loaded.details.recommendation) == (
        fresh.details.answers,
        fresh.details.recommendation,
    )
    assert loaded.outputs == fresh.outputs


@pytest.mark.keeps(2)
@pytest.mark.parametrize("name", [name for name in EVERY_ANALYSIS if name != "500 groups"])
def test_every_report_of_a_drawn_analysis_comes_back(tmp_path, name):
    fresh = EVERY_ANALYSIS[name]()
    fresh.save(tmp_path / "saved")
    loaded = load_analysis(tmp_path / "saved")
    for kind in REPORT_MODULES:
        assert report_as(kind, loaded) == report_as(kind, fresh), kind


def test_every_frame_of_the_details_is_saved():
    assert {field.name for field in fields(Details) if "DataFrame" in str(field.type)} == set(DETAIL_FRAMES)


@pytest.fixture(scope="module")
def analysis():
    return analyze(SAMPLES / "losses")


@pytest.fixture
def saved(tmp_path, analysis):
    analysis.save(tmp_path / "saved")
    return tmp_path / "saved"


def data_files(folder):
    return sorted(path for path in folder.iterdir() if path.name != MANIFEST)


def test_a_lost_message_is_infinitely_late_in_what_was_saved(saved):
    content = json.loads(next(saved.glob("content-*.json")).read_text())
    latencies = [one["latency"]["upper"] for answer in content["answers"] for one in answer["contenders"]]
    assert "inf" in latencies
    assert load_analysis(saved).details.answers[0].contenders


def test_a_second_save_replaces_the_first_and_leaves_no_file_of_it(saved, analysis):
    before = data_files(saved)
    analysis.save(saved)
    after = data_files(saved)
    assert len(after) == len(before)
    assert not set(after) & set(before)
    assert load_analysis(saved).summary.equals(analysis.summary)


@pytest.mark.parametrize(
    ("error", "told"), [(OSError(28, "No space left on device"), OutputError), (KeyboardInterrupt(), KeyboardInterrupt)]
)
def test_a_save_that_fails_keeps_the_earlier_one(saved, analysis, monkeypatch, error, told):
    def fail(*_, **__):
        raise error

    before = sorted(saved.iterdir())
    monkeypatch.setattr(pl.DataFrame, "write_parquet", fail)
    with pytest.raises(told):
        analysis.save(saved)
    assert sorted(saved.iterdir()) == before
    assert load_analysis(saved).summary.equals(analysis.summary)


def test_a_save_of_an_older_version_is_replaced_and_one_of_a_later_version_stays(saved, analysis):
    manifest = json.loads((saved / MANIFEST).read_text())
    before = data_files(saved)
    (saved / MANIFEST).write_text(json.dumps(manifest | {"version": manifest["version"] - 1}))
    analysis.save(saved)
    assert not set(data_files(saved)) & set(before)
    assert load_analysis(saved).summary.equals(analysis.summary)
    (saved / MANIFEST).write_text(json.dumps(manifest | {"version": manifest["version"] + 1}))
    with pytest.raises(OutputExistsError, match="give a folder of its own"):
        analysis.save(saved)


def test_a_folder_with_anything_else_is_not_written_to(tmp_path, analysis):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(OutputExistsError, match="give a folder of its own"):
        analysis.save(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
    with pytest.raises(OutputExistsError, match="give a folder of its own"):
        analysis.save(tmp_path / "notes.txt")


def one_line(error):
    text = str(error.value)
    assert "\n" not in text
    return text


@pytest.mark.parametrize("damage", ["cut", "flipped", "gone", "empty"])
def test_damage_to_any_file_is_told_in_one_line(saved, damage):
    for path in sorted(saved.iterdir()):
        intact = path.read_bytes()
        middle = len(intact) // 2
        flipped = intact[:middle] + bytes([intact[middle] ^ 0x10]) + intact[middle + 1 :]
        if damage == "gone":
            path.unlink()
        else:
            path.write_bytes({"cut": intact[:-1], "flipped": flipped, "empty": b""}[damage])
        if path.name == MANIFEST and damage == "cut":
            path.write_bytes(intact[:-3])  # the last byte is a line feed
        with pytest.raises(TraceError) as error:
            load_analysis(saved)
        assert str(saved) in one_line(error)
        path.write_bytes(intact)
    load_analysis(saved)


def test_a_save_without_a_column_of_the_summary_is_refused_in_one_line(tmp_path, analysis):
    replace(analysis, summary=analysis.summary.drop("own_share", "runs")).save(tmp_path / "saved")
    with pytest.raises(
        TraceFormatError, match=r"lacks the columns runs, own_share of summary.*analyze the traces again"
    ) as error:
        load_analysis(tmp_path / "saved")
    assert str(tmp_path) in one_line(error)


def test_a_zero_anywhere_in_the_manifest_is_refused(saved):
    path = saved / MANIFEST
    intact = path.read_bytes()
    expected = load_analysis(saved).findings
    for place in range(0, len(intact), 7):
        path.write_bytes(intact[:place] + b"\x00" + intact[place + 1 :])
        with pytest.raises(TraceFormatError) as error:
            load_analysis(saved)
        one_line(error)
    path.write_bytes(intact)
    assert load_analysis(saved).findings == expected


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": "something else"}, "not the manifest"),
        ({"version": 8}, "version 8 .* version 7: read"),
        ({"version": 1}, "version 1 .* version 7: analyze"),
        ({"files": {}}, "cannot be read"),
        ({"files": {"content.json": {"file": "../content.json", "bytes": 0, "sha256": ""}}}, "names '../content.json'"),
        (
            {"files": {"content.json": {"file": "notes-12345678.json", "bytes": 0, "sha256": ""}}},
            "names 'notes-12345678.json'",
        ),
        ({"files": {"content.json": {"file": 7, "bytes": 0, "sha256": ""}}}, "Manifest.files.content.json.file is 7"),
        ({"files": None}, "Manifest.files is None"),
    ],
)
def test_a_foreign_manifest_is_refused(saved, change, words, sentences):
    path = saved / MANIFEST
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(TraceFormatError, match=words) as error:
        load_analysis(saved)
    sentences(one_line(error).replace(str(saved), "FOLDER"))


@pytest.mark.parametrize("text", ["[]", "7", "null", "{", "", "[" * 100_000, "\ufeff{}"])
def test_a_manifest_that_is_no_object_is_refused(saved, text):
    (saved / MANIFEST).write_text(text)
    with pytest.raises(TraceFormatError):
        load_analysis(saved)


def test_a_folder_without_a_saved_analysis_says_how_to_write_one(tmp_path):
    for path in (tmp_path, tmp_path / "nowhere", SAMPLES / "losses"):
        with pytest.raises(TraceFormatError, match=r"write one with Analysis\.save"):
            load_analysis(path)


def test_the_example_of_the_documentation_runs(tmp_path, monkeypatch):
    text = (SAMPLES.parent / "docs" / "how-to" / "analyze.md").read_text(encoding="utf-8")
    example = text.partition("### Save and load\n\n```python\n")[2].partition("```")[0]
    copy_sample("losses", tmp_path / "runs")
    monkeypatch.chdir(tmp_path)
    exec(example, {})
    assert {path.name for path in Path("runs/analysis").iterdir()} == {"saved", "report.html", "report.md"}
