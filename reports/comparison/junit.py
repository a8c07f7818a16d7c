"""The gates of a comparison as JUnit XML, with classes that stay the same whatever else is compared."""

from __future__ import annotations

from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET  # written, never parsed

from dds_trace.analyzer.verdicts.gate import GateOutcome
from dds_trace.base.printable import MAX_FINDING_CHARACTERS, printable

from .words import gate_interval_words, measured_words, why_words

if TYPE_CHECKING:
    from .info import ComparisonInfo


def render(info: ComparisonInfo) -> str:
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
