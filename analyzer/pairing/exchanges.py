"""Who exchanged messages with whom, under which parameters: one `Exchange` per run and relay that took part."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from dds_trace.tracefile import EventColumns, Stage

from ..model.parameters import Parameters, parameters_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from dds_trace.tracefile import Run, Session

    from ..loading.campaign import Campaign
    from ..loading.events import Key, StageKey

NO_RELAY = 0

_REPLY_STAGES = (Stage.T2, Stage.T3, Stage.T4)
_RELAY_STAGES = (Stage.T3, Stage.T4)

# The ranges of the columns that hold a description's numbers.
_INT32 = (-(2**31), 2**31 - 1)
_UINT32 = (0, 2**32 - 1)
_UINT64 = (0, 2**64 - 1)


@dataclass(frozen=True, slots=True, eq=False)
class Exchange:
    """One run and one relay that took part in it, or no relay (`relay_id` 0 and no events).

    Attributes:
        run: what the ping says of the run.
        ping: the session that ran it.
        relay_id: the relay.
        relay: the relay's session; None without its trace.
        start_ns: the run's first T1, wall clock by the anchor of the ping.
        counts: events of T1, T2, T3 and T4 in all traces; copies count.
        t1: the run's publications; shared by all exchanges of the run. Like the next three, empty in what goes
            through the whole analysis: events are there only while the exchange's batch is worked at.
        t2: replies that name run and relay.
        t3: arrivals at the relay.
        t4: departures from the relay.
    """

    run: Run
    ping: Session
    relay_id: int
    relay: Session | None
    start_ns: int
    counts: tuple[int, int, int, int]
    t1: EventColumns = field(default_factory=EventColumns.empty)
    t2: EventColumns = field(default_factory=EventColumns.empty)
    t3: EventColumns = field(default_factory=EventColumns.empty)
    t4: EventColumns = field(default_factory=EventColumns.empty)

    @property
    def took_part(self) -> bool:
        """Whether there is a relay at all."""
        return sum(self.counts[1:]) > 0

    @property
    def relay_recorded(self) -> bool:
        """Whether the relay's own events are there."""
        return sum(self.counts[2:]) > 0

    def event_keys(self) -> tuple[StageKey, StageKey, StageKey, StageKey]:
        """What its events go by, T1 to T4."""
        run_id, relay_id = self.run.run_id, self.relay_id
        return (
            (Stage.T1, run_id, NO_RELAY),
            (Stage.T2, run_id, relay_id),
            (Stage.T3, run_id, relay_id),
            (Stage.T4, run_id, relay_id),
        )

    def with_events(self, events: Mapping[StageKey, EventColumns]) -> Exchange:
        """The same with its events; `events` has all of `event_keys`."""
        t1, t2, t3, t4 = (events[key] for key in self.event_keys())
        return replace(self, t1=t1, t2=t2, t3=t3, t4=t4)

    def without_events(self) -> Exchange:
        """The same without its events."""
        none = EventColumns.empty()
        return replace(self, t1=none, t2=none, t3=none, t4=none)

    def parameters(self) -> Parameters:
        """Return the key of its group."""
        return parameters_of(self.run, self.ping, self.relay)


@dataclass(frozen=True, slots=True)
class Unplaced:
    """Events that belong to no row.

    Attributes:
        reason: a key of `findings.UNPLACED`.
        run_id: the run that they name.
        relay_id: the relay that they name, 0 for none.
        events: how many.
        traces: positions of the traces that hold them.
        detail: what is wrong with the run's description, where that is the reason.
    """

    reason: str
    run_id: int
    relay_id: int
    events: int
    traces: tuple[int, ...]
    detail: str = ""


@dataclass(frozen=True, slots=True)
class Doubt:
    """More than one session could have made these events; the last one started before them was taken.

    Attributes:
        role: `ping` or `relay`.
        run_id: the run.
        relay_id: the relay, 0 where the ping is in doubt.
        candidates: session_ids.
    """

    role: str
    run_id: int
    relay_id: int
    candidates: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Exchanges:
    """All exchanges in the order of their rows (run by start, then relay), and what could not be placed."""

    held: tuple[Exchange, ...]
    unplaced: tuple[Unplaced, ...]
    doubts: tuple[Doubt, ...]


