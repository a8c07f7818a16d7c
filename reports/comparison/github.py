"""The outcome of gates as annotations of a GitHub job, and as a badge."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from dds_trace.analyzer.verdicts.gate import GateOutcome
from dds_trace.base.printable import MAX_FINDING_CHARACTERS, printable

from .words import measured_words, why_words

if TYPE_CHECKING:
    from .info import ComparisonInfo

MOST_ANNOTATIONS = 10
"""What GitHub shows of a step."""

_COLORS = {GateOutcome.PASSED: "brightgreen", GateOutcome.REGRESSED: "red"}


def render(info: ComparisonInfo) -> str:
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
    """Escape a text as GitHub's commands need it."""
    return printable(text, MAX_FINDING_CHARACTERS).replace("%", "%25")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")


def render_badge(info: ComparisonInfo) -> str:
    """Return the outcome as an endpoint of shields.io."""
    words = "no gate" if info.outcome is None else info.outcome.value
    color = "lightgrey" if info.outcome is None else _COLORS.get(info.outcome, "yellow")
    return json.dumps({"schemaVersion": 1, "label": "latency", "message": words, "color": color}) + "\n"
