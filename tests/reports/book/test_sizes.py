from dataclasses import replace
from html import unescape

import polars as pl
import pytest
from analyses import BRIDGED, MS, ZENOH, Measured, around, make_analysis
from four_campaigns import CAMPAIGNS
from paired_by_hand import paired
from wording import numbers

from dds_trace.analyzer.groups.freshness import freshness_frame
from dds_trace.reports.book.book import Book
from dds_trace.reports.book.sizes import SizeCell, Threshold
from dds_trace.reports.reporters import load_reporter


def test_a_row_has_both_domains_and_bold_is_where_the_verdict_holds():
    table = Book(
        make_analysis(Measured(around(2 * MS)), Measured(around(MS), **ZENOH), Measured(around(4 * MS), **BRIDGED))
    ).sizes
    assert table.modes == (("same domain", 2), ("different domains", 1))
    assert table.choices == ("Fast DDS", "Zenoh", "Fast DDS through our built-in bridge")
    ((row,),) = (place.rows for place in table.places)
    assert (row.size, row.rate) == ("Binary 33 KB", "10 Hz")
    # 20 messages carry no p99, and one choice across domains leads nobody.
    assert row.cells == (
        SizeCell("2.01 ms", "-", leads_p50=False, leads_p99=False, lost="", group=1),
        SizeCell("1.01 ms", "-", leads_p50=True, leads_p99=False, lost="", group=2),
        SizeCell("4.01 ms", "-", leads_p50=False, leads_p99=False, lost="", group=0),
    )


def test_lost_messages_are_infinitely_late_in_the_table_and_their_share_is_told():
    table = Book(make_analysis(Measured([*around(MS)[:8], *["lost_return"] * 12]))).sizes
    ((cell,),) = (row.cells for place in table.places for row in place.rows)
    assert (cell.p50, cell.lost) == ("lost", "60 % lost")


def test_the_rate_in_the_middle_is_shown_and_the_others_stand_behind():
    rates = (5.0, 10.0, 20.0, 40.0)
    table = Book(make_analysis(*(Measured(around(MS), rate_hz=rate) for rate in rates))).sizes
    (place,) = table.places
    assert table.rates == "at 10 Hz"
    assert [row.rate for row in place.rows] == ["10 Hz"]
    assert [row.rate for row in place.further] == ["5 Hz", "20 Hz", "40 Hz"]


def with_deadline(deadline_ns, *measured):
    analysis = make_analysis(*measured)
    rows = analysis.load_roundtrips().with_columns(group=(pl.col("run_id") - 0xA000).cast(pl.UInt32))
    unsent = {
        (run_id, 7): count for run_id, count in zip(range(0xA000, 0xA100), analysis.summary["unsent"], strict=False)
    }
    freshness = freshness_frame(*paired(rows, deadline_ns=deadline_ns, unsent=unsent))
    details = replace(analysis.details, freshness=freshness, deadline_ns=deadline_ns)
    return replace(analysis, details=details)


# Round trips of 2.12 ms and more; one of 20.12 ms.
IN_TIME, LATE = Measured(around(MS)), Measured([*around(MS)[:19], 10 * MS], payload_bytes=1_000_000)


def test_a_deadline_passes_where_no_message_is_late_and_fails_with_the_worst_result(sentences):
    table = Book(with_deadline(5 * MS, IN_TIME, LATE, Measured(around(MS), **ZENOH))).sizes
    assert table.deadline == "response within 5 ms"
    failed, passed = table.places[0].thresholds
    assert (failed.outcome, numbers(failed.why)) == ("fail", [1, 2, 1, 10, 5])
    assert passed == Threshold("pass", "")
    sentences(failed.why)


def test_unsent_messages_miss_the_deadline():
    table = Book(with_deadline(5 * MS, Measured(around(MS), unsent=20))).sizes
    (failed,) = table.places[0].thresholds
    assert (failed.outcome, numbers(failed.why)) == ("fail", [33, 10, 50])


def test_a_deadline_that_no_message_was_judged_by_is_not_passed():
    analysis = with_deadline(5 * MS, IN_TIME, Measured(around(MS), **ZENOH))
    judged = pl.lit(0, analysis.details.freshness.schema["judged"])
    untold = replace(analysis.details, freshness=analysis.details.freshness.with_columns(judged=judged))
    table = Book(replace(analysis, details=untold)).sizes
    outcomes = {(one.outcome, one.why) for place in table.places for one in place.thresholds}
    assert outcomes == {("not known", "")}
    assert Book(make_analysis()).sizes is None


@pytest.mark.parametrize(
    ("kind", "bold"),
    [("html", 'class="tint-0 strong">1.01 ms</a>'), ("md", "**1.01 ms**"), ("terminal", "1.01 ms / -")],
)
def test_every_report_has_the_table_with_bold_losses_and_outcomes(kind, bold):
    lossy = Measured([*around(2 * MS)[:15], *["lost_return"] * 5])
    book = Book(with_deadline(5 * MS, lossy, Measured(around(MS), **ZENOH)), shows_all=True)
    text = unescape(load_reporter(kind).render(book)).replace("\N{NO-BREAK SPACE}", " ")
    for words in (bold, "25 % lost", "response within", "✗", "fail", "✓"):
        assert words in text


def test_the_terminal_has_every_choice_in_80_columns():
    text = load_reporter("terminal").render(Book(CAMPAIGNS["lossy machine"](), shows_all=True))
    table = text[text.index("Latency of a typical run (at 10 Hz)") : text.index("Bold:")]
    assert table.count("Binary 4 MB") == 3, "seven choices take three tables"
    assert "71 % lost" in table
    assert max(map(len, table.splitlines())) <= 80


def test_the_study_has_six_places_with_a_row_for_each_size():
    table = Book(CAMPAIGNS["study"]()).sizes
    assert [len(place.rows) for place in table.places] == [4] * 6
    assert all(len(place.further) == 12 for place in table.places)
    wireless = {place.place: place.rows[-1].cells[0].lost for place in table.places}
    assert wireless["pi3-a → pi3-b, wired"] == ""
    assert wireless["pi3-a → pi3-b, wireless"].endswith("% lost")
