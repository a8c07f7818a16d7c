"""The findings of an analysis, worst first."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

from ..model.finding import Finding, Severity
from . import (
    applied,
    calls,
    clocks,
    flows,
    groups,
    left_out,
    losses,
    runs,
    sending,
    sessions,
    shapes,
    sides,
    sources,
    surroundings,
    wire,
)
from .evidence import Check, Evidence

CHECKS: tuple[Check, ...] = (
    applied.settings_not_applied,
    surroundings.missing_loads,
    surroundings.late_links,
    sessions.recorder_drops,
    sessions.failed_bridges,
    sessions.failed_recordings,
    sessions.stopped_recordings,
    runs.forged_or_foreign,
    runs.runs_without_ping,
    runs.undescribed_runs,
    runs.undescribed_sessions,
    runs.too_many_relays,
    runs.runs_without_relay,
    runs.missing_relay_traces,
    runs.incomplete_relay_traces,
    runs.undescribed_relays,
    runs.gaps_of_relays,
    runs.runs_without_end,
    runs.stopped_runs,
    runs.missing_publications,
    runs.unpublished_runs,
    runs.unpublished_open_runs,
    runs.repeated_publications,
    runs.orphan_events,
    losses.nothing_received,
    losses.losses,
    losses.outages,
    losses.lost_connections,
    losses.late_relays,
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
    calls.calls_timed_out,
    flows.disturbed_flows,
    flows.slowed_results,
    flows.waiting_flows,
    flows.slow_discovery,
    flows.sharing_recorders,
    sides.overlapping_pings,
    sides.recorded_in_sequence,
    sides.unlike_versions,
    sides.wireless_on_one_machine,
    groups.mixed_labels,
    groups.unlike_group_environments,
    sessions.unlike_environments,
    sessions.unclosed_sessions,
    sessions.slow_disks,
    sessions.strangers,
    sessions.doubtful_sessions,
    clocks.suspends,
    clocks.clock_steps,
    clocks.slews,
    clocks.slow_slews,
    clocks.clock_drifts,
    clocks.cpu_saturation,
    clocks.coarse_clocks,
    applied.dropped_datagrams,
    applied.lost_fragments,
    applied.unsent_fragments,
    applied.several_networks,
    wire.incomplete_captures,
    wire.shared_counts,
    wire.messages_carried_twice,
    wire.lost_fragments,
    wire.retransmission_storms,
    wire.heartbeat_bound_recoveries,
    wire.discovery_traffic,
    shapes.falls_with_size,
    shapes.jumps_with_size,
    calls.calls,
    surroundings.loads,
    surroundings.replayed_links,
    groups.few_samples,
    sessions.missing_files,
    sources.skipped_traces,
    sources.skipped_files,
    sources.truncated_files,
    sources.unreadable_messages,
    sources.recovered_events,
    sources.copied_files,
    sources.overlapping_files,
    sources.reader_notes,
    left_out.sketched,
    left_out.stale_rows,
    left_out.groups_in_parts,
    left_out.cases_not_compared,
)
"""All checks, in the order in which findings of equal severity and effect are listed."""

_RANK = {severity: rank for rank, severity in enumerate(Severity)}

_MOST_LISTED = 20
"""Findings of one severity and code that are listed one by one."""


def find_findings(evidence: Evidence) -> tuple[Finding, ...]:
    kinds: dict[tuple[Severity, str], list[Finding]] = defaultdict(list)
    for check in CHECKS:
        kinds[check.severity, check.code] += check(evidence)
    listed = [finding for findings in kinds.values() for finding in _worst(findings)]
    return tuple(sorted(listed, key=lambda finding: (_RANK[finding.severity], -finding.effect)))


def _worst(findings: list[Finding]) -> list[Finding]:
    findings = sorted(findings, key=lambda finding: -finding.effect)
    others = findings[_MOST_LISTED:]
    if len(others) <= 1:
        return findings
    first = others[0]
    rest = replace(
        first,
        where=f"{first.where}; and {len(others) - 1} more",
        what=f"{len(others)} more of this kind. {first.what}",
        groups=tuple(dict.fromkeys(group for finding in others for group in finding.groups)),
        count=len(others),
    )
    return [*findings[:_MOST_LISTED], rest]
