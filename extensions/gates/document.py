"""A comparison for programs: the contents of `comparison.schema.json`, and for CI JUnit XML (its classes stay the same whatever else is compared),
annotations of a GitHub job, a badge."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any
from xml.etree import ElementTree as ET

import polars as pl

from dds_trace.analyzer.model.parameters import PARAMETER_NAMES
from dds_trace.base.printable import MAX_FINDING_CHARACTERS, printable

from .compare import Comparison
from .comparison_rows import DISTRIBUTION_LEVELS
from .gate import GateOutcome
from .info import ComparedGroup, ComparisonInfo
from .words import gate_interval_words, measured_words, why_words

FORMAT_VERSION = 1


def comparison_document(info: ComparisonInfo, comparison: Comparison) -> dict[str, object]:
    return {
        "format": FORMAT_VERSION,
        "said": info.said,
        "seen": info.seen,
        "changed": info.is_changed,
        "outcome": None if info.outcome is None else info.outcome.value,
        "options": asdict(comparison.options),
        "sights": info.sights,
        "groups": [_group(group) for group in info.groups],
        "only_base": _named(info.only_base, comparison.only_base),
        "only_new": _named(info.only_new, comparison.only_new),
        "gates": [
            {
                "gate": gated.result.gate.text,
                "group": gated.where,
                **{name: getattr(gated.result, column) for name, column in FRAME_COLUMNS.items()},
            }
            for gated in info.gates
        ],
        "judgements": comparison.frame(gated.result for gated in info.gates),
        "unlike": info.unlike,
        "ignore": info.ignore,
        "notes": info.notes,
        "rules": info.rules,
    }


def _group(group: ComparedGroup) -> dict[str, object]:
    return {
        "label": group.label,
        "parameters": _parameters(group.delivery),
        "verdict": group.verdict,
        "where": group.where,
        "delivery": _others(group.delivery),
        "changes": [
            {**_others(row), "base_is_lost": _is_lost(row["base_ns"]), "new_is_lost": _is_lost(row["new_ns"])}
            for row in group.changes
        ],
        "distributions": [
            {"metric": row["metric"], **{side: _curve(row[f"{side}_ns"]) for side in ("base", "new")}}
            for row in group.distributions
        ],
    }


def _curve(values_ns: list[float]) -> list[dict[str, float]]:
    levels = zip(DISTRIBUTION_LEVELS, values_ns, strict=False)
    return [{"level": level, "ns": value} for level, value in levels if math.isfinite(value)]


_GATE_FIELDS = ("outcome", "measured", "low", "high", "reason", "smallest_ratio", "smallest_drop")
FRAME_COLUMNS = {name: {"outcome": "verdict", "measured": "value"}.get(name, name) for name in _GATE_FIELDS}
"""Name in the format -> in the frame of judgements."""


def _named(labels: tuple[str, ...], groups: pl.DataFrame) -> list[dict[str, object]]:
    return [
        {"label": label, "parameters": _parameters(row)} for label, row in zip(labels, groups.to_dicts(), strict=True)
    ]


def _parameters(row: Mapping[str, Any]) -> dict[str, object]:
    return {name: row[name] for name in PARAMETER_NAMES if name in row}


def _others(row: Mapping[str, Any]) -> dict[str, object]:
    return {name: value for name, value in row.items() if name not in PARAMETER_NAMES}


def _is_lost(value_ns: float | None) -> bool:
    return value_ns is not None and math.isinf(value_ns)


def render_junit(info: ComparisonInfo) -> str:
    results = [gated.result for gated in info.gates]
    failed = sum(r.outcome is GateOutcome.REGRESSED for r in results)
    unsure = sum(r.outcome is GateOutcome.INCONCLUSIVE for r in results)
    counts = {"tests": str(len(results)), "failures": str(failed), "errors": "0", "skipped": str(unsure)}
    root = ET.Element("testsuites", counts)
    suite = ET.SubElement(root, "testsuite", {"name": "dds-trace compare", **counts, "time": "0"})
    for result in results:
        name = {
            "classname": printable(result.subject, MAX_FINDING_CHARACTERS),
            "name": printable(result.gate.text),
            "time": "0",
        }
        case = ET.SubElement(suite, "testcase", name)
        why = why_words(result)
        words = f"{measured_words(result, result.value)}, interval {gate_interval_words(result)}"
        words += f"; {printable(why)}" if why else ""
        if result.outcome is GateOutcome.REGRESSED:
            ET.SubElement(case, "failure", {"message": words, "type": "regression"})
        elif result.outcome is GateOutcome.INCONCLUSIVE:
            ET.SubElement(case, "skipped", {"message": f"{result.outcome.word}: {words}"})
    ET.SubElement(suite, "system-out").text = printable(f"{info.said} {info.seen}".strip(), MAX_FINDING_CHARACTERS)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


MOST_ANNOTATIONS = 10
"""What GitHub shows of a step."""

_COLORS = {GateOutcome.PASSED: "brightgreen", GateOutcome.REGRESSED: "red"}


def render_annotations(info: ComparisonInfo) -> str:
    kinds = {GateOutcome.REGRESSED: "error", GateOutcome.INCONCLUSIVE: "warning"}
    lines = []
    for gated in info.gates:
        kind, result = kinds.get(gated.result.outcome), gated.result
        if kind is not None:
            text = "; ".join(filter(None, (gated.where, measured_words(result, result.value), why_words(result))))
            title = _data(result.gate.text).replace(":", "%3A").replace(",", "%2C")
            lines.append(f"::{kind} title={title}::{_data(text)}")
    return "\n".join([*lines[: MOST_ANNOTATIONS - 1], f"::notice title=latency::{_data(info.said)}", ""])


def _data(text: str) -> str:
    return printable(text, MAX_FINDING_CHARACTERS).replace("%", "%25")


def render_badge(info: ComparisonInfo) -> str:
    words = "no gate" if info.outcome is None else info.outcome.word
    color = "lightgrey" if info.outcome is None else _COLORS.get(info.outcome, "yellow")
    return json.dumps({"schemaVersion": 1, "label": "latency", "message": words, "color": color}) + "\n"
