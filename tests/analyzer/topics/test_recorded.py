"""docs/results/two-machines: the tutorials quote what the kept traces give."""

from __future__ import annotations

import re
import tarfile
from pathlib import Path

import pytest

from dds_trace.analyzer.pipeline import analyze
from dds_trace.reports.book.book import Book
from dds_trace.reports.terminal import render_brief

DOCS = Path(__file__).parents[3] / "docs"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded")
    with tarfile.open(DOCS / "results" / "two-machines" / "traces.tar.xz") as archive:
        archive.extractall(folder, filter="data")
    return analyze(folder / "robot-and-laptop")


def test_the_archive_is_small():
    assert (DOCS / "results" / "two-machines" / "traces.tar.xz").stat().st_size <= 1_000_000


@pytest.mark.parametrize("name", ["camera-late", "no-ptp"])
def test_tutorials_quote_the_answer(recorded, name):
    text = (DOCS / "tutorials" / f"{name}.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```text\n(.*?)```", text, re.DOTALL)
    answer = render_brief(Book(recorded))
    assert blocks
    assert all(block in answer for block in blocks)


def test_the_clocks_are_two_seconds_apart_and_every_time_is_bounded(recorded):
    (fit,) = {
        row["offset_ns"] // 10**8 for row in recorded.details.clock_fits.iter_rows(named=True) if row["offset_ns"] > 0
    }
    assert fit in (19, 20)
    over = recorded.topics.filter(topic="/camera/image", relay_device="laptop").to_dicts()[0]
    assert (over["clock"], over["ping_device"]) == ("fit", "robot")
    assert over["bound_ns"] < 1_000_000
    messages = recorded.topic_messages
    assert messages["one_way_ns"].min() >= 0
    assert messages["age_ns"].min() >= 0
    assert not messages["bound_ns"].null_count()
