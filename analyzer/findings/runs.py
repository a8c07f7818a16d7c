"""Checks of runs and relays: what is missing, and what does not fit together."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping

from dds_trace.base.units import counted
from dds_trace.tracefile.format.descriptions import Session

from ..clocks.boots import share_boot
from ..model.finding import Severity, Subject
from ..pairing.exchanges import Exchange, Unplaced
from .evidence import Evidence, Observation, check, exchange_name, percent, some


@check(
    "orphan_relay_events",
    Severity.WARNING,
    Subject.FILE,
    "Copy the ping's trace into the folder, or ignore this if those runs do not matter.",
)
def runs_without_ping(evidence: Evidence) -> Iterator[Observation]:
    """The ping's trace is missing."""
    return _unplaced(evidence, "no_ping_trace", "No T1 of these runs is here: the trace of their ping is missing.")


@check("undescribed_run", Severity.ERROR, Subject.FILE, "Keep that topic when filtering bags.")
def undescribed_runs(evidence: Evidence) -> Iterator[Observation]:
    """No trace describes a run."""
    what = "No trace describes these runs (topic /dds_trace/run), so their messages were left out."
    return _unplaced(evidence, "no_run_description", what)


@check("undescribed_session", Severity.ERROR, Subject.FILE, "Keep that topic when filtering bags.")
def undescribed_sessions(evidence: Evidence) -> Iterator[Observation]:
    """No trace describes the ping's session."""
    what = "No trace describes the ping session of these runs (topic /dds_trace/session), so they were left out."
    return _unplaced(evidence, "no_ping_session", what)


@check(
    "too_many_relays",
    Severity.ERROR,
    Subject.FILE,
    "Look for a program that forges replies, or a recorder with a new relay_id for each message.",
)
def too_many_relays(evidence: Evidence) -> Iterator[Observation]:
    """More relays replied than a run can have rows for."""
    what = "These runs have replies of more relays than their messages explain; those with the fewest events were left out."
    return _unplaced(evidence, "too_many_relays", what)


def _unplaced(evidence: Evidence, reason: str, what: str) -> Iterator[Observation]:
    alike: dict[tuple[int, tuple[int, ...]], list[Unplaced]] = defaultdict(list)
    for unplaced in evidence.exchanges.unplaced:
        if unplaced.reason == reason:
            alike[unplaced.relay_id, unplaced.traces].append(unplaced)
    for (relay_id, traces), parts in alike.items():
        relay = f", relay {relay_id:08x}" if relay_id else ""
        runs = some(f"{unplaced.run_id:016x}" for unplaced in parts)
        events = counted(sum(unplaced.events for unplaced in parts), "event")
        yield Observation(
            f"{evidence.campaign.names(traces)}{relay}",
            f"{what} {events}, {'run' if len(parts) == 1 else 'runs'} {runs}.",
        )


@check(
    "unfinished_run",
    Severity.WARNING,
    Subject.RUN,
    "Messages that were under way are censored: whether they would have come is unknown, so they count neither as received nor as "
    "lost. Repeat the run if that matters.",
)
def runs_without_end(evidence: Evidence) -> Iterator[Observation]:
    """A run has no end."""
    groups: dict[int, set[int]] = defaultdict(set)
    for exchange, group in evidence.exchanges_by_group():
        groups[exchange.run.run_id].add(group)
    for run_id, (exchange, counts) in evidence.counts_by_run().items():
        if exchange.run.state != "finished":
            published = counted(counts["with_warmup"], "message was", "messages were")
            under_way = counted(counts["in_flight"], "message was", "messages were")
            yield evidence.run(
                run_id,
                f"The run has no end: {published} published, {exchange.run.planned_messages} planned; {under_way} under way at "
                "its end.",
                tuple(sorted(groups[run_id])),
            )


