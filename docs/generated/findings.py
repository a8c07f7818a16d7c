"""The reference of findings, from the records of the checks."""

from __future__ import annotations

import re
from collections import defaultdict
from typing import TYPE_CHECKING

from dds_trace.analyzer.findings.table import all_checks
from dds_trace.analyzer.model.finding import Severity

from .markdown import escaped

if TYPE_CHECKING:
    from collections.abc import Iterator

    from dds_trace.analyzer.findings.evidence import Check


def findings() -> str:
    """Return a section for each code, the most severe first."""
    order = list(Severity)
    by_code: dict[str, list[Check]] = defaultdict(list)
    for check in sorted(all_checks(), key=lambda check: (order.index(check.severity), check.code)):
        by_code[check.code].append(check)
    return "\n".join(part for code, checks in by_code.items() for part in _section(code, checks))


def _section(code: str, checks: list[Check]) -> Iterator[str]:
    yield f"### {code}\n"
    for check in checks:
        subject = check.subject.value
        article = "an" if subject[0] in "aeiou" else "a"
        action = re.sub(r"\{\w+\}", "…", check.action)
        yield f"- **{check.severity.value.capitalize()}**, about {article} {subject}: {escaped(check.title)}."
        yield f"  **Do:** {escaped(action)}"
    yield ""
