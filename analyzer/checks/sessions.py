"""Checks of the recording processes: what they could not keep, how they ended, on what they ran."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from typing import TYPE_CHECKING, Any

from analyzer.analysis import Finding, Severity
from analyzer.evidence import some

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from analyzer.evidence import Evidence
    from tracefile import Session

_OF_MIDDLEWARE = ("versions", "configuration", "settings")
"""Parts of the fingerprint that differ by nature between middlewares: compared within one vendor only."""

_FLEETING = ("wifi",)
"""Parts that differ from one minute to the next on the same device."""


def recorder_drops(evidence: Evidence) -> Iterator[Finding]:
    """Events that a recorder could not keep: then a message may seem lost, and it was not."""
    for session in evidence.campaign.sessions.values():
        if session.dropped_events:
            yield Finding(
                Severity.ERROR,
                "recorder_drops",
                evidence.session_name(session),
                f"The recorder dropped {session.dropped_events} events; messages that it dropped count as lost.",
                "Do not trust losses here; record to a faster disk, at a lower rate or with a larger ring.",
            )


def unclosed_sessions(evidence: Evidence) -> Iterator[Finding]:
    """Sessions without a clean end."""
    for session in evidence.campaign.sessions.values():
        if session.state != "closed":
            yield Finding(
                Severity.WARNING,
                "unclosed_session",
                evidence.session_name(session),
                "The recording has no clean end: it was killed, lost power, or still goes on; "
                "how many events it dropped is not known.",
                "Stop recordings with Ctrl-C or --duration and analyze again.",
            )


def doubtful_sessions(evidence: Evidence) -> Iterator[Finding]:
    """Events that more than one session of a trace could have made."""
    doubts = defaultdict(list)
    for doubt in evidence.exchanges.doubts:
        doubts[doubt.role, doubt.candidates].append(doubt)
    for (role, candidates), runs in doubts.items():
        yield Finding(
            Severity.WARNING,
            "doubtful_session",
            some(evidence.session_name(evidence.campaign.sessions[c]) for c in candidates),
            f"{len(candidates)} {role} sessions could have recorded the events of {len(runs)} runs (a restarted "
            "process, or traces merged into one file); each run was given the last session started before it.",
            "Keep each recording in its own file.",
        )


def unlike_environments(evidence: Evidence) -> Iterator[Finding]:
    """Settings that differ between sessions whose numbers stand side by side in the report.

    Pings are compared with pings and relays with relays; versions, configuration and settings of the
    middleware only within one vendor.
    """
    sessions = {id(s): s for e in evidence.roundtrips.exchanges for s in (e.ping, e.relay) if s is not None}
    values: dict[tuple[str, str, str], dict[str, list[Session]]] = defaultdict(lambda: defaultdict(list))
    for session in sessions.values():
        fields = {"rmw": session.rmw, **dict(_flattened(session.host))} if session.host else {}
        for name, value in fields.items():
            part = name.split(".", 1)[0]
            if part in _FLEETING:
                continue
            vendor = session.vendor if part in (*_OF_MIDDLEWARE, "rmw") else ""
            values[session.role, vendor, name][json.dumps(value, sort_keys=True)].append(session)
    for (role, vendor, name), found in sorted(values.items()):
        if len(found) > 1:
            yield Finding(
                Severity.WARNING,
                "unlike_environments",
                f"{vendor} {role} sessions".strip(),
                f"{name} differs: "
                + some((f"{value} {_on_devices(of)}" for value, of in sorted(found.items())), 4)
                + ".",
                "Compare numbers across these sessions with care, or record again under equal conditions.",
            )


def _flattened(host: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Leaves of a nested object by dotted name."""
    for key, value in host.items():
        if isinstance(value, dict):
            yield from _flattened(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _on_devices(sessions: list[Session]) -> str:
    devices = Counter(session.device for session in sessions)
    return "on " + ", ".join(f"{device} ({n} sessions)" if n > 1 else device for device, n in devices.items())
