"""docs/results/loopback: its numbers follow from the traces that it keeps, and its sentences do not contradict its table."""

import importlib.util
import json
import re
import sys
import tarfile
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from dds_trace.analyzer.pipeline import analyze
from dds_trace.reports.book.book import Book
from dds_trace.reports.reporters import load_reporter

FOLDER = Path(__file__).parents[2] / "docs" / "results" / "loopback"
SIZES = ("33 KB", "145 KB", "502 KB", "1 MB", "4 MB")


def test_every_file_is_small():
    assert max(path.stat().st_size for path in FOLDER.parent.rglob("*") if path.is_file()) <= 1_000_000


@pytest.fixture(scope="module")
def analysis(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kept") / "loopback"
    for archive in FOLDER.glob("*.tar.xz"):
        with tarfile.open(archive) as traces:
            traces.extractall(folder, filter="data")
    return analyze(folder)


def test_the_numbers_are_those_of_the_kept_traces(analysis):
    assert len(analysis.runs) == 150
    stored = pl.read_parquet(FOLDER / "summary.parquet")
    assert_frame_equal(analysis.summary.select(stored.columns), stored)


def sizes_of(span):
    """The sizes that a stretch of a sentence is about: `from 502 KB on`, `at 33 KB and 1 MB`, `at every size (...)`."""
    named = [SIZES.index(size) for size in re.findall(r"\d+ [KM]B", span)]
    if span.startswith("at every"):
        return set(SIZES)
    if span.startswith("up to"):
        return set(SIZES[: named[0] + 1])
    if span.startswith("from"):
        return set(SIZES[named[0] : named[1] + 1 if len(named) > 1 else None])
    return {SIZES[index] for index in named}


@pytest.mark.parametrize(("start", "bridged"), [("in the same domain", False), ("across different domains", True)])
def test_a_median_is_bold_exactly_where_a_sentence_calls_it_fastest(start, bridged, analysis):
    report = load_reporter("md").render(Book(analysis))
    heads, _, *rows = (line.strip("| ").split(" | ") for line in re.findall(r"^\|.*$", report, re.MULTILINE)[:7])
    bold = {
        (row[0].removeprefix("Binary "), head)
        for row in rows
        for head, cell in zip(heads, row, strict=True)
        if cell.startswith("**") and ("through" in head) is bridged
    }
    sentences = re.findall(rf"Fastest {start} (.*)\.\**$", report, re.MULTILINE)
    said = {
        (size, setup)
        for sentence in sentences
        for span, setup in re.findall(
            r"((?:at|up to|from) [\w ,]*?(?:[KM]B|on)): ([A-Z][\w -]*?) \(the next takes", sentence
        )
        for size in sizes_of(span)
    }
    assert bold or re.search(rf"{start} at every size: no proven winner", report)
    assert said == bold


ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def recipe():
    spec = importlib.util.spec_from_file_location("report_schemas", ROOT / "scripts/report_schemas.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["report_schemas"] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("file", ["reports/report.schema.json", "extensions/gates/comparison.schema.json"])
def test_a_schema_is_what_its_records_make(recipe, file):
    made = recipe.schema_text(recipe.SCHEMAS[file]())
    assert (ROOT / file).read_text(encoding="utf-8") == made, "run `just schemas`, and read what changed"


def test_every_field_that_may_be_missing_or_is_narrowed_exists(recipe):
    for record, names in recipe.ADDED.items():
        assert names <= set(record.__dataclass_fields__)
    properties = recipe.report_schema()["properties"]
    for name in recipe.NARROW:
        part, _, field = name.partition(".")
        described = properties[part]
        assert field in described.get("items", described)["properties"], name
    columns = {name for part in properties.values() for name in part.get("items", {}).get("properties", {})}
    assert columns >= recipe.NEVER_NULL | recipe.NULL_PARAMETERS


def test_the_schemas_describe_most_fields(recipe):
    text = json.dumps([make() for make in recipe.SCHEMAS.values()])
    assert text.count('"description"') > 150


@pytest.mark.parametrize("first", ["outages: Back after", "flows: The flow imu", "robot-and-laptop: /camera"])
def test_the_first_screen_is_about_what_was_recorded(tmp_path, monkeypatch, first):
    monkeypatch.setattr(sys, "path", [str(FOLDER.parents[2] / "scripts"), *sys.path])
    campaign, _, words = first.partition(": ")
    book = Book(analyze(importlib.import_module("quoted").unpack(campaign, tmp_path)), shows_all=True)
    assert words in " ".join(text for _, text in book.answer.sentences[:3])
    text = load_reporter("terminal").render(book)
    assert max(map(len, text.splitlines())) <= 80
    heads = re.findall(r"^Topic +Way +Rate +Size +Received .* Interval$", text, re.MULTILINE)
    assert len(heads) == (book.analysis.topics.height > 0), "no heading is cut"