@check(
    "unfinished_run",
    Severity.WARNING,
    Subject.RUN,
    "Percentiles rest on fewer samples than planned; repeat the run if that matters.",
)
def stopped_runs(evidence: Evidence) -> Iterator[Observation]:
    """A run was stopped before its plan."""
    for run_id, (exchange, _) in evidence.counts_by_run().items():
        run = exchange.run
        if run.state == "finished" and run.published < run.planned_messages:
            yield evidence.run(
                run_id,
                f"The run was stopped after {run.published} of {counted(run.planned_messages, 'planned message')}.",
                effect=1 - run.published / run.planned_messages,
            )


@check(
    "missing_publications",
    Severity.ERROR,
    Subject.RUN,
    "Use the whole trace; if it is whole, the recorder dropped events.",
)
def missing_publications(evidence: Evidence) -> Iterator[Observation]:
    """Publications are missing in the trace."""
    for run_id, (exchange, counts) in evidence.counts_by_run().items():
        run, recorded = exchange.run, counts["with_warmup"]
        missing = run.published - recorded
        if run.state == "finished" and missing > 0:
            yield evidence.run(
                run_id,
                f"{missing} of {counted(run.published, 'published message')} "
                f"{'has no T1 in the trace; it has' if missing == 1 else 'have no T1 in the trace; they have'} no row.",
                effect=1 - recorded / run.published,
            )


@check(
    "unpublished_run",
    Severity.ERROR,
    Subject.RUN,
    "See what stopped the ping before its first message, and repeat the run or remove its trace.",
)
def unpublished_runs(evidence: Evidence) -> Iterator[Observation]:
    """A run published nothing.

    It has no row, so that a gate would pass without this error.
    """
    return _unpublished(evidence, finished=True)


@check(
    "unpublished_run",
    Severity.WARNING,
    Subject.RUN,
    "See what stopped the ping before its first message, and repeat the run or remove its trace.",
)
def unpublished_open_runs(evidence: Evidence) -> Iterator[Observation]:
    """A run that may be going on has published nothing."""
    return _unpublished(evidence, finished=False)


def _unpublished(evidence: Evidence, *, finished: bool) -> Iterator[Observation]:
    with_events = {exchange.run.run_id for exchange in evidence.grouping.exchanges}
    with_events |= {unplaced.run_id for unplaced in evidence.exchanges.unplaced}
    for run_id, run in evidence.campaign.runs.items():
        is_empty = run_id not in with_events and run.published == 0 and run.planned_messages > 0
        if is_empty and (run.state == "finished") is finished:
            planned = counted(run.planned_messages, "planned message")
            yield evidence.run(run_id, f"None of {planned} left, and no result includes the run.")


@check(
    "repeated_publications",
    Severity.ERROR,
    Subject.RUN,
    "Each run needs its own random run_id, and each message its own sequence number.",
)
def repeated_publications(evidence: Evidence) -> Iterator[Observation]:
    """A sequence number was published more than once."""
    for run_id, (_, counts) in evidence.counts_by_run().items():
        if counts["repeated"]:
            repeats = counted(counts["repeated"], "T1 event repeats", "T1 events repeat")
            yield evidence.run(run_id, f"{repeats} the sequence number of another; the first one counts.")


@check(
    "orphan_events",
    Severity.WARNING,
    Subject.RUN,
    "Use the whole trace of the ping; if it is whole, its recorder dropped events.",
)
def orphan_events(evidence: Evidence) -> Iterator[Observation]:
    """Events name messages that were never published."""
    for exchange, group, counts in evidence.counts_by_exchange():
        if counts["orphans"]:
            what = counted(
                counts["orphans"],
                "T2, T3 or T4 event names a message without T1; it has no row.",
                "T2, T3 or T4 events name messages without T1; they have no row.",
            )
            yield Observation(exchange_name(exchange), what, (group,))


