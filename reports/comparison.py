"""Comparison as text for CI: Markdown for a pull request, JUnit XML for a test report.

Strings from traces are escaped for the format, and control characters are spelled out.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET  # written, never parsed

import polars as pl

from dds_trace.analyzer.model.names import group_words
from dds_trace.analyzer.statistics.intervals import RUNS_TO_TELL
from dds_trace.analyzer.verdicts.compare import FAMILY
from dds_trace.analyzer.verdicts.gate import Against, GateOutcome
from dds_trace.analyzer.verdicts.gates import FAMILY as GATE_FAMILY
from dds_trace.analyzer.verdicts.gates import overall_outcome, varying_columns
from dds_trace.analyzer.verdicts.sides import UNKNOWN
from dds_trace.tracefile.units.counts import counted
from dds_trace.tracefile.units.durations import format_ms
from dds_trace.tracefile.visible import MAX_FINDING_CHARACTERS, visible

from .changes import episodes_words, received_words, runs_words
from .text import markdown

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from dds_trace.analyzer.verdicts.compare import Comparison
    from dds_trace.analyzer.verdicts.gates import GateResult


def comparison_markdown(comparison: Comparison, results: Sequence[GateResult] = ()) -> str:
    """Return the comparison as Markdown: outcome of the gates, table of verdicts, groups without a partner."""
    lines = ["# Comparison of latency", "", f"**{markdown(comparison_sentence(comparison))}**", ""]
    if results:
        lines += [f"**{overall_outcome(results).value.capitalize()}**", ""]
        lines += ["| gate | group | measured | interval | outcome | why |", "|---|---|---:|---:|---|---|"]
        lines += [
            f"| {markdown(r.gate.text)} | {markdown(r.where)} | {_measured(r, r.measured)} "
            f"| {_interval(_measured(r, r.low), _measured(r, r.high))} | {r.outcome.value} | {markdown(_why(r))} |"
            for r in results
        ]
        lines += ["", f"Gates are adjusted for the number of groups ({GATE_FAMILY}).", ""]
    if not comparison.rows.is_empty():
        names = varying_columns(comparison)
        environments = environments_of_rows(comparison)
        further = (" environment |", "---|") if environments else ("", "")
        lines += [
            "| group | metric | base | new | received | change | interval | new is below base | runs | found from | verdict |"
            + further[0],
            "|---|---|---:|---:|---:|---:|---:|---:|---|---:|---|" + further[1],
        ]
        rows = [_markdown_row(row, names) for row in comparison.rows.iter_rows(named=True)]
        lines += (
            [f"{row} {markdown(environments[n])} |" for n, row in enumerate(rows)] if environments else rows
        )
        lines += ["", *_explanations(comparison), ""]
    lines += [f"- {markdown(note)}" for note in comparison_notes(comparison)]
    if comparison_notes(comparison):
        lines.append("")
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


def comparison_sentence(comparison: Comparison) -> str:
    """Say in one sentence what became slower or loses more, or which changes would not have been seen.

    Sides without a group in common are told by the columns in which they differ.
    """
    rows, delivery = comparison.rows, comparison.delivery
    if delivery.is_empty():
        return f"The two sides have no group in common: there is nothing to compare{_unlike_columns(comparison)}."
    names = varying_columns(comparison)
    groups = counted(delivery.height, "group")
    said = []
    losing = delivery.filter(pl.col("verdict") == "worse").sort("difference")
    if not losing.is_empty():
        worst = losing.row(0, named=True)
        where = f", most in {group_words(worst, names)}" if delivery.height > 1 else ""
        said.append(f"more is lost in {losing.height} of {groups}{where} ({received_words(worst)})")
    slower = rows.filter(pl.col("verdict") == "worse").sort("ratio", descending=True, nulls_last=True)
    if slower.is_empty():
        said.append(_unseen(rows, groups))
    else:
        worst = slower.row(0, named=True)
        where = f" in {group_words(worst, names)}" if delivery.height > 1 else ""
        change = _percent(None if worst["ratio"] is None else worst["ratio"] - 1)
        count = slower.select(comparison.options.match).n_unique()
        said.append(
            f"slower in {count} of {groups}, most the {worst['statistic']} of the {worst['metric']}{where}: {change}"
        )
    sentence = "; ".join(said)
    return f"{sentence[0].upper()}{sentence[1:]}."


def _unseen(rows: pl.DataFrame, groups: str) -> str:
    """Say that nothing is shown, and below which size it would not have been, where that is largest; or that nobody can tell."""
    known = rows["smallest_ratio"].drop_nulls()
    if known.is_empty():
        return f"what changed in {groups} cannot be told: it takes {RUNS_TO_TELL} runs a side"
    seen = f"nothing is shown to be slower in {groups}; changes below {_percent(float(str(known.max())) - 1).removeprefix('+')} would not be seen"
    untold = rows.height - len(known)
    return f"{seen}, and {untold} of {counted(rows.height, 'row')} cannot tell" if untold else seen


def _unlike_columns(comparison: Comparison) -> str:
    """Name the match columns in which no group of one side agrees with any of the other, with their values."""
    sides = comparison.only_base, comparison.only_new
    if any(side.is_empty() for side in sides):
        return ""
    unlike = []
    for column in sides[0].columns:
        base, new = ({str(value) for value in side[column].to_list()} for side in sides)
        if not base & new:
            unlike.append(f"{column} ({' or '.join(sorted(base))} against {' or '.join(sorted(new))})")
    return f"; they differ in {', '.join(unlike)}" if unlike else ""


def _explanations(comparison: Comparison) -> list[str]:
    share = f"{comparison.options.confidence:.0%}"
    within = f"{comparison.options.same_within:.0%}"
    return [
        (
            f"Change and interval ({share}) are of new / base; 'same' is an interval wholly within {within}. A lost message is "
            "infinitely late; 'survivors' is the figure of those that came back."
        ),
        (
            f"The run is the unit: with fewer than {RUNS_TO_TELL} runs a side the interval holds within one run and the verdict is "
            f"inconclusive. {family_words(gated=False)}"
        ),
        "'Found from': the smallest change that these runs would have found with a probability of 80%.",
        "'New is below base': how often a message of the new side takes less than one of the base; 50% is no difference.",
    ]


def family_words(*, gated: bool) -> str:
    """Return how verdicts, and with `gated` the gates, are adjusted for the number of groups."""
    verdicts = f"Verdicts are adjusted for the number of groups ({FAMILY})"
    return f"{verdicts}, gates by {GATE_FAMILY}." if gated else f"{verdicts}."


def comparison_notes(comparison: Comparison) -> list[str]:
    """Return what makes the sides unlike or unfit: what was asked for, environments, order in time, and findings of severity error."""
    return [
        *(f"Measured in turns: {visible(text, MAX_FINDING_CHARACTERS)}" for text in comparison.asked),
        *(f"Unlike environments: {visible(text, MAX_FINDING_CHARACTERS)}" for text in comparison.environment),
        *([f"Order: {comparison.order}"] if comparison.order else []),
        *(
            f"Finding of severity error: {visible(error.text, MAX_FINDING_CHARACTERS)}"
            for error in comparison.errors
        ),
    ]


def environments_of_rows(comparison: Comparison) -> list[str]:
    """Return for each row of a comparison whether the sides' environments are alike; empty if nothing is known of any."""
    match = comparison.options.match
    of_group = {
        tuple(row[name] for name in match): row["environment"]
        for row in comparison.delivery.iter_rows(named=True)
    }
    if set(of_group.values()) <= {UNKNOWN}:
        return []
    return [of_group[row] for row in comparison.rows.select(match).iter_rows()]