def find_exchanges(campaign: Campaign) -> Exchanges:
    """Bring runs, their ping's session and the relays that took part together."""
    held: list[Exchange] = []
    unplaced: list[Unplaced] = []
    doubts: list[Doubt] = []
    relays = _relays_by_run(campaign)
    published = campaign.events.of[Stage.T1]
    for run_id in sorted({run_id for run_id, _ in published} | set(relays)):
        key = (run_id, NO_RELAY)
        run = campaign.runs.get(run_id)
        if key not in published:
            unplaced += _of_relays("no_ping_trace", campaign, run_id, relays[run_id])
            continue
        traces = campaign.events.traces(Stage.T1, key)
        if run is None:
            events = len(campaign.events.columns(Stage.T1, key))
            unplaced.append(Unplaced("no_run_description", run_id, NO_RELAY, events, traces))
            continue
        ping = _ping_session(campaign, run, doubts)
        if ping is None:
            events = len(campaign.events.columns(Stage.T1, key))
            unplaced.append(Unplaced("no_ping_session", run_id, NO_RELAY, events, traces))
            continue
        start_ns = ping.wall_ns(campaign.events.first_ns(Stage.T1, key))
        for relay_id in sorted(relays.get(run_id, {NO_RELAY})):
            of_relay = (run_id, relay_id)
            relay = _relay_session(campaign, of_relay, doubts) if run_id in relays else None
            flaw = next(_flaws(run, ping, relay), "")
            if flaw:
                events = len(campaign.events.columns(Stage.T1, key))
                unplaced.append(Unplaced("impossible_description", run_id, relay_id, events, traces, flaw))
                continue
            t2, t3, t4 = (campaign.events.count(stage, of_relay) for stage in _REPLY_STAGES)
            t1 = campaign.events.count(Stage.T1, key)
            held.append(Exchange(run, ping, relay_id, relay, start_ns, (t1, t2, t3, t4)))
    return Exchanges(tuple(sorted(held, key=_start)), tuple(unplaced), tuple(doubts))


def _start(exchange: Exchange) -> tuple[int, int, int]:
    return exchange.start_ns, exchange.run.run_id, exchange.relay_id


def _relays_by_run(campaign: Campaign) -> dict[int, set[int]]:
    """Relays that any T2, T3 or T4 of each run names."""
    relays: dict[int, set[int]] = defaultdict(set)
    for stage in _REPLY_STAGES:
        for run_id, relay_id in campaign.events.of[stage]:
            relays[run_id].add(relay_id)
    return relays


def _of_relays(reason: str, campaign: Campaign, run_id: int, relays: Iterable[int]) -> Iterator[Unplaced]:
    for relay_id in sorted(relays):
        key = (run_id, relay_id)
        events = sum(len(campaign.events.columns(stage, key)) for stage in _REPLY_STAGES)
        traces = {trace for stage in _REPLY_STAGES for trace in campaign.events.traces(stage, key)}
        yield Unplaced(reason, run_id, relay_id, events, tuple(sorted(traces)))


def _ping_session(campaign: Campaign, run: Run, doubts: list[Doubt]) -> Session | None:
    """The session that the run names, else the ping session of the trace that holds it."""
    named = campaign.sessions.get(_hex(run.extra.get("session_id")))
    if named is not None:
        return named
    key = (run.run_id, NO_RELAY)
    traces = {*campaign.run_traces[run.run_id], *campaign.events.traces(Stage.T1, key)}
    candidates = _sessions_in(campaign, traces, "ping")
    if len(candidates) > 1:
        doubts.append(Doubt("ping", run.run_id, NO_RELAY, tuple(s.session_id for s in candidates)))
    return _last_started_before(candidates, campaign.events.first_ns(Stage.T1, key))


def _relay_session(campaign: Campaign, key: Key, doubts: list[Doubt]) -> Session | None:
    """The session of the relay in the traces that hold its events, else any that has its relay_id."""
    run_id, relay_id = key
    stages = [stage for stage in _RELAY_STAGES if campaign.events.parts(stage, key)]
    if not stages:
        same_relay = [s for s in campaign.sessions.values() if s.role == "relay" and s.relay_id == relay_id]
        return max(same_relay, key=lambda session: session.wall_anchor_ns, default=None)
    traces = {trace for stage in stages for trace in campaign.events.traces(stage, key)}
    there = _sessions_in(campaign, traces, "relay")
    candidates = [s for s in there if s.relay_id == relay_id] or [s for s in there if s.relay_id is None]
    if len(candidates) > 1:
        doubts.append(Doubt("relay", run_id, relay_id, tuple(s.session_id for s in candidates)))
    return _last_started_before(candidates, campaign.events.first_ns(stages[0], key))


def _sessions_in(campaign: Campaign, traces: set[int], role: str) -> list[Session]:
    """Sessions of a role in any of the traces, by start."""
    found = [
        session
        for session_id, session in campaign.sessions.items()
        if session.role == role and traces & set(campaign.session_traces[session_id])
    ]
    return sorted(found, key=lambda session: (session.wall_anchor_ns, session.session_id))


def _last_started_before(candidates: list[Session], first_ns: int) -> Session | None:
    if not candidates:
        return None
    before = [session for session in candidates if session.monotonic_anchor_ns <= first_ns]
    return (before or candidates[:1])[-1]


def _hex(text: object) -> int:
    try:
        return int(str(text), 16)
    except ValueError:
        return -1


def _flaws(run: Run, ping: Session, relay: Session | None) -> Iterator[str]:
    """Numbers of the descriptions that no column can hold."""
    ranges = (
        ("payload_bytes", run.payload_bytes, _UINT32),
        ("warmup_messages", run.warmup_messages, _UINT64),
        ("relay_domain_id", run.relay_domain_id or 0, _INT32),
        ("qos.depth", run.qos.depth, _INT32),
        ("domain_id of the ping", ping.domain_id, _INT32),
        ("domain_id of the relay", relay.domain_id if relay else 0, _INT32),
    )
    for name, value, (low, high) in ranges:
        if not low <= value <= high:
            yield f"{name} is {value}"
    if not (math.isfinite(run.rate_hz) and run.rate_hz >= 0):
        yield f"rate_hz is {run.rate_hz}"
