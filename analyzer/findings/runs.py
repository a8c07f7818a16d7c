"""Runs and relays: what is missing, and what does not fit together."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import chain

import polars as pl

from dds_trace.base.units import counted
from dds_trace.tracefile.format.descriptions import Session

from ..clocks.boots import ping_boots, share_boot
from ..groups.summary import Summary
from ..model.finding import Subject
from ..pairing.exchanges import UNREQUESTED, Exchange, Unplaced, answered_together, requested_relays
from ..pairing.one_way import fit_devices, segment_table
from .evidence import Evidence, Observation, error, exchange_name, note, some, warning
from .rows import Rows, frame_of, in_run, named


def _exchanges(evidence: Evidence) -> pl.DataFrame:
    rows = [
        {
            "run_id": exchange.run.run_id,
            "group": group,
            "where": exchange_name(exchange),
            "state": exchange.run.state,
            "handed_over": exchange.run.published,
            "planned_messages": exchange.run.planned_messages,
            "payload_bytes": exchange.run.payload_bytes,
            "relay_domain": exchange.run.relay_domain_id,
            "relay_id": exchange.relay_id,
            "took_part": exchange.took_part,
            "relay_recorded": exchange.relay_recorded,
            "is_described": exchange.relay is not None,
            "domain_of_relay": exchange.relay.domain_id if exchange.relay else None,
            "is_beacon": group in evidence.beacons,
        }
        for exchange, group in evidence.exchanges_by_group()
    ]
    return pl.concat([frame_of(rows), evidence.summary.exchange_counts], how="horizontal")


EXCHANGES = Rows(Subject.RUN, _exchanges, lambda _, row: (row["where"], (row["group"],)))


def _runs(evidence: Evidence) -> pl.DataFrame:
    if not evidence.grouping.exchanges:  # a folder of taps
        return pl.DataFrame()
    by_run = evidence.frame(_exchanges).group_by("run_id", maintain_order=True)
    runs = by_run.agg(pl.exclude("group").last(), pl.col("group").unique().sort().alias("groups"))
    return runs.with_columns((pl.col("handed_over") - pl.col("with_warmup")).alias("missing"))


RUNS = Rows(Subject.RUN, _runs, in_run)
RUNS_OF_RESULTS = Rows(Subject.RUN, _runs, lambda evidence, row: (evidence.run_name(row["run_id"]), (*row["groups"],)))


def _empty_runs(evidence: Evidence) -> pl.DataFrame:
    with_events = {exchange.run.run_id for exchange in evidence.grouping.exchanges}
    with_events |= {item.run_id for item in evidence.exchanges.unplaced}
    return frame_of(
        {"run_id": run_id, "state": run.state, "planned_messages": run.planned_messages}
        for run_id, run in evidence.campaign.runs.items()
        if run_id not in with_events and run.published == 0 and run.planned_messages > 0
    )


EMPTY_RUNS = Rows(Subject.RUN, _empty_runs, in_run)
NOTHING_LEFT = "None of {planned_messages:# planned message} left, and no result includes the run."
SEE_WHAT_STOPPED = "See what stopped the ping before its first message, and repeat the run or remove its trace."


def _relays(evidence: Evidence) -> pl.DataFrame:
    if not evidence.grouping.exchanges:
        return pl.DataFrame()
    took_part = evidence.frame(_exchanges).filter("took_part")
    return took_part.group_by("relay_id", "relay_recorded", "is_described", maintain_order=True).len("runs")


STOPPED_EARLY = (
    ~pl.col("is_beacon") & (pl.col("state") == "finished") & (pl.col("handed_over") < pl.col("planned_messages"))
)
NO_EVENTS_OF_RELAY = (
    "{runs:# run has|runs have} replies of this relay but none of its events: latency and intermediate time are null, and losses are "
    "lost_unknown."
)
RELAYS = Rows(Subject.RELAY, _relays, lambda _, row: (f"relay {row['relay_id']:08x}", ()))


def _unplaced(evidence: Evidence) -> pl.DataFrame:
    alike: dict[tuple[str, int, tuple[int, ...]], list[Unplaced]] = defaultdict(list)
    for unplaced in evidence.exchanges.unplaced:
        alike[unplaced.reason, unplaced.relay_id, unplaced.traces].append(unplaced)
    return frame_of(
        {
            "reason": reason,
            "where": evidence.campaign.names(traces) + (f", relay {relay_id:08x}" if relay_id else ""),
            "events": sum(unplaced.events for unplaced in parts),
            "runs": ("run " if len(parts) == 1 else "runs ") + some(f"{unplaced.run_id:016x}" for unplaced in parts),
        }
        for (reason, relay_id, traces), parts in alike.items()
    )


UNPLACED = Rows(Subject.FILE, _unplaced, named)


@note("no_schedule", Subject.RUN, "Record T0 (scheduled_ns of T1) to see what a late sender hides.")
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


@error(
    "forged_or_foreign",
    Subject.RUN,
    "Do not use this result: somebody else answered in the relay's name, or two relays share its id; record where nobody else "
    "can send, with one relay for each id and every bridge described.",
)
def forged_or_foreign(evidence: Evidence) -> Iterator[Observation]:
    """Replies disagree with the relay's own trace."""
    for exchange, group, counts in evidence.counts_by_exchange():
        relay = exchange.relay
        if relay is None or not exchange.relay_recorded:
            continue
        # A relay stores T3 and T4 before a reply leaves: a whole trace has both.
        foreign = counts["relay_gaps"] if _is_whole(evidence, relay) else 0
        second = _second_sources(evidence, exchange, counts)
        one_clock = share_boot(exchange.ping, relay) and not _has_other_clock(evidence, exchange, counts)
        early = counts["early" if one_clock else "negative_latency"]
        if foreign or early or second:
            doubts = [f"{foreign:,} not in the relay's trace"] * bool(foreign)
            doubts += [f"{early:,} sooner than the relay can have answered"] * bool(early)
            doubts += [f"{second:,} from two senders, although the relay sent one"] * bool(second)
            yield Observation(
                exchange_name(exchange),
                f"Of {counted(counts['received'], 'reply', 'replies')}: {', '.join(doubts)}.",
                (group,),
                min((foreign + early + second) / max(counts["received"], 1), 1.0),
            )