def result_line(result: GateResult) -> str:
    """Return the outcome of a gate for one group in one line."""
    why = _why(result)
    where = visible(result.where, MAX_FINDING_CHARACTERS)
    return f"{result.outcome.value}: {result.gate.text} ({where})" + (f": {visible(why)}" if why else "")


def _why(result: GateResult) -> str:
    """Return the reason of a result, with the smallest change that could have been found."""
    found = ""
    if result.smallest_ratio is not None:
        found = f"changes from {result.smallest_ratio - 1:+.1%} on are found at 80% power"
    elif result.smallest_drop is not None:
        found = f"drops from {100 * result.smallest_drop:.2f} points on are found at 80% power"
    return "; ".join(text for text in (result.reason, found) if text)


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
        why = _why(result)
        said += f"; {visible(why)}" if why else ""
        if result.outcome is GateOutcome.REGRESSED:
            ET.SubElement(case, "failure", {"message": said, "type": "regression"})
        elif result.outcome is GateOutcome.INCONCLUSIVE:
            ET.SubElement(case, "skipped", {"message": f"inconclusive: {said}"})
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _markdown_row(row: dict[str, Any], names: Sequence[str]) -> str:
    change = None if row["ratio"] is None else row["ratio"] - 1
    ends = [None if row[end] is None else row[end] - 1 for end in ("ratio_low", "ratio_high")]
    below = "" if row["superiority"] is None else f"{row['superiority']:.0%}"
    smallest = "" if row["smallest_ratio"] is None else _percent(row["smallest_ratio"] - 1)
    cells = (
        markdown(group_words(row, names)),
        f"{row['metric']} {row['statistic']}",
        _with_survivors(row, "base"),
        _with_survivors(row, "new"),
        received_words(row),
        _percent(change),
        _interval(*map(_percent, ends)),
        below,
        runs_words(row),
        smallest,
        row["verdict"],
    )
    return f"| {' | '.join(cells)} |"


def _with_survivors(row: Mapping[str, Any], side: str) -> str:
    """Write the time of a side, beside a lost one that of the survivors, and of a tail the episodes it rests on."""
    value_ns, survivors_ns = row[f"{side}_ns"], row[f"{side}_survivors_ns"]
    said = _ms(value_ns)
    if value_ns is not None and math.isinf(value_ns) and survivors_ns is not None:
        said += f" (survivors {_ms(survivors_ns)})"
    episodes = episodes_words(row, side)
    return f"{said} ({episodes})" if episodes else said


def _measured(result: GateResult, value: float | None) -> str:
    if value is None:
        return "unknown"
    if result.gate.against is Against.RATIO:
        return _percent(value - 1)
    if result.gate.statistic:
        return _ms(value)
    return f"{value * 100:+.2f} points" if result.gate.against is Against.DIFFERENCE else f"{value:.2%}"


def _ms(value_ns: float | None) -> str:
    if value_ns is None:
        return ""
    return "lost" if math.isinf(value_ns) else f"{format_ms(value_ns)} ms"


def _percent(share: float | None) -> str:
    if share is None:
        return "unknown"
    return "lost" if math.isinf(share) else f"{share:+.1%}"


def _interval(low: str, high: str) -> str:
    return f"{low} to {high}"
