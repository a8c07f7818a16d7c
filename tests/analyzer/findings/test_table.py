import json
import re
from importlib import import_module
from pathlib import Path

import polars as pl
import pytest
from trace_files import Message, write_pair
from wording import numbers, report_as

from dds_trace.analyzer.findings import table
from dds_trace.analyzer.findings.evidence import warning
from dds_trace.analyzer.findings.rows import RESULTS
from dds_trace.analyzer.model.finding import Subject
from dds_trace.analyzer.pipeline import analyze
from dds_trace.reports.reporters import REPORT_MODULES


@warning("odd_count", Subject.RESULT, "Send {more} message more.")
def odd_counts(evidence):
    """A result has an odd number of messages."""  # the finding's title
    for group, published in enumerate(evidence.summary.frame["published"]):
        if published % 2:
            yield evidence.result(group, f"{published} messages cannot be halved.", more="one")


few_sent = RESULTS.note(
    "few_sent",
    "A result has fewer than ten messages",
    pl.col("published") < 10,
    "{published:# message was|messages were} sent, {received:share of {published}} received[, {lost_return} lost].",
    "Send {rate_hz:.0f} a second.",
    effect=1 / pl.col("published"),
)


@pytest.fixture
def analysis(tmp_path, monkeypatch):
    monkeypatch.setattr(table, "CHECKS", (*table.CHECKS, odd_counts, few_sent))
    write_pair(tmp_path, [Message(s, t0=s, t1=s, t3=s + 10, t4=s + 20, t2=s + 30) for s in range(3)])
    return analyze(tmp_path)


def test_a_toy_finding_is_in_the_analysis(analysis):
    (finding,) = [finding for finding in analysis.findings if finding.code == "odd_count"]
    assert (finding.what, finding.groups) == ("3 messages cannot be halved.", (0,))


def test_a_toy_rule_is_in_the_analysis(analysis):
    (finding,) = [finding for finding in analysis.findings if finding.code == "few_sent"]
    assert numbers(finding.what) == [3, 100]
    assert finding.what.endswith("% received.")
    assert (finding.action, finding.groups, finding.effect) == ("Send 10 a second.", (0,), 1 / 3)


@pytest.mark.parametrize("kind", REPORT_MODULES)
def test_a_toy_finding_is_in_every_report(analysis, kind):
    report = report_as(kind, analysis)
    assert "messages cannot be halved" in report
    assert "Send one message more" in report
    assert "messages were sent" in report
    if kind == "json":
        (finding,) = [f for f in json.loads(report)["findings"] if f["code"] == "odd_count"]
        assert (finding["severity"], finding["groups"]) == ("warning", [0])


def test_a_toy_finding_is_in_the_reference(monkeypatch):
    pytest.importorskip("sphinx")
    monkeypatch.syspath_prepend(Path(__file__).parents[3] / "docs")
    reference = import_module("generated.findings")
    monkeypatch.setattr(table, "CHECKS", (*table.CHECKS, odd_counts))
    text = reference.findings()
    assert f"### odd_count\n\n- **Warning**, about a {odd_counts.subject.value}: {odd_counts.title}." in text
    assert "Send … message more." in text
    assert set(re.findall("### (.*)", text)) == {check.code for check in table.all_checks()}


@pytest.mark.parametrize("check", [*table.all_checks()], ids=lambda check: f"{check.code}-{check.severity.value}")
def test_a_check_has_a_short_title_and_says_what_to_do(check):
    assert re.fullmatch("[a-z]+(_[a-z]+)*", check.code)
    assert check.title[0].isupper() or check.title.startswith("--")
    assert not check.title.endswith(".")
    assert len(check.title) <= 72
    assert check.action.endswith(".")
