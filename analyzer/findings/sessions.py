"""Checks of the recording processes: events they dropped, how they ended, the environments they ran in."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from typing import TYPE_CHECKING

from dds_trace.base.units import counted, format_duration

from ..loading.campaign import part_of
from ..model.environment import FLEETING, flat_fields
from ..model.finding import Finding, Severity
from .evidence import some

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from dds_trace.tracefile.format.descriptions import Session

    from .evidence import Evidence

_OF_MIDDLEWARE = ("versions", "configuration", "settings")
"""Parts of the fingerprint that every middleware has differently; they are compared within one vendor."""

_PROMISED_NS = 1_000_000_000
"""With `--fsync` a power loss takes less than this (`chunk_seconds` of the recorder's destination)."""

_ERROR_CHARACTERS = 400
"""Longest part of an error that a finding repeats; our own have less."""

_BRIDGE_FAILURES = {"died": "ended by itself", "never_ready": "never carried a message"}


def recorder_drops(evidence: Evidence) -> Iterator[Finding]:
    """Report events that a recorder dropped: a message may seem lost that was not."""
    for session in evidence.campaign.sessions.values():
        if session.dropped_events:
            yield Finding(
                Severity.ERROR,
                "recorder_drops",
                evidence.session_name(session),
                f"The recorder dropped {counted(session.dropped_events, 'event')}; messages that it dropped count as lost.",
                "Do not trust losses here; record to a faster disk, at a lower rate or with a larger ring.",
                evidence.groups_of_sessions.get(session.session_id, ()),
            )


def stopped_recordings(evidence: Evidence) -> Iterator[Finding]:
    """Report relays that dropped events while their disk was short, and went on sending back."""
    for session in evidence.campaign.sessions.values():
        stopped = session.extra.get("stopped")
        if isinstance(stopped, str) and stopped:
            yield Finding(
                Severity.ERROR,
                "recording_stopped",
                evidence.session_name(session),
                f"The relay could not record all that it sent back: {_shortened(stopped)}.",
                "Messages of that time have no T3 and T4, and count as lost on the way out if they did not come back: make "
                "room and record again.",
                evidence.groups_of_sessions.get(session.session_id, ()),
            )


def missing_files(evidence: Evidence) -> Iterator[Finding]:
    """Report files of a rotating recording that are not here: deleted by `--keep`, or not copied."""
    parts: dict[int, dict[int, Session]] = defaultdict(dict)
    for trace in evidence.campaign.traces:
        for session in trace.sessions:
            if "part" in session.extra:
                parts[session.session_id][part_of(session)] = session
    for session_id, by_part in parts.items():
        last = max(by_part)
        missing = [str(part) for part in range(1, last) if part not in by_part]
        if by_part[last].extra.get("followed"):
            missing.append(f"those behind {last}")
        if missing:
            yield Finding(
                Severity.INFO,
                "missing_files",
                evidence.session_name(evidence.campaign.sessions[session_id]),
                f"Of the {last} files of this recording (--rotate) some are not here: {some(missing)}.",
                "Nothing to do, if no run of interest reaches into them; else copy them beside the others.",
            )


def unclosed_sessions(evidence: Evidence) -> Iterator[Finding]:
    """Report sessions without a clean end."""
    for session in evidence.campaign.sessions.values():
        if session.state != "closed":
            yield Finding(
                Severity.WARNING,
                "unclosed_session",
                evidence.session_name(session),
                "The recording has no clean end: it was killed, lost power, or still goes on; "
                "how many events it dropped is not known.",
                "Stop recordings with Ctrl-C or --duration and analyze again.",
                evidence.groups_of_sessions.get(session.session_id, ()),
            )


def slow_disks(evidence: Evidence) -> Iterator[Finding]:
    """Report recordings with `--fsync` whose disk kept them waiting for more than that promises."""
    for session in evidence.campaign.sessions.values():
        unsaved_ns = session.extra.get("longest_unsaved_ns")
        if isinstance(unsaved_ns, int) and unsaved_ns > _PROMISED_NS:
            yield Finding(
                Severity.INFO,
                "slow_to_disk",
                evidence.session_name(session),
                f"For {format_duration(unsaved_ns)} events were not on the disk, though --fsync was given: a power loss "
                "then would have taken more than the last second.",
                "Nothing is missing here; to be safe the next time, record to a faster disk, or put less load on the machine.",
                evidence.groups_of_sessions.get(session.session_id, ()),
            )


def doubtful_sessions(evidence: Evidence) -> Iterator[Finding]:
    """Report events that more than one session of a trace could have recorded."""
    doubts = defaultdict(list)
    for doubt in evidence.exchanges.doubts:
        doubts[doubt.role, doubt.candidates].append(doubt)
    for (role, candidates), runs in doubts.items():
        yield Finding(
            Severity.WARNING,
            "doubtful_session",
            some(evidence.session_name(evidence.campaign.sessions[c]) for c in candidates),
            f"{len(candidates)} {role} sessions could have recorded the events of {counted(len(runs), 'run')} (a restarted "
            "process, or traces merged into one file); each run was given the last session started before it.",
            "Keep each recording in its own file.",
        )


def unlike_environments(evidence: Evidence) -> Iterator[Finding]:
    """Report settings that differ between sessions whose numbers stand side by side in the report.

    Pings are compared with pings and relays with relays; versions, configuration and settings of the
    middleware only within one vendor.
    """
    held = {id(s): s for e in evidence.grouping.exchanges for s in (e.ping, e.relay) if s is not None}
    alike: dict[str, list[Session]] = defaultdict(list)
    of_vendor: dict[str, list[Session]] = defaultdict(list)
    for session in held.values():
        if session.host:
            alike[f"{session.role} sessions"].append(session)
            of_vendor[f"{session.vendor} {session.role} sessions"].append(session)
    for where, sessions in sorted(alike.items()):
        yield from _differences(where, [(s, _machine(s)) for s in sessions])
    for where, sessions in sorted(of_vendor.items()):
        described = [(s, _middleware(s)) for s in sessions]
        names = {name for _, fields in described for name in fields}
        # A setting made on one device only is a difference, too; an interface that only one device has is none.
        yield from _differences(where, [(s, dict.fromkeys(names) | fields) for s, fields in described])


def _machine(session: Session) -> dict[str, object]:
    parts = {k: v for k, v in session.host.items() if k not in (*_OF_MIDDLEWARE, *FLEETING)}
    return dict(flat_fields(parts))


def _middleware(session: Session) -> dict[str, object]:
    parts = {name: session.host.get(name, {}) for name in _OF_MIDDLEWARE}
    return {"rmw": session.rmw, **dict(flat_fields(parts))}


def _differences(where: str, described: list[tuple[Session, dict[str, object]]]) -> Iterator[Finding]:
    """Report each field in which the sessions that have it differ."""
    values: dict[str, dict[str, list[Session]]] = defaultdict(lambda: defaultdict(list))
    for session, fields in described:
        for name, value in fields.items():
            values[name][json.dumps(value, sort_keys=True)].append(session)
    for name, by_value in sorted(values.items()):
        if len(by_value) > 1:
            listed = some((f"{value} {_on_devices(of)}" for value, of in sorted(by_value.items())), 4)
            yield Finding(
                Severity.WARNING,
                "unlike_environments",
                where,
                f"{name} differs: {listed}.",
                "Compare numbers across these sessions with care, or record again under equal conditions.",
            )


def _on_devices(sessions: list[Session]) -> str:
    devices = Counter(session.device for session in sessions)
    return "on " + ", ".join(f"{device} ({n} sessions)" if n > 1 else device for device, n in devices.items())


def failed_bridges(evidence: Evidence) -> Iterator[Finding]:
    """Report bridges that ended by themselves, or never carried a message."""
    for session in evidence.campaign.sessions.values():
        bridge = session.extra.get("bridge")
        if isinstance(bridge, dict) and bridge.get("state") in _BRIDGE_FAILURES:
            failure = str(bridge.get("failure") or "it said nothing")
            yield Finding(
                Severity.ERROR,
                "bridge_failed",
                evidence.session_name(session),
                f"The bridge {bridge.get('bridge')} {_BRIDGE_FAILURES[bridge['state']]}: {failure.rstrip('.')}. "
                f"Its last words: {_last_words(bridge)}.",
                "Losses here are the bridge's: repeat the runs; its whole output is in the session of the trace.",
                evidence.groups_of_sessions.get(session.session_id, ()),
            )


def failed_recordings(evidence: Evidence) -> Iterator[Finding]:
    """Report recordings that an error ended before their plan, with the reason; `failed_bridges` tells of a bridge."""
    for session in evidence.campaign.sessions.values():
        error, bridge = session.extra.get("error"), session.extra.get("bridge")
        is_told = isinstance(bridge, dict) and bridge.get("state") in _BRIDGE_FAILURES
        if isinstance(error, str) and error and not is_told:
            yield Finding(
                Severity.ERROR,
                "ended_by_error",
                evidence.session_name(session),
                f"The run ended before its plan, or with nobody left to answer: {_shortened(error)}.",
                "Messages behind the failure count as lost: repeat the run.",
                evidence.groups_of_sessions.get(session.session_id, ()),
            )


def _shortened(error: str) -> str:
    return error[:_ERROR_CHARACTERS].rstrip(".")


def _last_words(bridge: Mapping[str, object]) -> str:
    """Return the last line of the log of a bridge and of each of its programs."""
    programs = bridge.get("programs")
    tails = [str(bridge.get("log_tail") or "")]
    if isinstance(programs, list):
        tails += [str(p.get("log_tail") or "") for p in programs if isinstance(p, dict)]
    lines = [line.strip() for tail in tails for line in tail.splitlines()[-1:] if line.strip()]
    return "; ".join(line[:200].rstrip(".") for line in lines) or "none"
