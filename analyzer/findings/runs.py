"""Checks of runs and relays: what is missing, what does not fit together, what the clocks say."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.base.units import counted

from ..model.finding import Finding, Severity
from .evidence import exchange_name, percent, some

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ..pairing.exchanges import Exchange, Unplaced
    from .evidence import Evidence


@dataclass(frozen=True, slots=True)
class _Reason:
    """The finding about events without a row, for one reason."""

    severity: Severity
    code: str
    what: str
    action: str


_UNPLACED = {
    "no_ping_trace": _Reason(
        Severity.WARNING,
        "orphan_relay_events",
        "No T1 of these runs is here: the trace of their ping is missing.",
        "Copy the ping's trace into the folder, or ignore this if those runs do not matter.",
    ),
    "no_run_description": _Reason(
        Severity.ERROR,
        "undescribed_run",
        "No trace describes these runs (topic /dds_trace/run), so their messages were left out.",
        "Keep that topic when filtering bags.",
    ),
    "no_ping_session": _Reason(
        Severity.ERROR,
        "undescribed_session",
        "No trace describes the ping session of these runs (topic /dds_trace/session), so they were left out.",
        "Keep that topic when filtering bags.",
    ),
}


def unplaced_events(evidence: Evidence) -> Iterator[Finding]:
    """Report events that belong to no row: one finding per reason, relay and file."""
    alike: dict[tuple[str, int, tuple[int, ...]], list[Unplaced]] = defaultdict(list)
    for unplaced in evidence.exchanges.unplaced:
        alike[unplaced.reason, unplaced.relay_id, unplaced.traces].append(unplaced)
    for (reason, relay_id, traces), held in alike.items():
        of_relay = f", relay {relay_id:08x}" if relay_id else ""
        runs = some(f"{unplaced.run_id:016x}" for unplaced in held)
        yield Finding(
            _UNPLACED[reason].severity,
            _UNPLACED[reason].code,
            f"{evidence.campaign.names(traces)}{of_relay}",
            f"{_UNPLACED[reason].what} {counted(sum(u.events for u in held), 'event')}, "
            f"{'run' if len(held) == 1 else 'runs'} {runs}.",
            _UNPLACED[reason].action,
        )


def unfinished_runs(evidence: Evidence) -> Iterator[Finding]:
    """Report runs that were cut short, and runs whose publications are not all in the trace."""
    groups: dict[int, set[int]] = defaultdict(set)
    for exchange, group in zip(evidence.grouping.exchanges, evidence.exchange_groups(), strict=True):
        groups[exchange.run.run_id].add(group)
    for run_id, (exchange, counts) in evidence.counts_by_run().items():
        run, kept = exchange.run, counts["with_warmup"]
        if run.state != "finished":
            under_way = counted(counts["in_flight"], "message was", "messages were")
            yield Finding(
                Severity.WARNING,
                "unfinished_run",
                evidence.run_name(run_id),
                f"The run has no end: {counted(kept, 'message was', 'messages were')} published, {run.planned_messages} planned; "
                f"{under_way} under way at its end.",
                "Messages that were under way are censored: nobody knows whether they would have come, so they count neither "
                "as received nor as lost. Repeat the run if that matters.",
                tuple(sorted(groups[run_id])),
            )
        elif run.published < run.planned_messages:
            yield Finding(
                Severity.WARNING,
                "unfinished_run",
                evidence.run_name(run_id),
                f"The run was stopped after {run.published} of {counted(run.planned_messages, 'planned message')}.",
                "Percentiles rest on fewer samples than planned; repeat the run if that matters.",
                effect=1 - run.published / run.planned_messages,
            )
        if run.state == "finished" and kept < run.published:
            yield Finding(
                Severity.ERROR,
                "missing_publications",
                evidence.run_name(run_id),
                f"{run.published - kept} of {counted(run.published, 'published message')} "
                f"{'has no T1 in the trace; it has' if run.published - kept == 1 else 'have no T1 in the trace; they have'} "
                "no row.",
                "Use the whole trace; if it is whole, the recorder dropped events.",
                effect=1 - kept / run.published,
            )


def unpublished_runs(evidence: Evidence) -> Iterator[Finding]:
    """Report runs that planned messages and published none: no row stands for them, so no verdict counts them.

    Where the run has ended this is an error, so that no gate passes without it; one that was only begun may be going on.
    """
    known = {exchange.run.run_id for exchange in evidence.grouping.exchanges}
    known |= {unplaced.run_id for unplaced in evidence.exchanges.unplaced}
    for run_id, run in evidence.campaign.runs.items():
        if run_id not in known and run.published == 0 and run.planned_messages > 0:
            yield Finding(
                Severity.ERROR if run.state == "finished" else Severity.WARNING,
                "unpublished_run",
                evidence.run_name(run_id),
                f"None of {counted(run.planned_messages, 'planned message')} left, and no group has the run.",
                "See what stopped the ping before its first message, and repeat the run or take its trace away.",
            )


def repeated_publications(evidence: Evidence) -> Iterator[Finding]:
    """Report messages with more than one T1."""
    for run_id, (_, counts) in evidence.counts_by_run().items():
        if counts["repeated"]:
            yield Finding(
                Severity.ERROR,
                "repeated_publications",
                evidence.run_name(run_id),
                f"{counted(counts['repeated'], 'T1 event repeats', 'T1 events repeat')} the sequence number of another; the first one counts.",
                "Each run needs its own random run_id, and each message its own sequence number.",
            )


def orphan_events(evidence: Evidence) -> Iterator[Finding]:
    """Report events of a known run whose message has no T1."""
    orphans = evidence.summary.of_exchange["orphans"].to_list()
    for exchange, group, count in zip(
        evidence.grouping.exchanges, evidence.exchange_groups(), orphans, strict=True
    ):
        if count:
            yield Finding(
                Severity.WARNING,
                "orphan_events",
                exchange_name(exchange),
                counted(
                    count,
                    "T2, T3 or T4 event names a message without T1; it has no row.",
                    "T2, T3 or T4 events name messages without T1; they have no row.",
                ),
                "Use the whole trace of the ping; if it is whole, its recorder dropped events.",
                (group,),
            )


def missing_schedule(evidence: Evidence) -> Iterator[Finding]:
    """Report runs whose T1 carry no T0."""
    counts = evidence.summary.of_exchange.select("published", "unscheduled").iter_rows()
    unscheduled = {
        exchange.run.run_id
        for exchange, (published, without) in zip(evidence.grouping.exchanges, counts, strict=True)
        if published and without == published
    }
    if unscheduled:
        yield Finding(
            Severity.INFO,
            "no_schedule",
            some(evidence.run_name(run_id) for run_id in sorted(unscheduled)),
            counted(
                len(unscheduled),
                "run recorded no planned send times; its response times are null.",
                "runs recorded no planned send times; their response times are null.",
            ),
            "Record T0 (scheduled_ns of T1) to see what a late sender hides.",
        )


def relays_without_trace(evidence: Evidence) -> Iterator[Finding]:
    """Report runs in which no relay took part, and relays whose events or description are missing."""
    unrecorded: dict[tuple[int, bool], list[int]] = defaultdict(list)
    undescribed: dict[int, list[int]] = defaultdict(list)
    exchanges = evidence.grouping.exchanges
    for exchange, group in zip(exchanges, evidence.exchange_groups(), strict=True):
        if not exchange.took_part:
            yield Finding(
                Severity.ERROR,
                "no_relay",
                evidence.run_name(exchange.run.run_id),
                "No relay took part: no reply came, and no trace of a relay knows the run.",
                "Start the relay first, in the same domain or behind the bridge, and add its trace.",
                (group,),
            )
        elif not exchange.relay_recorded:
            unrecorded[exchange.relay_id, exchange.relay is not None].append(exchange.run.run_id)
        elif exchange.relay is None:
            undescribed[exchange.relay_id].append(exchange.run.run_id)
    for (relay_id, described), runs in unrecorded.items():
        yield Finding(
            Severity.WARNING,
            "missing_relay_trace",
            f"relay {relay_id:08x}",
            f"{counted(len(runs), 'run has', 'runs have')} replies of this relay but none of its events: latency and intermediate time "
            "are null, and losses are lost_unknown.",
            "Its trace here does not know these runs: use the whole trace, or the one that is missing."
            if described
            else "Copy the relay's trace into the folder and analyze again.",
        )
    for relay_id, runs in undescribed.items():
        yield Finding(
            Severity.WARNING,
            "undescribed_relay",
            f"relay {relay_id:08x}",
            f"{counted(len(runs), 'run has', 'runs have')} events of this relay, but no session describes it: its vendor, backend and "
            "device are null.",
            "Keep the topic /dds_trace/session when filtering bags.",
        )


def gaps_of_relays(evidence: Evidence) -> Iterator[Finding]:
    """Report messages that came back through a relay whose trace lacks them, which makes its losses doubtful, too."""
    counts = evidence.summary.of_exchange.select("relay_gaps", "received").iter_rows()
    for exchange, group, (gaps, received) in zip(
        evidence.grouping.exchanges, evidence.exchange_groups(), counts, strict=True
    ):
        if exchange.relay_recorded and gaps:
            yield Finding(
                Severity.WARNING,
                "relay_trace_gaps",
                exchange_name(exchange),
                f"{gaps} of {counted(received, 'message')} ({percent(gaps, received)}) came back, but the relay's trace "
                "lacks their T3 or T4: their latency is null, and lost_outbound may count messages that did arrive.",
                "Use the whole trace of the relay.",
                (group,),
                effect=gaps / received,
            )


def unlike_domains(evidence: Evidence) -> Iterator[Finding]:
    """Report runs whose ping was told another domain than the relay was in."""
    for exchange, group in zip(evidence.grouping.exchanges, evidence.exchange_groups(), strict=True):
        told = exchange.run.relay_domain_id
        if exchange.relay and told is not None and told != exchange.relay.domain_id:
            yield Finding(
                Severity.WARNING,
                "unlike_domains",
                exchange_name(exchange),
                f"The ping was told relay domain {told}, the relay was in {exchange.relay.domain_id}, which counts.",
                "Check the options --domain and --bridge of both sides.",
                (group,),
            )


def unlike_payloads(evidence: Evidence) -> Iterator[Finding]:
    """Report runs whose messages are not of the described size."""
    for run_id, (exchange, counts) in evidence.counts_by_run().items():
        described = exchange.run.payload_bytes
        low, high = counts["least_payload_bytes"], counts["most_payload_bytes"]
        if (low, high) != (described, described):
            yield Finding(
                Severity.WARNING,
                "unlike_payloads",
                evidence.run_name(run_id),
                f"The run is described as {described} B a message, its T1 events say {low} to {high} B; "
                "sizes and transfer rates here go by the description.",
                "Give each size a run of its own.",
            )


def restarted_relays(evidence: Evidence) -> Iterator[Finding]:
    """Report runs in which relays of one device took part one after the other: one was started anew.

    Relays that all answered at one time were meant to be there together, and `relays` in the setting of their group
    counts them.
    """
    relays: dict[tuple[int, str], list[Exchange]] = defaultdict(list)
    for exchange in evidence.grouping.exchanges:
        if exchange.took_part and exchange.relay is not None:
            relays[exchange.run.run_id, exchange.relay.device].append(exchange)
    for (run_id, device), exchanges in relays.items():
        if len(exchanges) > 1 and not _answered_together(exchanges):
            listed = some(f"{exchange.relay_id:08x}" for exchange in exchanges)
            yield Finding(
                Severity.WARNING,
                "relay_restarted",
                evidence.run_name(run_id),
                f"{len(exchanges)} relays on {device} took part ({listed}), but never all at once: the relay was started anew.",
                "Every message has a row for each, lost with all but one: repeat the run with one relay throughout.",
            )


def _answered_together(exchanges: list[Exchange]) -> bool:
    """Return whether there was a time at which every relay had answered and was to answer again."""
    spans = [exchange.replied_ns for exchange in exchanges]
    known = [span for span in spans if span is not None]
    return len(known) == len(spans) and max(first for first, _ in known) < min(last for _, last in known)
