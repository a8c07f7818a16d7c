import re
from dataclasses import replace

import pytest
from analyses import EVERY_ANALYSIS, MS, Measured, make_analysis

from dds_trace.analyzer.model.finding import Finding, Severity, Subject
from dds_trace.reports.book.book import Book
from dds_trace.reports.book.findings import FindingKind, OneFinding, severity_counts
from dds_trace.reports.reporters import load_reporter

RATES = [10.0 * step for step in range(1, 7)]
RESULT = "Binary 33 KB at 10 Hz"


def analysis_with(*findings, rates=RATES):
    return make_analysis(*(Measured([MS, 2 * MS], rate_hz=rate) for rate in rates), findings=findings)


def loss(group, **changes):
    return replace(
        Finding(Severity.WARNING, "loss", f"group {group}", "1 of 2 is lost.", "Look at it.", (group,)), **changes
    )


def test_a_kind_is_one_entry_with_a_count():
    step = Finding(Severity.ERROR, "cpu_saturated", "ping on pi", "It was busy.", "Free it.")
    loss_of_two, busy = Book(analysis_with(loss(0), loss(2), step)).findings
    assert loss_of_two == FindingKind(
        "warning",
        "loss",
        "Loss",
        2,
        (
            OneFinding("Binary 33 KB at 10 Hz", "1 of 2 is lost.", "Look at it.", worst_first=(0,)),
            OneFinding("Binary 33 KB at 30 Hz", "1 of 2 is lost.", "Look at it.", worst_first=(2,)),
        ),
    )
    assert (loss_of_two.heading, busy.heading) == ("Loss (2)", "CPU saturated")
    assert busy.listed[0].where == "ping on pi"


def test_findings_that_are_not_listed_one_by_one_are_counted():
    (kind,) = Book(analysis_with(loss(0), loss(1, groups=(1, 2, 3, 4), count=33))).findings
    assert kind.heading == "Loss (34)"
    assert kind.listed[1].where.split(", such as ") == ["4 results", "Binary 33 KB at 20 Hz"]


def test_a_finding_links_to_its_groups_the_worst_first():
    analysis = make_analysis(
        Measured([MS, MS], rate_hz=10.0),
        Measured([3 * MS, 3 * MS], rate_hz=20.0),
        Measured([MS, "lost_return"], rate_hz=30.0),
        findings=[loss(0, groups=(0, 1, 2))],
    )
    (kind,) = Book(analysis).findings
    assert kind.listed[0].worst_first == (2, 1, 0), "losses first, then the slowest"


def test_a_finding_of_a_recording_keeps_its_name_and_links_to_its_groups():
    where = "ping on pi (ping.mcap); and 3 more"
    found = loss(0, where=where, groups=(4, 0, 1, 2), subject=Subject.RECORDING)
    (kind,) = Book(analysis_with(found)).findings
    (one,) = kind.listed
    assert one.where == where
    assert one.worst_first == (0, 1, 2, 4), "alike, so in the order of the table"


@pytest.mark.parametrize(
    ("groups", "where"),
    [((0, 1), "Binary 33 KB at 10 Hz; Binary 33 KB at 20 Hz"), ((0, 1, 2, 3, 4, 5), "all 6 results"), ((), "group 0")],
)
def test_where_is_made_from_what_tells_the_groups_apart(groups, where):
    (kind,) = Book(analysis_with(loss(0, groups=groups))).findings
    assert kind.listed[0].where == where


def test_actions_that_differ_are_not_said_for_all():
    same, differing = (
        Book(analysis_with(loss(0), loss(1, action=action))).findings[0] for action in ("Look at it.", "Leave it.")
    )
    assert (same.common_action, differing.common_action) == ("Look at it.", "")


def test_severities_are_counted_in_words_the_most_severe_first():
    kinds = Book(
        analysis_with(
            *(Finding(severity, f"code_{n}", "w", "x.", "y.") for n, severity in enumerate(Severity)), loss(0), loss(1)
        )
    ).findings
    assert severity_counts(kinds) == (("error", "1 error"), ("warning", "2 warnings"), ("info", "1 note"))


@pytest.mark.parametrize("kind", ["md", "terminal", "html"])
def test_every_report_has_a_kind_once_with_its_first_place_and_what_to_do(kind):
    text = load_reporter(kind).render(Book(analysis_with(loss(0), loss(1), loss(2)), shows_all=True))
    assert text.count("Look at it.") == 1
    plain = " ".join(re.sub("<[^>]+>", " ", text).split())
    assert f"warning Loss (3): {RESULT}: " in plain
    assert plain.count("1 of 2 is lost.") == (1 if kind == "terminal" else 1 + 3), "all open below the first"


def test_hostile_findings_are_one_kind():
    book = Book(EVERY_ANALYSIS["hostile strings"]())
    assert [kind.count for kind in book.findings] == [len(book.groups.groups)] == [6]
