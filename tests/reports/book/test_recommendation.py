"""The recommendation in words: on top of the page and of Markdown, with its deadline and its losses."""

from dataclasses import replace

import polars as pl
from analyses import MS, Measured, make_analysis
from roundtrip_frames import in_runs, steady

from dds_trace.analyzer.verdicts.job import Job
from dds_trace.analyzer.verdicts.recommend import recommend_settings
from dds_trace.reports.book.book import Book
from dds_trace.reports.book.recommendation import recommendation_info
from dds_trace.reports.html.page import render as render_html
from dds_trace.reports.markdown import render as render_markdown

JOB = Job("binary", 33_000, 10.0, 50 * MS, 0.99, metric="latency")
MIXED = [MS + (n * 37 % 101) * 1000 for n in range(1500)]


def advised(frame):
    return recommendation_info(recommend_settings(frame, JOB))


def test_the_job_is_told_with_its_deadline_and_what_meets_it():
    advice = advised(
        pl.concat([in_runs(MIXED), in_runs([None, MS] * 500, vendor="zenoh", run_id=2, spread=0.0)])
    )
    assert advice.asked == "Binary 33 KB at 10 Hz: 99 % of the messages within the deadline of 50 ms."
    assert advice.said == "vendor=fastdds bridge=none meets it."
    good, lossy = advice.rows
    assert good[1] == "meets"
    assert good[6].startswith("3 runs, ")
    assert good[6].endswith(" episodes")
    assert lossy[1:6] == ("misses", "lost", "lost to lost", "50 %", "1 ms")


def test_one_run_is_not_said_to_meet_it():
    advice = advised(steady(MIXED))
    assert advice.said == "Nothing is shown to meet it; likely: vendor=fastdds bridge=none."
    assert "within one run" in advice.rows[0][6]


def test_it_stands_on_top_of_the_page_and_of_markdown():
    analysis = make_analysis(Measured([MS, MS]))
    asked = replace(
        analysis, details=replace(analysis.details, recommendation=recommend_settings(in_runs(MIXED), JOB))
    )
    book = Book(asked)
    for text in (render_html(book), render_markdown(book)):
        assert "within the deadline of 50 ms" in text
        assert text.index("within the deadline") < text.index("What was measured")
    markdown = render_markdown(book)
    assert markdown.index("meets it") < markdown.index(book.answer.headline[:10])
    assert recommendation_info(None) is None