@error(
    "reply_size",
    Subject.RUN,
    "Do not use this result: its times are of other messages than the run describes. Look for a relay or a bridge that cuts or "
    "fills messages, or, of calls, give both sides one -o response_size.",
)
def other_sizes(evidence: Evidence) -> Iterator[Observation]:
    """Replies had another size than the messages."""
    for exchange, group, counts in evidence.counts_by_exchange():
        if counts["resized"]:
            what = f"{counts['resized']:,} of {counted(counts['replied'], 'reply', 'replies')} had {counts['least_reply_bytes']:,} to "
            what += f"{counts['most_reply_bytes']:,} B, which is not the size that was sent or requested."
            effect = min(counts["resized"] / max(counts["replied"], 1), 1.0)
            yield Observation(exchange_name(exchange), what, (group,), effect)


def _second_sources(evidence: Evidence, exchange: Exchange, counts: Mapping[str, int]) -> int:
    relay = exchange.relay
    is_sure = relay is not None and _is_direct(exchange) and _is_whole(evidence, relay)
    return counts["second_source"] if is_sure else 0


def _is_direct(exchange: Exchange) -> bool:
    far_id = exchange.run.relay_domain_id if exchange.relay is None else exchange.relay.domain_id
    return exchange.run.bridge == "none" and far_id in (None, exchange.ping.domain_id)


@warning(
    "doubtful_replies",
    Subject.RUN,
    "Record the relay's whole trace as well, which says how many replies it sent, or repeat where nobody else can send.",
)
def doubtful_replies(evidence: Evidence) -> Iterator[Observation]:
    """Different replies to one message: one may be from another program."""
    for exchange, group, counts in evidence.counts_by_exchange():
        doubtful = counts["unclear"] - _second_sources(evidence, exchange, counts)
        # A network may copy the datagrams of sockets, which carry no stamp of their sender.
        if doubtful and _is_direct(exchange) and exchange.ping.backend != "socket":
            what = f"{counted(doubtful, 'message')} of {counts['received']:,} came back in different replies, and the first one counts."
            yield Observation(exchange_name(exchange), what, (group,), doubtful / max(counts["received"], 1))


