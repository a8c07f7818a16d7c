"""The findings: everything doubtful in an analysis, most severe first.

One table of checks; each yields findings with severity, code, where, what, and what to do. A new check is a
function in `analyzer/checks/` and a line here.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from typing import TYPE_CHECKING

from ..model.finding import Finding, Severity
from . import clocks, groups, runs, sessions, sizes, sources
from . import host_load as load

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from .evidence import Evidence

    Check = Callable[[Evidence], Iterator[Finding]]

CHECKS: tuple[Check, ...] = (
    sessions.recorder_drops,
    sessions.failed_bridges,
    runs.unplaced_events,
    runs.relays_without_trace,
    runs.gaps_of_relays,
    runs.unfinished_runs,
    runs.repeated_publications,
    runs.orphan_events,
    groups.losses,
    groups.outages,
    groups.waits_in_readers,
    runs.restarted_relays,
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
    clocks.suspends,
    clocks.clock_steps,
    clocks.clock_drifts,
    load.cpu_saturation,
    load.kernel_drops,
    sizes.unlike_sizes,
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

_OF_A_KIND = 20
"""Findings of one severity and code that are listed one by one; a campaign of 500 runs may well have 500."""


def find_findings(evidence: Evidence) -> tuple[Finding, ...]:
    """The findings of every check, most severe first; of many of a kind the first ones and how many more."""
    kinds: dict[tuple[Severity, str], list[Finding]] = defaultdict(list)
    for check in CHECKS:
        for finding in check(evidence):
            kinds[finding.severity, finding.code].append(finding)
    listed = [finding for found in kinds.values() for finding in _first_ones(found)]
    return tuple(sorted(listed, key=lambda finding: _RANK[finding.severity]))


def _first_ones(found: list[Finding]) -> list[Finding]:
    more = len(found) - _OF_A_KIND
    if more <= 1:
        return found
    last, left = found[_OF_A_KIND], found[_OF_A_KIND:]
    rest = replace(
        last,
        where=f"{last.where}; and {more - 1} more",
        what=f"{more} more of this kind. {last.what}",
        groups=tuple(dict.fromkeys(group for finding in left for group in finding.groups)),
        count=more,
    )
    return [*found[:_OF_A_KIND], rest]
