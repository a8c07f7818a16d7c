"""Comparison as text for CI: Markdown for a pull request, JUnit XML for a test report.

Strings from traces are escaped for the format, and control characters are spelled out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET  # written, never parsed

from dds_trace.analyzer.model.names import group_words
from dds_trace.analyzer.verdicts.gates import (
    Against,
    GateOutcome,
    overall_outcome,
    varying_columns,
)
from dds_trace.tracefile.units.durations import format_ms
from dds_trace.tracefile.visible import MAX_FINDING_CHARACTERS, visible

from .text import markdown

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dds_trace.analyzer.verdicts.compare import Comparison
    from dds_trace.analyzer.verdicts.gates import GateResult


def comparison_markdown(comparison: Comparison, results: Sequence[GateResult] = ()) -> str:
    """Return the comparison as Markdown: outcome of the gates, table of verdicts, groups without a partner."""
    lines = ["# Comparison of latency", ""]
    if results:
        lines += [f"**{overall_outcome(results).value.capitalize()}**", ""]
        lines += ["| gate | group | measured | interval | outcome |", "|---|---|---:|---:|---|"]
        lines += [
            f"| {markdown(r.gate.text)} | {markdown(r.where)} | {_measured(r, r.measured)} "
            f"| {_interval(_measured(r, r.low), _measured(r, r.high))} | {r.outcome.value} |"
            for r in results
        ]
        lines.append("")
    if comparison.rows.is_empty():
        lines += ["The two sides have no group in common: there is nothing to compare.", ""]
    else:
        names = varying_columns(comparison)
        lines += [
            "| group | metric | base | new | change | interval | new is faster | verdict |",
            "|---|---|---:|---:|---:|---:|---:|---|",
        ]
        lines += [_markdown_row(row, names) for row in comparison.rows.iter_rows(named=True)]
        share = f"{comparison.options.confidence:.0%}"
        within = f"{comparison.options.same_within:.0%}"
        lines += [
            "",
            f"Change and interval ({share}) are of new / base; 'same' is an interval wholly within {within}.",
            "'New is faster': how often a message of the new side is faster than one of the base; 50% is no difference.",
            "",
        ]
    for title, groups in (
        ("Only in the base", comparison.only_base),
        ("Only in the new", comparison.only_new),
    ):
        if not groups.is_empty():
            lines += [f"{title}:", ""]
            lines += [
                f"- {markdown(group_words(row, groups.columns))}" for row in groups.iter_rows(named=True)
            ]
            lines.append("")
    return "\n".join(lines)


def comparison_junit(results: Sequence[GateResult]) -> str:
    """Return the gates as JUnit XML: one test case per gate and group; an inconclusive one is skipped."""
    failed = sum(r.outcome is GateOutcome.REGRESSED for r in results)
    unsure = sum(r.outcome is GateOutcome.INCONCLUSIVE for r in results)
    counts = {"tests": str(len(results)), "failures": str(failed), "errors": "0", "skipped": str(unsure)}
    root = ET.Element("testsuites", counts)
    suite = ET.SubElement(root, "testsuite", {"name": "dds-analyze compare", **counts, "time": "0"})
    for result in results:
        name = {
            "classname": visible(result.where, MAX_FINDING_CHARACTERS),
            "name": visible(result.gate.text),
            "time": "0",
        }
        case = ET.SubElement(suite, "testcase", name)
        said = (
            f"{_measured(result, result.measured)}, interval "
            f"{_interval(_measured(result, result.low), _measured(result, result.high))}"
        )
        if result.outcome is GateOutcome.REGRESSED:
            ET.SubElement(case, "failure", {"message": said, "type": "regression"})
        elif result.outcome is GateOutcome.INCONCLUSIVE:
            ET.SubElement(case, "skipped", {"message": f"inconclusive: {said}"})
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _markdown_row(row: dict[str, Any], names: Sequence[str]) -> str:
    change = None if row["ratio"] is None else row["ratio"] - 1
    ends = [None if row[end] is None else row[end] - 1 for end in ("ratio_low", "ratio_high")]
    faster = "" if row["superiority"] is None else f"{row['superiority']:.0%}"
    return (
        f"| {markdown(group_words(row, names))} | {row['metric']} {row['statistic']} | {_ms(row['base_ns'])} "
        f"| {_ms(row['new_ns'])} | {_percent(change)} | {_interval(*map(_percent, ends))} | {faster} | {row['verdict']} |"
    )


def _measured(result: GateResult, value: float | None) -> str:
    if value is None:
        return "unknown"
    if result.gate.against is Against.RATIO:
        return _percent(value - 1)
    return _ms(value) if result.gate.statistic else f"{value:.2%}"


def _ms(value_ns: float | None) -> str:
    return "" if value_ns is None else f"{format_ms(value_ns)} ms"


def _percent(share: float | None) -> str:
    return "unknown" if share is None else f"{share:+.1%}"


def _interval(low: str, high: str) -> str:
    return f"{low} to {high}"