def _has_other_clock(evidence: Evidence, exchange: Exchange, counts: Mapping[str, int]) -> bool:
    """Return whether a constant offset explains all replies and most need one: a relay in another time namespace."""
    pairs = [pair for pair in evidence.device_pairs if exchange.relay_id in pair.knots["relay_id"]]
    is_one_offset = all(len(pair.segments) <= pair.knots["relay_id"].n_unique() for pair in pairs)
    return is_one_offset and 2 * counts["early"] > counts["received"]


def forged_groups(
    summary: Summary, clock_knots: pl.DataFrame | None, make_evidence: Callable[[], Evidence]
) -> tuple[int, ...]:
    """Return the results that are not to be used, before details: nothing is judged by them."""
    suspect = summary.exchange_counts.select(
        pl.col("relay_gaps", "early", "negative_latency", "second_source", "resized").sum()
    )
    if not any(suspect.row(0)):
        return ()
    evidence = make_evidence()
    details = evidence.details
    if clock_knots is not None:
        boots = ping_boots(evidence.campaign.sessions.values(), evidence.campaign.runs.values())
        clock_fits = segment_table(fit_devices(clock_knots, boots))
        details = replace(details, clock_fits=clock_fits, clock_knots=clock_knots)
    with_clocks = replace(evidence, details=details)
    findings = chain(forged_or_foreign(with_clocks), other_sizes(with_clocks))
    return tuple(sorted({group for finding in findings for group in finding.groups}))


def _is_whole(evidence: Evidence, session: Session) -> bool:
    campaign = evidence.campaign
    traces = [campaign.traces[position] for position in campaign.session_traces[session.session_id]]
    return (
        session.state == "closed"
        and not session.dropped_events
        and not {"stopped", "part"} & session.extra.keys()
        and not any(trace.truncated or trace.unreadable_messages or trace.notes for trace in traces)
    )


@warning(
    "relay_restarted",
    Subject.RUN,
    "Repeat the run with one relay throughout; where both its traces are here, a message counts for the one that was there.",
)
def restarted_relays(evidence: Evidence) -> Iterator[Observation]:
    """A relay was restarted during a run."""
    relays: dict[tuple[int, str], list[Exchange]] = defaultdict(list)
    for exchange in evidence.grouping.exchanges:
        if exchange.took_part and exchange.relay is not None:
            relays[exchange.run.run_id, exchange.relay.device].append(exchange)
    for (run_id, device), exchanges in relays.items():
        if len(exchanges) > 1 and not answered_together(exchanges):
            listed = some(f"{exchange.relay_id:08x}" for exchange in exchanges)
            yield evidence.run(
                run_id,
                f"{len(exchanges)} relays on {device} took part ({listed}), but never all at once: the relay was restarted.",
            )


@warning(
    "unrequested_relay",
    Subject.RUN,
    "End the others and record again; where all are to answer, `record ping` takes -o relays={relays}.",
)
def unrequested_relays(evidence: Evidence) -> Iterator[Observation]:
    """More relays answered a ping than it was to wait for."""
    exchanges_of: dict[int, list[Exchange]] = defaultdict(list)
    groups_of: dict[int, dict[int, None]] = defaultdict(dict)
    for exchange, group in evidence.exchanges_by_group():
        if exchange.replied_ns is not None and group not in evidence.beacons:
            exchanges_of[exchange.run.run_id].append(exchange)
            groups_of[exchange.run.run_id][group] = None
    left_out: dict[int, list[str]] = defaultdict(list)
    for unplaced in evidence.exchanges.unplaced:
        if unplaced.reason == UNREQUESTED:
            left_out[unplaced.run_id].append(f"relay {unplaced.relay_id:08x}")
    for run_id, exchanges in exchanges_of.items():
        strangers, requested = left_out[run_id], requested_relays(exchanges[0])
        answering = [*(exchange_name(exchange).partition(", ")[2] for exchange in exchanges), *strangers]
        if len(answering) > requested and answered_together(exchanges):
            counting = "each message counts once for each of them"
            if strangers:
                counting = f"without a trace here, the replies of {some(strangers)} are left out"
            yield Observation(
                evidence.run_name(run_id),
                f"{len(answering)} relays answered{' together' * (not strangers)} ({some(answering)}), and the ping was to wait for {requested}: "
                f"{counting}, and each is the load of the others.",
                tuple(groups_of[run_id]),
                blanks={"relays": len(answering)},
            )


SEVERAL_RELAYS = (restarted_relays, unrequested_relays)
