"""Which session recorded the events of a run: the named one, else one of the traces with the events."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..clocks.boots import session_of_run

if TYPE_CHECKING:
    from dds_trace.tracefile.format.descriptions import Run, Session

    from ..loading.campaign import Campaign


@dataclass(frozen=True, slots=True)
class Doubt:
    """Several sessions could have made these events; the last one started before them was taken."""

    role: str
    run_id: int
    relay_id: int
    candidates: tuple[int, ...]


def find_ping_session(
    campaign: Campaign, run: Run, traces: set[int], first_ns: int, doubts: list[Doubt]
) -> Session | None:
    """Return the session that the run names, else the ping session of the traces with the run.

    Several candidates become a `Doubt`; `traces` have publications of the run, the first at `first_ns`.
    """
    named = campaign.sessions.get(session_of_run(run))
    if named is not None:
        return named
    candidates = _sessions_in(campaign, traces.union(campaign.run_traces[run.run_id]), "ping")
    if len(candidates) > 1:
        doubts.append(Doubt("ping", run.run_id, 0, tuple(s.session_id for s in candidates)))
    return _last_started_before(candidates, first_ns)


def find_relay_session(
    campaign: Campaign, run_id: int, relay_id: int, traces: set[int], first_ns: int, doubts: list[Doubt]
) -> Session | None:
    """Return the session of the relay in the traces with its events, else any with its relay_id.

    Several candidates become a `Doubt`; `traces` have T3 or T4, the first at `first_ns`.
    """
    if not traces:
        same_relay = [s for s in campaign.sessions.values() if s.role == "relay" and s.relay_id == relay_id]
        return max(same_relay, key=lambda session: session.wall_anchor_ns, default=None)
    there = _sessions_in(campaign, traces, "relay")
    candidates = [s for s in there if s.relay_id == relay_id] or [s for s in there if s.relay_id is None]
    if len(candidates) > 1:
        doubts.append(Doubt("relay", run_id, relay_id, tuple(s.session_id for s in candidates)))
    return _last_started_before(candidates, first_ns)


def _sessions_in(campaign: Campaign, traces: set[int], role: str) -> list[Session]:
    described = {session.session_id for trace in traces for session in campaign.traces[trace].sessions}
    named = [session for session in (campaign.sessions[session_id] for session_id in described) if session.role == role]
    return sorted(named, key=lambda session: (session.wall_anchor_ns, session.session_id))


def _last_started_before(candidates: list[Session], first_ns: int) -> Session | None:
    if not candidates:
        return None
    before = [session for session in candidates if session.monotonic_anchor_ns <= first_ns]
    return (before or candidates[:1])[-1]
