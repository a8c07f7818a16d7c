"""The recommendation in words: on top of the page and of Markdown, with its deadline and its losses."""

from dataclasses import replace

import polars as pl
from analyses import MS, Measured, make_analysis
from roundtrip_frames import in_runs, steady
from wording import numbers

from dds_trace.analyzer.verdicts.job import Job
from dds_trace.analyzer.verdicts.recommend import recommend_settings
from dds_trace.reports.book.book import Book
from dds_trace.reports.book.groups import VENDORS, VendorLabels
from dds_trace.reports.book.recommendation import recommendation_info
from dds_trace.reports.html.page import render as render_html
from dds_trace.reports.markdown import render as render_markdown
from dds_trace.reports.terminal import render as render_terminal
from dds_trace.reports.terminal import render_brief

JOB = Job("binary", 33_000, 10.0, 50 * MS, 0.99, metric="latency")
MIXED = [MS + (n * 37 % 101) * 1000 for n in range(1500)]


def advised(frame):
    return recommendation_info(recommend_settings(frame, JOB), VendorLabels(VENDORS))


def test_the_job_has_its_deadline_and_what_meets_it(sentences):
    advice = advised(pl.concat([in_runs(MIXED), in_runs([None, MS] * 500, vendor="zenoh", run_id=2, spread=0.0)]))
    assert advice.sentence.startswith("Fast DDS meets")
    assert numbers(advice.sentence) == [50, 3, 73]
    sentences(advice.job, advice.sentence)
    good, lossy = advice.rows
    assert good[1] == "meets"
    assert good[6].startswith("3 runs, ")
    assert good[6].endswith(" bursts")
    assert lossy[1:6] == ("misses", "lost", "lost to lost", "50 %", "1 ms")


def test_one_run_is_not_said_to_meet_it():
    advice = advised(steady(MIXED))
    assert advice.sentence.endswith("likely to meet it: Fast DDS.")
    assert "within one run" in advice.rows[0][6]


def test_it_stands_on_top_of_the_page_and_of_markdown():
    analysis = make_analysis(Measured([MS, MS]))
    asked = replace(analysis, details=replace(analysis.details, recommendation=recommend_settings(in_runs(MIXED), JOB)))
    book = Book(asked)
    for text in (render_html(book), render_markdown(book)):
        assert "within the deadline of 50 ms" in text
        assert text.index("within the deadline") < text.index("What was measured")
    markdown = render_markdown(book)
    assert markdown.index("meets the deadline of 50 ms") < markdown.index(book.answer.headline[:10])
    assert recommendation_info(None, VendorLabels(VENDORS)) is None


def test_settings_are_told_in_words_by_what_sets_them_apart():
    apart = {"domain_mode": "different", "relay_domain_id": 10, "bridge": "builtin"}
    frame = pl.concat(
        [
            in_runs(MIXED),
            in_runs(MIXED, vendor="zenoh", relay_vendor="zenoh", run_id=2),
            in_runs(MIXED, run_id=3, setting="tuned=true", **apart),
        ]
    )
    assert {tuple(row[0].split(", ")) for row in advised(frame).rows} == {
        ("Fast DDS", "same domain", "nothing else set"),
        ("Zenoh", "same domain", "nothing else set"),
        ("Fast DDS", "through our built-in bridge", "tuned"),
    }


def test_each_pair_of_devices_and_link_has_a_recommendation_of_its_own(sentences):
    # What is best on the laptop says nothing about the Pi, which is ten times as slow.
    slow = [10 * ns for ns in MIXED]
    frame = pl.concat(
        [
            in_runs(MIXED, ping_device="laptop", relay_device="laptop"),
            in_runs(slow, run_id=2),
            in_runs(slow, run_id=3, setting="flows=2", vendor="zenoh", relay_vendor="zenoh"),
            in_runs([100 * ns for ns in MIXED], run_id=4, connectivity="wireless"),
        ]
    )
    advice = advised(frame)
    sentences(advice.sentence)
    assert advice.rows[0][0] == "Fast DDS, on laptop, wired"


def test_the_terminal_has_a_numbered_line_for_each_setup_within_80_columns():
    analysis = make_analysis(Measured([MS, MS]))
    frame = pl.concat([in_runs(MIXED), in_runs([None, MS] * 500, vendor="zenoh", run_id=2, spread=0.0)])
    recommendation = recommend_settings(frame, replace(JOB, metric="response"))
    book = Book(replace(analysis, details=replace(analysis.details, recommendation=recommendation)))
    alone, whole = render_brief(book), render_terminal(book)
    assert whole.endswith(alone)
    assert max(map(len, alone.splitlines())) <= 80
    words = " ".join(alone.split())
    assert "from planned send to reply" in words
    assert "vendor=" not in alone
    assert " 1. ✓ Fast DDS" in alone
    assert " 2. ✗ Zenoh" in alone
    assert "received 50 %" in words
    assert "To decide" not in alone