@check("no_schedule", Severity.INFO, Subject.RUN, "Record T0 (scheduled_ns of T1) to see what a late sender hides.")
def missing_schedule(evidence: Evidence) -> Iterator[Observation]:
    """Runs have no planned send times."""
    unscheduled = {
        exchange.run.run_id
        for exchange, _, counts in evidence.counts_by_exchange()
        if counts["published"] and counts["unscheduled"] == counts["published"] and exchange.run.rate_hz
    }
    if unscheduled:
        yield Observation(
            some(evidence.run_name(run_id) for run_id in sorted(unscheduled)),
            counted(
                len(unscheduled),
                "run recorded no planned send times; its response times are null.",
                "runs recorded no planned send times; their response times are null.",
            ),
        )


@check(
    "no_relay",
    Severity.ERROR,
    Subject.RUN,
    "Start the relay first, in the same domain or on the other side of the bridge, and add its trace.",
)
def runs_without_relay(evidence: Evidence) -> Iterator[Observation]:
    """No relay took part in a run."""
    for exchange, group in evidence.exchanges_by_group():
        if not exchange.took_part:
            yield evidence.run(
                exchange.run.run_id, "No relay took part: no reply came, and no relay's trace has the run.", (group,)
            )


@check(
    "missing_relay_trace", Severity.WARNING, Subject.RELAY, "Copy the relay's trace into the folder and analyze again."
)
def missing_relay_traces(evidence: Evidence) -> Iterator[Observation]:
    """The relay's trace is missing."""
    return _without_events(evidence, described=False)


@check(
    "missing_relay_trace",
    Severity.WARNING,
    Subject.RELAY,
    "Its trace here does not have these runs: use the whole trace, or add the one that is missing.",
)
def incomplete_relay_traces(evidence: Evidence) -> Iterator[Observation]:
    """The relay's trace lacks runs."""
    return _without_events(evidence, described=True)


def _without_events(evidence: Evidence, *, described: bool) -> Iterator[Observation]:
    runs: dict[int, int] = defaultdict(int)
    for exchange in evidence.grouping.exchanges:
        is_missing = exchange.took_part and not exchange.relay_recorded
        if is_missing and (exchange.relay is not None) is described:
            runs[exchange.relay_id] += 1
    return _of_relays(
        runs,
        "replies of this relay but none of its events: latency and intermediate time are null, and losses are lost_unknown.",
    )


@check("undescribed_relay", Severity.WARNING, Subject.RELAY, "Keep the topic /dds_trace/session when filtering bags.")
def undescribed_relays(evidence: Evidence) -> Iterator[Observation]:
    """No trace describes the relay's session."""
    runs: dict[int, int] = defaultdict(int)
    for exchange in evidence.grouping.exchanges:
        if exchange.took_part and exchange.relay_recorded and exchange.relay is None:
            runs[exchange.relay_id] += 1
    return _of_relays(
        runs, "events of this relay, but no session describes it: its vendor, backend and device are null."
    )


def _of_relays(runs: Mapping[int, int], what: str) -> Iterator[Observation]:
    for relay_id, count in runs.items():
        yield Observation(f"relay {relay_id:08x}", f"{counted(count, 'run has', 'runs have')} {what}")


@check(
    "forged_or_foreign",
    Severity.ERROR,
    Subject.RUN,
    "Do not use this result: somebody else answered in the relay's name, or two relays share its id; record where nobody else "
    "can send, with one relay for each id.",
)
def forged_or_foreign(evidence: Evidence) -> Iterator[Observation]:
    """Replies disagree with the relay's own trace."""
    for exchange, group, counts in evidence.counts_by_exchange():
        relay = exchange.relay
        if relay is None or not exchange.relay_recorded:
            continue
        # A relay stores T3 and T4 before a reply leaves, so its whole trace has both of every reply.
        foreign = counts["relay_gaps"] if _is_whole(evidence, relay) else 0
        early = counts["early"] if share_boot(exchange.ping, relay) else counts["negative_latency"]
        if foreign or early:
            doubts = [f"{foreign} not in the relay's trace"] * bool(foreign)
            doubts += [f"{early} sooner than the relay can have answered"] * bool(early)
            yield Observation(
                exchange_name(exchange),
                f"Of {counted(counts['received'], 'reply', 'replies')}: {', '.join(doubts)}.",
                (group,),
                (foreign + early) / max(counts["received"], 1),
            )


