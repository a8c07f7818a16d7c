"""The first sentences, each with numbers drawn by hand."""

from dataclasses import replace

import pytest
from analyses import EVERY_ANALYSIS, MS, ZENOH, Measured, around, make_analysis
from four_campaigns import CAMPAIGNS
from wording import numbers

from dds_trace import Finding, Severity
from dds_trace.reports.book.book import Book
from dds_trace.reports.reporters import load_reporter


def said(*measured):
    answer = Book(make_analysis(*measured)).answer
    return [answer.headline, *answer.points]


def test_a_threshold_is_named_where_the_winner_begins(sentences):
    sizes = {33_000: 1.0, 145_000: 2.0, 1_000_000: 4.0}
    groups = [
        Measured(around(int(MS * factor)), payload_bytes=size, **sides)
        for size, slower in sizes.items()
        for factor, sides in ((slower, {}), (1.0, ZENOH))
    ]
    first, rest = said(*groups)[:2]
    assert "from 145 KB on: Zenoh" in first
    assert "1.99 to 3.97 times" in first
    assert ";" not in first
    assert "33 KB" in rest
    sentences(first, rest)


def test_the_study_is_described_by_size_and_device_pair_and_not_by_one_full_recording_of_many(sentences):
    analysis = CAMPAIGNS["study"]()
    full = Finding(Severity.WARNING, "cpu_saturated", "session", "It was full.", "Free it.")
    answer = Book(replace(analysis, findings=(full,))).answer
    assert "busy" not in answer.points[-1]
    assert numbers(answer.headline)[1:] == [6_804, 115_200, 1]
    points = "\n".join(answer.points)
    assert points.count("(3 links)") == 2
    assert "about 7 repeats" in points
    assert "MB at 40 Hz, pi3-a" in points
    assert points.count("% lost)") == 3
    assert "3 runs of each" in answer.points[-1]
    sentences(answer.headline, *answer.points)
    assert " - to" not in "\n".join(answer.remarks), "an infinite difference is counted and not printed"


@pytest.mark.parametrize("kind", ["html", "md", "terminal", "json"])
def test_every_report_says_the_same_sentences_in_the_same_order(kind):
    groups = [Measured(around(2 * MS)), Measured(around(MS), **ZENOH)]
    book = Book(make_analysis(*groups), shows_all=True)
    text = " ".join(load_reporter(kind).render(book).split()).replace("&#40;", "(").replace("&#41;", ")")
    places = [
        text.find(part.split(":")[0].split("→")[0].strip()) for part in (book.answer.headline, *book.answer.points)
    ]
    assert -1 not in places
    assert places == sorted(places)


def test_each_sentence_has_its_kind():
    lossy = Book(CAMPAIGNS["lossy machine"]()).answer
    assert [kind.value for kind in lossy.kinds][:3] == ["loss", "avoid", "doubt"]
    assert len(lossy.sentences) == len(lossy.kinds) == 1 + len(lossy.points)
    assert {"bridge", "where"} <= {kind.value for kind in lossy.kinds}
    demo = Book(CAMPAIGNS["demo"]()).answer
    assert [one.outcome for one in (lossy, demo)] == ["lossy", "open"]
    assert [kind.value for kind in demo.kinds] == ["undecided", "undecided", "bridge", "where"]
    assert [kind.value for kind in Book(EVERY_ANALYSIS["empty folder"]()).answer.kinds] == ["nothing"]


@pytest.mark.parametrize(("counts", "words"), [((1, 2, 5), "1 to 5"), ((3,), "3")])
@pytest.mark.parametrize(("name", "noun"), [("flows", "runs at once"), ("relays", "relays")])
def test_a_link_with_several_numbers_of_runs_or_relays_is_one_clause(name, noun, counts, words):
    settings = [f"{name}={count},link=x" if count > 1 else "link=x" for count in counts]
    where = said(*(Measured(around(MS), setting=setting, connectivity="wired") for setting in settings))[-1]
    assert where.count("wired") == 1
    assert f" {words} {noun}" in where
