"""The findings: everything doubtful in an analysis, worst first.

A check is a function that looks at the evidence and yields findings. A new check is a function in a file of this
folder and a row of `CHECKS`; analysis, reports and JSON follow from that.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from typing import TYPE_CHECKING

from ..model.finding import Finding, Severity
from . import (
    applied,
    clocks,
    groups,
    left_out,
    runs,
    sending,
    sessions,
    shapes,
    sides,
    sources,
    wire,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from .evidence import Evidence

    Check = Callable[[Evidence], Iterator[Finding]]

CHECKS: tuple[Check, ...] = (
    applied.settings_not_applied,
    sessions.recorder_drops,
    sessions.failed_bridges,
    sessions.failed_recordings,
    sessions.stopped_recordings,
    runs.unplaced_events,
    runs.relays_without_trace,
    runs.gaps_of_relays,
    runs.unfinished_runs,
    runs.unpublished_runs,
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
    sending.schedule_not_held,
    sending.stand_stills,
    sending.late_sends,
    runs.missing_schedule,
    runs.unlike_domains,
    runs.unlike_payloads,
    shapes.short_warm_up,
    shapes.rising_latency,
    shapes.two_modes,
    sides.overlapping_pings,
    sides.unlike_versions,
    sides.wireless_on_one_machine,
    groups.mixed_labels,
    groups.unlike_group_environments,
    sessions.unlike_environments,
    sessions.unclosed_sessions,
    sessions.slow_disks,
    sessions.doubtful_sessions,
    clocks.suspends,
    clocks.clock_steps,
    clocks.slews,
    clocks.clock_drifts,
    clocks.cpu_saturation,
    applied.dropped_datagrams,
    applied.lost_fragments,
    wire.incomplete_captures,
    wire.shared_counts,
    wire.lost_fragments,
    wire.retransmission_storms,
    wire.heartbeat_bound_recoveries,
    wire.discovery_traffic,
    shapes.unlike_sizes,
    groups.few_samples,
    sessions.missing_files,
    sources.skipped_files,
    sources.truncated_files,
    sources.unreadable_messages,
    sources.rescued_events,
    sources.copied_files,
    sources.reader_notes,
    left_out.sketched,
    left_out.stale_rows,
    left_out.groups_in_parts,
    left_out.cases_not_compared,
)
"""Every check, in the order in which findings of equal severity and effect are listed."""

_RANK = {severity: rank for rank, severity in enumerate(Severity)}

_OF_A_KIND = 20
"""Findings of one severity and code that are listed one by one; a campaign of 500 runs may well have 500 of a kind."""


def find_findings(evidence: Evidence) -> tuple[Finding, ...]:
    """Return the findings of every check, worst first: by severity, then by effect.

    Of many of a kind the worst ones and a count of the rest.
    """
    kinds: dict[tuple[Severity, str], list[Finding]] = defaultdict(list)
    for check in CHECKS:
        for finding in check(evidence):
            kinds[finding.severity, finding.code].append(finding)
    listed = [finding for of_kind in kinds.values() for finding in _worst_ones(of_kind)]
    return tuple(sorted(listed, key=lambda finding: (_RANK[finding.severity], -finding.effect)))


def _worst_ones(of_kind: list[Finding]) -> list[Finding]:
    """Return the worst findings of a kind, and one that stands for all others."""
    of_kind = sorted(of_kind, key=lambda finding: -finding.effect)
    more = len(of_kind) - _OF_A_KIND
    if more <= 1:
        return of_kind
    last, left = of_kind[_OF_A_KIND], of_kind[_OF_A_KIND:]
    rest = replace(
        last,
        where=f"{last.where}; and {more - 1} more",
        what=f"{more} more of this kind. {last.what}",
        groups=tuple(dict.fromkeys(group for finding in left for group in finding.groups)),
        count=more,
    )
    return [*of_kind[:_OF_A_KIND], rest]