def _is_whole(evidence: Evidence, session: Session) -> bool:
    campaign = evidence.campaign
    traces = [campaign.traces[position] for position in campaign.session_traces[session.session_id]]
    return (
        session.state == "closed"
        and not session.dropped_events
        and not {"stopped", "part"} & session.extra.keys()
        and not any(trace.truncated or trace.unreadable_messages or trace.notes for trace in traces)
    )


@check("relay_trace_gaps", Severity.WARNING, Subject.RUN, "Use the whole trace of the relay.")
def gaps_of_relays(evidence: Evidence) -> Iterator[Observation]:
    """The relay's trace has gaps."""
    for exchange, group, counts in evidence.counts_by_exchange():
        gaps, received = counts["relay_gaps"], counts["received"]
        if exchange.relay_recorded and gaps:
            yield Observation(
                exchange_name(exchange),
                f"{gaps} of {counted(received, 'message')} ({percent(gaps, received)}) came back, but the relay's trace "
                "lacks their T3 or T4: their latency is null, and lost_outbound may count messages that did arrive.",
                (group,),
                gaps / received,
            )


@check("unlike_domains", Severity.WARNING, Subject.RUN, "Check the options --domain and --bridge of both sides.")
def unlike_domains(evidence: Evidence) -> Iterator[Observation]:
    """The relay was in another domain than the ping was given."""
    for exchange, group in evidence.exchanges_by_group():
        given = exchange.run.relay_domain_id
        if exchange.relay and given is not None and given != exchange.relay.domain_id:
            what = (
                f"The ping was given relay domain {given}, the relay was in {exchange.relay.domain_id}, which counts."
            )
            yield Observation(exchange_name(exchange), what, (group,))


@check("unlike_payloads", Severity.WARNING, Subject.RUN, "Give each size a run of its own.")
def unlike_payloads(evidence: Evidence) -> Iterator[Observation]:
    """Messages are not of the described size."""
    for run_id, (exchange, counts) in evidence.counts_by_run().items():
        described = exchange.run.payload_bytes
        low, high = counts["least_payload_bytes"], counts["most_payload_bytes"]
        if (low, high) != (described, described):
            yield evidence.run(
                run_id,
                f"The run is described as {described} B a message, its T1 events say {low} to {high} B; "
                "sizes and transfer rates here go by the description.",
            )


@check(
    "relay_restarted",
    Severity.WARNING,
    Subject.RUN,
    "Repeat the run with one relay throughout; where both its traces are here, a message counts for the one that was there.",
)
def restarted_relays(evidence: Evidence) -> Iterator[Observation]:
    """A relay was restarted during a run.

    Relays that all answered at one time are counted in the setting of their result instead.
    """
    relays: dict[tuple[int, str], list[Exchange]] = defaultdict(list)
    for exchange in evidence.grouping.exchanges:
        if exchange.took_part and exchange.relay is not None:
            relays[exchange.run.run_id, exchange.relay.device].append(exchange)
    for (run_id, device), exchanges in relays.items():
        if len(exchanges) > 1 and not _answered_together(exchanges):
            listed = some(f"{exchange.relay_id:08x}" for exchange in exchanges)
            yield evidence.run(
                run_id,
                f"{len(exchanges)} relays on {device} took part ({listed}), but never all at once: the relay was restarted.",
            )


def _answered_together(exchanges: list[Exchange]) -> bool:
    spans = [exchange.replied_ns for exchange in exchanges if exchange.replied_ns is not None]
    return len(spans) == len(exchanges) and max(first for first, _ in spans) < min(last for _, last in spans)
