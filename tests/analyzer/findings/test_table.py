"""A finding is a function and a row of the table: a toy one reaches every report through that row alone."""

from __future__ import annotations

import json

import pytest
from trace_files import Message, write_pair

from dds_trace.analyzer.findings import table
from dds_trace.analyzer.model.finding import Finding, Severity
from dds_trace.analyzer.pipeline import analyze
from dds_trace.reports.reporters import REPORT_MODULES, render_report


def odd_counts(evidence):
    """Report groups with an odd number of messages."""
    for group, published in enumerate(evidence.summary.frame["published"]):
        if published % 2:
            yield Finding(
                Severity.WARNING,
                "odd_count",
                evidence.group_names[group],
                f"{published} messages cannot be halved.",
                "Send one message more.",
                (group,),
            )


@pytest.fixture
def analysis(tmp_path, monkeypatch):
    monkeypatch.setattr(table, "CHECKS", (*table.CHECKS, odd_counts))
    write_pair(tmp_path, [Message(s, t0=s, t1=s, t3=s + 10, t4=s + 20, t2=s + 30) for s in range(3)])
    return analyze(tmp_path)


def test_a_toy_finding_is_in_the_analysis(analysis):
    (finding,) = [finding for finding in analysis.findings if finding.code == "odd_count"]
    assert (finding.what, finding.groups) == ("3 messages cannot be halved.", (0,))


@pytest.mark.parametrize("kind", REPORT_MODULES)
def test_a_toy_finding_is_in_every_report(analysis, kind):
    report = render_report(analysis, kind)
    assert "messages cannot be halved" in report
    assert "Send one message more" in report
    if kind == "json":
        (finding,) = [f for f in json.loads(report)["findings"] if f["code"] == "odd_count"]
        assert (finding["severity"], finding["groups"]) == ("warning", [0])
