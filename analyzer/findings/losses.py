"""Lost messages: where, and the causes that traces show."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import polars as pl

from dds_trace.base.units import counted, format_duration

from ..model.finding import Subject
from ..pairing.exchanges import Exchange
from ..pairing.pair import Outcome
from ..verdicts.judgements import exceeds_lossy_share
from .evidence import Evidence, Observation, error, exchange_name, percent, warning
from .rows import Rows, in_result

_LOST = {
    Outcome.LOST_OUTBOUND.value: "on the way out",
    Outcome.LOST_IN_RELAY.value: "in the relay",
    Outcome.LOST_RETURN.value: "on the way back",
    Outcome.LOST_UNKNOWN.value: "at an unknown point",
}


def _outages(evidence: Evidence) -> pl.DataFrame:
    durations_ns = pl.col("duration_ns")
    by_group = evidence.details.outages.group_by("group", maintain_order=True).agg(
        pl.len().alias("times"),
        pl.col("messages").sum().alias("lost"),
        durations_ns.max().alias("longest_ns"),
        durations_ns.null_count().alias("endless"),
    )
    return by_group.with_columns(evidence.summary.frame["published"].gather(by_group["group"]))


OUTAGES = Rows(Subject.RESULT, _outages, in_result)


RECOVERIES = Rows(
    Subject.RUN,
    lambda evidence: evidence.details.recoveries,
    lambda evidence, row: (evidence.run_name(row["run_id"]), (row["group"],)),
)


def _lost_where(row: Mapping[str, int]) -> str:
    return ", ".join(f"{row[outcome]:,} {where}" for outcome, where in _LOST.items() if row[outcome])


@error(
    "nothing_received",
    Subject.RESULT,
    "Check domain, bridge and middleware of both sides; there is nothing to compare here.",
)
def nothing_received(evidence: Evidence) -> Iterator[Observation]:
    """No message came back."""
    for group, row in evidence.rows_by_group("published", "received", *_LOST):
        if row["published"] and not row["received"]:
            yield evidence.result(
                group, f"None of {counted(row['published'], 'message')} came back ({_lost_where(row)})."
            )


@warning("loss", Subject.RESULT, "Percentiles here are of the received messages only; {cure}.")
def losses(evidence: Evidence) -> Iterator[Observation]:
    """Messages were lost."""
    members: dict[int, list[_Member]] = defaultdict(list)
    for exchange, group, counts in evidence.counts_by_exchange():
        members[group].append((exchange, counts))
    endless = evidence.details.outages.filter(pl.col("duration_ns").is_null()).group_by("group")
    lost_at_end = dict(endless.agg(pl.col("messages").sum()).iter_rows())
    for group, row in evidence.rows_by_group("published", "received", "latency_max_ns", "rtt_max_ns", *_LOST):
        published, lost = row["published"], row["published"] - row["received"]
        if row["received"] and (where := _lost_where(row)):
            shown = {**row, "lost_at_end": lost_at_end.get(group, 0)}
            cause = next(filter(None, (find(members[group], shown) for find in _CAUSES)), None)
            seen = f"; {cause.seen}" if cause else ""
            cure = cause.cure if cause else _PERHAPS[members[group][0][0].run.qos.reliability]
            observation = evidence.result(
                group,
                f"{lost:,} of {counted(published, 'message')} ({percent(lost, published)}) did not come back: {where}{seen}.",
                lost / published,
                cure=cure,
            )
            yield replace(observation, cure=cure if cause else "")


_Member = tuple["Exchange", dict[str, int]]
"""An exchange of a group and its counts."""

_PERHAPS = defaultdict(
    lambda: "a lower rate may help",
    reliable="a larger --depth, larger buffers (--tuned) or a lower rate may help",
    best_effort="--reliability reliable, larger buffers (--tuned) or a lower rate may help",
)


class _Cause(NamedTuple):
    seen: str
    cure: str


def _lost_with_relay(members: Sequence[_Member], row: Mapping[str, int]) -> _Cause | None:
    at_end, lost = row["lost_at_end"], row["published"] - row["received"]
    is_killed = any(exchange.relay is not None and exchange.relay.state != "closed" for exchange, _ in members)
    if 2 * at_end <= lost or not (is_killed or any(exchange.ping.extra.get("error") for exchange, _ in members)):
        return None
    seen = f"{at_end} of them from one moment on to the end of the run"
    return _Cause(seen, "see what stopped then (the relay, the link, or the middleware), and record again")


def _outlived_history(members: Sequence[_Member], row: Mapping[str, int]) -> _Cause | None:
    outlived = sum(counts["outlived"] or 0 for _, counts in members)
    others = row["published"] - row["received"] - outlived
    exchange, counts = max(members, key=lambda member: member[1]["longest_gap_ns"] or 0)
    run, history_ns = exchange.run, exchange.run.history_ns
    if not outlived or history_ns is None or exceeds_lossy_share(others / row["published"]):
        return None
    gap_ns = counts["longest_gap_ns"]
    return _Cause(
        f"{outlived} of them left while nothing arrived for up to {format_duration(gap_ns)}, and a history keeps "
        f"{format_duration(history_ns)} (--depth {run.qos.depth} at {run.rate_hz:g} Hz)",
        f"give both sides --depth {2 * math.ceil(gap_ns * run.rate_hz / 1e9)}, enough for twice the longest time without an arrival",
    )


_OLD_SHARE = 0.4
"""Longest latency in lifespans at which others were too old: one late way counts half."""


def _outlived_lifespan(members: Sequence[_Member], row: Mapping[str, int]) -> _Cause | None:
    lifespan_ns = members[0][0].run.qos.extra.get("lifespan_ns")
    longest_ns = row["latency_max_ns"] or row["rtt_max_ns"]
    if not isinstance(lifespan_ns, int) or longest_ns is None or longest_ns < _OLD_SHARE * lifespan_ns:
        return None
    return _Cause(
        f"a message older than {format_duration(lifespan_ns)} is not delivered (-o lifespan), and the others took up to "
        f"{format_duration(longest_ns)}",
        "leave -o lifespan out if late messages are of use, or make it longer than the latency",
    )


def _dropped_by_zenoh(members: Sequence[_Member], _row: Mapping[str, int]) -> _Cause | None:
    exchange, _ = members[0]
    if exchange.ping.vendor != "zenoh" or exchange.run.qos.reliability != "best_effort":
        return None
    return _Cause(
        "Zenoh drops best-effort messages in the sender when the link is full",
        "record with --reliability reliable, with which Zenoh waits, or at a lower rate",
    )


_CAUSES = (_lost_with_relay, _outlived_lifespan, _dropped_by_zenoh, _outlived_history)
"""The first one that the trace shows is named."""


@warning(
    "relay_joined_late",
    Subject.RELAY,
    "Start every relay first, and give the ping -o relays={relays}, which waits for them.",
)
def late_relays(evidence: Evidence) -> Iterator[Observation]:
    """A relay began when the run was under way."""
    absences: dict[tuple[int, str], list[tuple[Exchange, int, int]]] = defaultdict(list)
    for exchange, group, counts in evidence.counts_by_exchange():
        if counts["absent"] and exchange.relay is not None:
            absences[exchange.run.run_id, exchange.relay.device].append((exchange, group, counts["absent"]))
    for (_, device), absent in absences.items():
        if len(absent) == 1:  # two are one that was restarted
            exchange, group, messages = absent[0]
            yield Observation(
                exchange_name(exchange),
                f"{counted(messages, 'message')} had left before the relay on {device} was there; they are no losses, and have no row.",
                (group,),
                blanks={"relays": exchange.relays},
            )
