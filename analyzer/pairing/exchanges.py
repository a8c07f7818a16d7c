"""Who exchanged messages with whom, under which parameters, and which runs of a machine were flows of one time."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dds_trace.base.errors import MissingEventsError
from dds_trace.base.units import counted
from dds_trace.tracefile.format.descriptions import Run, Session
from dds_trace.tracefile.format.events import Stage

from ..clocks.boots import machine_of, session_of_run
from ..loading.campaign import Campaign
from ..loading.event_index import Copies, EventIndex, EventKey, EventPart, merge_parts
from ..model.environment import environment_of, versions_apart, versions_of
from ..model.parameters import Parameters, parameters_of
from ..model.setting import parse_setting, setting_of

OVERLAP_NS = 1_000_000_000
"""Least common time of two runs, as NTP slews wall clocks, unless one goes on in the middle of the other."""


@dataclass(frozen=True, slots=True, order=True)
class RunSpan:
    """A run from its first to its last T1, wall clock, on the machine of its ping (`boots.machine_of`)."""

    start_ns: int
    end_ns: int
    run_id: int
    machine: str

    @property
    def middle_ns(self) -> int:
        return (self.start_ns + self.end_ns) // 2

    def includes(self, instant_ns: int) -> bool:
        return self.start_ns <= instant_ns <= self.end_ns


@dataclass(frozen=True, slots=True)
class Overlap:
    """Two runs of one machine that went on at the same time, by start.

    Attributes:
        share: common time over the duration of the shorter run, 0 to 1.
        is_mutual: each went on in the middle of the other, so that both count it as a flow.
    """

    one: int
    other: int
    share: float
    is_mutual: bool


def count_flows(spans: Iterable[RunSpan]) -> dict[int, int]:
    flows: dict[int, int] = {}
    for spans_of_machine in _by_machine(spans):
        middles = np.array([span.middle_ns for span in spans_of_machine])
        begun = np.sort([span.start_ns for span in spans_of_machine]).searchsorted(middles, side="right")
        ended = np.sort([span.end_ns for span in spans_of_machine]).searchsorted(middles, side="left")
        flows |= zip([span.run_id for span in spans_of_machine], (begun - ended).tolist(), strict=True)
    return flows


def find_overlaps(spans: Iterable[RunSpan]) -> Iterator[Overlap]:
    """Yield pairs of runs of one machine that overlap by a second, or at the middle of one."""
    for spans_of_machine in _by_machine(spans):
        going_on: list[RunSpan] = []
        for span in sorted(spans_of_machine):
            going_on = [other for other in going_on if other.end_ns >= span.start_ns]
            for other in going_on:
                common_ns = min(span.end_ns, other.end_ns) - span.start_ns
                in_middle = other.includes(span.middle_ns), span.includes(other.middle_ns)
                if common_ns >= OVERLAP_NS or any(in_middle):
                    shorter_ns = min(span.end_ns - span.start_ns, other.end_ns - other.start_ns)
                    share = common_ns / shorter_ns if shorter_ns else 1.0
                    yield Overlap(other.run_id, span.run_id, share, all(in_middle))
            going_on.append(span)


def _by_machine(spans: Iterable[RunSpan]) -> Iterable[list[RunSpan]]:
    machines: dict[str, dict[int, RunSpan]] = defaultdict(dict)
    for span in spans:
        machines[span.machine][span.run_id] = span
    return [list(spans_of_machine.values()) for spans_of_machine in machines.values()]


Parts = tuple[EventPart, ...]
"""The traces that have events of one stage, run and relay."""


UNREQUESTED = "unrequested_relay"
NO_RELAY = 0
_NAMES_NO_RELAY = frozenset((NO_RELAY, (1 << 32) - 1))

_ANY_RELAYS = 16
_ROWS_PER_EVENT = 4
"""Rows of a run for each event of its relays: made-up relays must not make rows without bound."""


@dataclass(frozen=True, slots=True, eq=False)
class Exchange:
    """One run and one relay that took part in it, or no relay (`relay_id` 0).

    Attributes:
        relay: the relay's session; None without its trace.
        start_ns: the run's first T1, wall clock by the ping's anchor; `end_ns` its last.
        counts: events of T1, T2, T3 and T4 in all traces; copies count.
        versions: of the middleware or a package, of ping and relay, where exchanges of the same parameters differ in them.
        replied_ns: first and last T2 of the relay, ping's monotonic clock; None without a reply.
    """

    run: Run
    ping: Session
    relay_id: int
    relay: Session | None
    start_ns: int
    end_ns: int
    counts: tuple[int, int, int, int]
    relays: int = 1
    flows: int = 1
    replied_ns: tuple[int, int] | None = None
    versions: tuple[str, str] = ("", "")

    @property
    def took_part(self) -> bool:
        return sum(self.counts[1:]) > 0

    @property
    def relay_recorded(self) -> bool:
        return sum(self.counts[2:]) > 0

    def span(self) -> RunSpan:
        return RunSpan(self.start_ns, self.end_ns, self.run.run_id, machine_of(self.ping))

    def event_keys(self) -> tuple[EventKey, EventKey, EventKey, EventKey]:
        """Return keys of T1 to T4; all relays of the run share T1. Events of the relay 0 are of no exchange."""
        run_id, relay_id = self.run.run_id, self.relay_id or -1
        return (
            (Stage.T1, run_id, NO_RELAY),
            (Stage.T2, run_id, relay_id),
            (Stage.T3, run_id, relay_id),
            (Stage.T4, run_id, relay_id),
        )

    def parameters(self) -> Parameters:
        return parameters_of(
            self.run, self.ping, self.relay, relays=self.relays, flows=self.flows, versions=self.versions
        )

    def environment(self) -> str:
        return environment_of(self.ping, self.relay)


@dataclass(frozen=True, slots=True)
class Unplaced:
    """Events that belong to no row, copies left out; `relay_id` 0 where they name none."""

    reason: str
    run_id: int
    relay_id: int
    events: int
    traces: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Exchanges:
    """All exchanges of a campaign, by start of the run, then relay, and what could not be placed."""

    placed: tuple[Exchange, ...]
    unplaced: tuple[Unplaced, ...]
    doubts: tuple[Doubt, ...]
    copies: tuple[Copies, ...]


def find_exchanges(campaign: Campaign) -> Exchanges:
    """Match runs with the session of their ping and with the relays that took part.

    Raises:
        MissingEventsError: no published message can be placed.
    """
    published, relayed = _by_run(campaign.events)
    placed: list[Exchange] = []
    unplaced: list[Unplaced] = []
    doubts: list[Doubt] = []
    for run_id in sorted({*published, *relayed}):
        every_relay = relayed.get(run_id, {})
        if run_id not in published:
            unplaced += (
                _unplaced("no_ping_trace", run_id, relay_id, stages.values())
                for relay_id, stages in sorted(every_relay.items())
            )
            continue
        t1 = published[run_id]
        run = campaign.runs.get(run_id)
        ping = find_ping_session(campaign, run, _traces(t1), _first_ns(t1), doubts) if run else None
        if run is None or ping is None:
            reason = "no_ping_session" if run else "no_run_description"
            unplaced.append(_unplaced(reason, run_id, NO_RELAY, [t1]))
            continue
        unnamed = [
            parts for relay_id in every_relay.keys() & _NAMES_NO_RELAY for parts in every_relay[relay_id].values()
        ]
        if unnamed:
            unplaced.append(_unplaced("names_no_relay", run_id, NO_RELAY, unnamed))
        every_relay = {name: stages for name, stages in every_relay.items() if name not in _NAMES_NO_RELAY}
        relays, surplus = _within_bounds(every_relay, _count(t1))
        if surplus:
            unplaced.append(_unplaced("too_many_relays", run_id, NO_RELAY, surplus))
        answers: list[Exchange] = []
        for relay_id, stages in sorted(relays.items()) or [(NO_RELAY, {})]:
            t2, t3, t4 = (stages.get(stage, ()) for stage in (Stage.T2, Stage.T3, Stage.T4))
            first_ns = _first_ns(t3 or t4)
            relay = (
                find_relay_session(campaign, run_id, relay_id, _traces((*t3, *t4)), first_ns, doubts)
                if relays
                else None
            )
            counts = (_count(t1), _count(t2), _count(t3), _count(t4))
            first_ns, last_ns = _first_ns(t1), max(part.last_ns for part in t1)
            start_ns, end_ns = ping.wall_ns(first_ns), ping.wall_ns(last_ns)
            replied_ns = (_first_ns(t2), max(part.last_ns for part in t2)) if t2 else None
            answers.append(Exchange(run, ping, relay_id, relay, start_ns, end_ns, counts, replied_ns=replied_ns))
        strangers = _strangers(answers)
        unplaced += (_unplaced(UNREQUESTED, run_id, name, relays[name].values()) for name in strangers)
        answers = [exchange for exchange in answers if exchange.relay_id not in strangers]
        placed += (replace(exchange, relays=len(answers)) for exchange in answers)
    if not placed and not any(stage is Stage.TAP for stage, _, _ in campaign.events):
        raise MissingEventsError(_nothing_to_pair(campaign, unplaced))
    placed_keys = {key for exchange in placed for key in exchange.event_keys()}
    unplaced_parts = (
        parts for key, parts in campaign.events.items() if key not in placed_keys and key[0] is not Stage.TAP
    )
    copies = (copy for parts in unplaced_parts if len(parts) > 1 for copy in merge_parts(parts)[1])
    flows = count_flows(exchange.span() for exchange in placed)
    placed = [replace(exchange, flows=flows[exchange.run.run_id]) for exchange in placed]
    placed = _apart_by_version(placed)
    placed.sort(key=lambda exchange: (exchange.start_ns, exchange.run.run_id, exchange.relay_id))
    return Exchanges(tuple(placed), tuple(unplaced), tuple(doubts), tuple(copies))


def answered_together(exchanges: Sequence[Exchange]) -> bool:
    spans = [exchange.replied_ns for exchange in exchanges if exchange.replied_ns is not None]
    return len(spans) == len(exchanges) and max(first for first, _ in spans) < min(last for _, last in spans)


def requested_relays(exchange: Exchange) -> float:
    requested = parse_setting(setting_of(exchange.run, exchange.ping, None)).get("relays", "1")
    return int(requested) if requested.isdecimal() else math.inf


def _strangers(answers: Sequence[Exchange]) -> list[int]:
    """Return relays without a trace where as many as requested have one; after an outage ours may lack it."""
    recorded = [exchange for exchange in answers if exchange.relay is not None]
    is_beacon = answers[0].run.labels.get("role") == "beacon"
    if is_beacon or not 0 < len(recorded) < len(answers) or len(recorded) < requested_relays(recorded[0]):
        return []
    has_outage = "outage" in parse_setting(setting_of(answers[0].run, answers[0].ping, None))
    return [
        exchange.relay_id
        for exchange in answers
        if exchange.relay is None
        and (not has_outage or any(answered_together((exchange, other)) for other in recorded))
    ]


def _apart_by_version(exchanges: Sequence[Exchange]) -> list[Exchange]:
    """Give exchanges of equal parameters the versions in which they differ."""
    apart = [*exchanges]
    both = [(index, one.ping, one.relay) for index, one in enumerate(exchanges) if one.relay is not None]
    sessions = {side.session_id: side for _, *sides in both for side in sides}.values()
    if len({(side.vendor, *versions_of(side).items()) for side in sessions}) == len({side.vendor for side in sessions}):
        return apart
    by_parameters: dict[Parameters, list[tuple[int, Session, Session]]] = defaultdict(list)
    for row in both:
        by_parameters[exchanges[row[0]].parameters()].append(row)
    for rows in by_parameters.values():
        words = versions_apart([side for _, *sides in rows for side in sides])
        pairs = [*zip(words[::2], words[1::2], strict=True)]
        if len({pair for pair in pairs if all(pair)}) > 1:
            for (index, *_), pair in zip(rows, pairs, strict=True):
                apart[index] = replace(exchanges[index], versions=pair if all(pair) else ("", ""))
    return apart


def _within_bounds(
    relays: Mapping[int, Mapping[Stage, Parts]], published: int
) -> tuple[Mapping[int, Mapping[Stage, Parts]], list[Parts]]:
    if len(relays) <= _ANY_RELAYS:
        return relays, []
    events = {relay_id: sum(map(_count, stages.values())) for relay_id, stages in relays.items()}
    most = max(_ANY_RELAYS, _ROWS_PER_EVENT * sum(events.values()) // published)
    order = sorted(relays, key=lambda relay_id: (-events[relay_id], relay_id))
    surplus = [parts for relay_id in order[most:] for parts in relays[relay_id].values()]
    return {relay_id: relays[relay_id] for relay_id in order[:most]}, surplus


def _by_run(index: EventIndex) -> tuple[dict[int, Parts], dict[int, dict[int, dict[Stage, Parts]]]]:
    published: dict[int, Parts] = {}
    relayed: dict[int, dict[int, dict[Stage, Parts]]] = defaultdict(lambda: defaultdict(dict))
    for (stage, run_id, relay_id), parts in index.items():
        if stage is Stage.T1:
            published[run_id] = parts
        elif stage is not Stage.TAP:
            relayed[run_id][relay_id][stage] = parts
    return published, relayed


def _count(parts: Parts) -> int:
    return sum(part.count for part in parts)


def _first_ns(parts: Parts) -> int:
    return min((part.first_ns for part in parts), default=0)


def _traces(parts: Parts) -> set[int]:
    return {part.trace for part in parts}


def _unplaced(reason: str, run_id: int, relay_id: int, stages: Iterable[Parts]) -> Unplaced:
    parts_of_stages = list(stages)
    events = sum(len(merge_parts(parts)[0]) for parts in parts_of_stages)
    traces = sorted({part.trace for parts in parts_of_stages for part in parts})
    return Unplaced(reason, run_id, relay_id, events, tuple(traces))


def _nothing_to_pair(campaign: Campaign, unplaced: Iterable[Unplaced]) -> str:
    unread = [
        f"{source.path} was not used: {source.detail}"
        for source in campaign.sources
        if source.status == "skipped" and source.path.endswith(".mcap")
    ]
    reasons = sorted({_in_words(campaign, events) for events in unplaced}) + unread
    advice = "replace that file, or record the run again" if unread else "add the trace of the ping"
    reason = f": {'; '.join(reasons)}" if reasons else ""
    return (
        f"{campaign.folder}: {counted(len(campaign.traces), 'trace')}, but no published message (T1) with its run and session "
        f"description{reason}; {advice}"
    )


def _in_words(campaign: Campaign, unplaced: Unplaced) -> str:
    return f"{counted(unplaced.events, 'event')} of run {unplaced.run_id:016x} in {campaign.names(unplaced.traces)}"


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
    """Return the session that the run names, else the one of the traces with its T1; several become a `Doubt`."""
    session = campaign.sessions.get(session_of_run(run))
    if session is not None:
        return session
    candidates = _sessions_in(campaign, traces.union(campaign.run_traces[run.run_id]), "ping")
    if len(candidates) > 1:
        doubts.append(Doubt("ping", run.run_id, 0, tuple(s.session_id for s in candidates)))
    return _last_started_before(candidates, first_ns)


def find_relay_session(
    campaign: Campaign, run_id: int, relay_id: int, traces: set[int], first_ns: int, doubts: list[Doubt]
) -> Session | None:
    """Return the session of the relay in the traces with its T3 or T4, else any with its relay_id; several become a `Doubt`."""
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
    sessions = [
        session for session in (campaign.sessions[session_id] for session_id in described) if session.role == role
    ]
    return sorted(sessions, key=lambda session: (session.wall_anchor_ns, session.session_id))


def _last_started_before(candidates: list[Session], first_ns: int) -> Session | None:
    if not candidates:
        return None
    before = [session for session in candidates if session.monotonic_anchor_ns <= first_ns]
    return (before or candidates[:1])[-1]
