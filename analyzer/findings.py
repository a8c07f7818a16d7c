"""The findings: everything doubtful in an analysis, most severe first.

One table of checks; each yields findings with severity, code, where, what, and what to do. A new check is a
function in `analyzer/checks/` and a line here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from analyzer.analysis import Finding, Severity
from analyzer.checks import groups, runs, sessions, sources

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from analyzer.evidence import Evidence

    Check = Callable[[Evidence], Iterator[Finding]]

CHECKS: tuple[Check, ...] = (
    sessions.recorder_drops,
    runs.unplaced_events,
    runs.relays_without_trace,
    runs.gaps_of_relays,
    runs.unfinished_runs,
    runs.repeated_publications,
    runs.orphan_events,
    groups.losses,
    groups.unmeasured_groups,
    groups.impossible_times,
    groups.duplicates,
    groups.reordering,
    runs.schedule_not_held,
    runs.missing_schedule,
    runs.unlike_domains,
    runs.unlike_payloads,
    groups.mixed_labels,
    sessions.unlike_environments,
    sessions.unclosed_sessions,
    sessions.doubtful_sessions,
    groups.few_samples,
    sources.skipped_files,
    sources.truncated_files,
    sources.unreadable_messages,
    sources.rescued_events,
    sources.copied_files,
    sources.reader_notes,
)
"""In the order in which findings of equal severity are listed."""

_RANK = {severity: rank for rank, severity in enumerate(Severity)}


def find_findings(evidence: Evidence) -> tuple[Finding, ...]:
    """The findings of every check, most severe first."""
    found = [finding for check in CHECKS for finding in check(evidence)]
    return tuple(sorted(found, key=lambda finding: _RANK[finding.severity]))
