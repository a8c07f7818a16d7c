"""The outcome of gates for CI: JUnit XML (its classes stay the same whatever else is compared), annotations of a GitHub job, a badge."""

from __future__ import annotations

import json
from xml.etree import ElementTree as ET

from dds_trace.analyzer.verdicts.gate import GateOutcome
from dds_trace.base.printable import MAX_FINDING_CHARACTERS, printable

from .info import ComparisonInfo
from .words import gate_interval_words, measured_words, why_words


def render_junit(info: ComparisonInfo) -> str:
    """Return one test case per gate and result; an inconclusive one is skipped."""
    results = [gated.result for gated in info.gates]
    failed = sum(r.outcome is GateOutcome.REGRESSED for r in results)
    unsure = sum(r.outcome is GateOutcome.INCONCLUSIVE for r in results)
    counts = {"tests": str(len(results)), "failures": str(failed), "errors": "0", "skipped": str(unsure)}
    root = ET.Element("testsuites", counts)
    suite = ET.SubElement(root, "testsuite", {"name": "dds-analyze compare", **counts, "time": "0"})
    for result in results:
        name = {
            "classname": printable(result.where, MAX_FINDING_CHARACTERS),
            "name": printable(result.gate.text),
            "time": "0",
        }
        case = ET.SubElement(suite, "testcase", name)
        why = why_words(result)
        words = f"{measured_words(result, result.measured)}, interval {gate_interval_words(result)}"
        words += f"; {printable(why)}" if why else ""
        if result.outcome is GateOutcome.REGRESSED:
            ET.SubElement(case, "failure", {"message": words, "type": "regression"})
        elif result.outcome is GateOutcome.INCONCLUSIVE:
            ET.SubElement(case, "skipped", {"message": f"inconclusive: {words}"})
    ET.SubElement(suite, "system-out").text = printable(f"{info.said} {info.seen}".strip(), MAX_FINDING_CHARACTERS)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


MOST_ANNOTATIONS = 10
"""What GitHub shows of a step."""

_COLORS = {GateOutcome.PASSED: "brightgreen", GateOutcome.REGRESSED: "red"}


def render_annotations(info: ComparisonInfo) -> str:
    """Return an error for each regressed gate and a warning for each inconclusive one, then the answer as a notice."""
    kinds = {GateOutcome.REGRESSED: "error", GateOutcome.INCONCLUSIVE: "warning"}
    lines = []
    for gated in info.gates:
        kind, result = kinds.get(gated.result.outcome), gated.result
        if kind is not None:
            text = "; ".join(filter(None, (gated.where, measured_words(result, result.measured), why_words(result))))
            lines.append(f"::{kind} title={_property(result.gate.text)}::{_data(text)}")
    return "\n".join([*lines[: MOST_ANNOTATIONS - 1], f"::notice title=latency::{_data(info.said)}", ""])


def _data(text: str) -> str:
    return printable(text, MAX_FINDING_CHARACTERS).replace("%", "%25")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")


def render_badge(info: ComparisonInfo) -> str:
    words = "no gate" if info.outcome is None else info.outcome.value
    color = "lightgrey" if info.outcome is None else _COLORS.get(info.outcome, "yellow")
    return json.dumps({"schemaVersion": 1, "label": "latency", "message": words, "color": color}) + "\n"
