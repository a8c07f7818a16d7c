import html
import re

import pytest
from four_campaigns import CAMPAIGNS
from visible_text import visible_text

from dds_trace.analyzer.verdicts.compare import compare_roundtrips
from dds_trace.analyzer.verdicts.gate import parse_gate
from dds_trace.analyzer.verdicts.gates import judge_gates
from dds_trace.reports.book.book import Book
from dds_trace.reports.comparison import document
from dds_trace.reports.comparison import markdown as comparison_markdown
from dds_trace.reports.comparison import page as comparison_page
from dds_trace.reports.comparison import terminal as comparison_terminal
from dds_trace.reports.comparison.info import comparison_info
from dds_trace.reports.notebook import MOST_CHARACTERS
from dds_trace.reports.reporters import load_reporter

OLD_WORDS = re.compile(
    r"\bcells?\b|via builtin|null for want|keeping an event|\brecorder\b|\blibrary\b|the way was full|waits in reader"
    r"|vendors against each other|per vendor\b|\bseries\b|\binconclusive\b|combinations?\b|\bcontenders?\b|\bstrat(?:um|a)\b"
    r"|\bsurvivors?\b|\b(?:told|tells?) apart\b|\bepisodes?\b|\bchoices?\b",
    re.IGNORECASE,
)
"""Words that newcomers did not understand on the page."""

SHAPES = {
    # name -> groups, devices and links, runs of each group, whether messages are lost
    "demo": (6, 1, 3, False),
    "lossy machine": (126, 1, 3, True),
    "study": (384, 6, 3, True),
    "500 groups": (520, 1, 1, True),
}


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_a_campaign_has_its_groups_places_runs_and_losses(name):
    analysis = CAMPAIGNS[name]()
    summary = analysis.summary
    places = summary.select("ping_device", "relay_device", "connectivity").unique().height
    loses = bool((summary["received"] < summary["published"]).any())
    (runs,) = summary["runs"].unique()
    assert (summary.height, places, runs, loses) == SHAPES[name]
    assert len(analysis.runs) == summary["runs"].sum()
    first = analysis._repr_html_()
    assert len(first) <= MOST_CHARACTERS
    assert ("color:#e5484d" in first) == SHAPES[name][3], "losses are red in a notebook, too"
    assert first.count("<tbody>") == places
    book = Book(analysis)
    for kind in ("html", "md", "terminal"):
        shown = visible_text(load_reporter(kind).render(book))
        assert ("the paper's intermediate-process time" in shown) == (kind == "html")
        old = [shown[max(0, found.start() - 60) : found.end() + 30] for found in OLD_WORDS.finditer(shown)]
        assert old == [], f"{kind} of {name}"


def test_a_comparison_is_in_the_words_of_a_report():
    sides = [CAMPAIGNS[name]().load_roundtrips() for name in ("demo", "demo")]
    comparison = compare_roundtrips(*sides)
    info = comparison_info(comparison, judge_gates(comparison, [parse_gate("latency_p50 > +10%")]))
    texts = [
        comparison_terminal.render(info, shows_all=True),
        comparison_markdown.render(info, shows_all=True),
        visible_text(comparison_page.render(info, "main → branch")),
        document.render_junit(info),
    ]
    found = [set(OLD_WORDS.findall(html.unescape(text).lower())) for text in texts]
    assert all(words <= {"inconclusive"} for words in found), "the outcome of a gate is a code"
