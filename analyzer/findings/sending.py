"""Schedules that were not kept, and messages that left late."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import polars as pl

from dds_trace.base.units import SECOND_NS, counted, format_duration, format_rate
from dds_trace.tracefile.format.json_fields import number_of, object_of

from ..clocks.boots import machine_of
from ..groups.host_samples import node_percent
from ..groups.sending import LATE_NS
from ..model.finding import Subject
from .evidence import Evidence, Observation, percent, warning
from .rows import Rows, frame_of, in_result

_RATE_TOLERANCE = 0.02
"""Share that may lack of the requested rate: a slower run measured another load."""

_LAG_NS = 10_000_000
"""Least lag of a run: two late sends (`sending.LATE_NS`), which no short run loses by its timers."""


@warning(
    "schedule_not_held",
    Subject.RESULT,
    "Do not compare this result with others of the requested rate; a lower rate or a free CPU may help.",
)
def schedule_not_held(evidence: Evidence) -> Iterator[Observation]:
    """Messages were published slower than requested."""
    totals = (
        evidence.sending.drop_nulls("behind_ns")
        .group_by("group")
        .agg(pl.col("elapsed_ns", "behind_ns").sum())
        .sort("group")
    )
    rates = evidence.summary.frame["rate_hz"].to_list()
    for group, elapsed_ns, lag_ns in totals.iter_rows():
        share = elapsed_ns / (elapsed_ns + lag_ns) if elapsed_ns + lag_ns > 0 else 1.0
        if lag_ns >= _LAG_NS and share < 1 - _RATE_TOLERANCE:
            yield evidence.result(
                group,
                f"Published at {format_rate(rates[group] * share)}, requested {format_rate(rates[group])}.",
                1 - share,
            )


_LATE_SHARE = 0.01
"""Late messages that decide the p99 of the response; no simulated run sent 0.1 ms late has as many."""

_LATE_MESSAGES = 3
"""One hiccup of a short run is no habit."""


@warning(
    "late_sends",
    Subject.RESULT,
    "Latency does not include that wait; read response (T2 - T0). A publish that blocks or a busy processor delays the sender: "
    "a lower rate or size, or a free CPU, may help.",
)
def late_sends(evidence: Evidence) -> Iterator[Observation]:
    """Messages left later than planned."""
    totals = (
        evidence.sending.unique(["group", "run_id"], maintain_order=True)
        .drop_nulls("late_max_ns")
        .group_by("group")
        .agg(pl.col("messages", "late").sum(), pl.col("late_max_ns").max())
        .sort("group")
    )
    for group, messages, late, late_max_ns in totals.iter_rows():
        if late >= _LATE_MESSAGES and late >= _LATE_SHARE * messages:
            yield evidence.result(
                group,
                f"{late:,} of {counted(messages, 'message')} ({percent(late, messages)}) left more than "
                f"{format_duration(LATE_NS)} later than planned (T1 - T0), the latest {format_duration(late_max_ns)}.",
                late / messages,
            )


CLIENT_BYTES = 65_536
"""A message of so many takes four times the processor time of one of 64 B (Cyclone DDS), so three quarters are not Python's."""

BUSY_SHARE = 0.9
"""Of the time in which the sender had a processor, or of one processor for a relay: less waits for the middleware or the link."""

_USE_OF_SENDER = ("cpu_ns", "waited_ns", "elapsed_ns")


def _clients(evidence: Evidence) -> pl.DataFrame:
    samples, rows = evidence.details.host_samples, []
    for exchange, group in evidence.exchanges_by_group():
        run = evidence.campaign.runs[exchange.run.run_id]
        sender = object_of(run.extra.get("sender"))
        times_ns = {name: number_of(sender.get(name)) for name in _USE_OF_SENDER}
        if not run.rate_hz and run.published and None not in times_ns.values():
            row = {"run_id": run.run_id, "group": group, "payload_bytes": run.payload_bytes, "messages": run.published}
            # A sample is of the second before it.
            during = exchange.start_ns + SECOND_NS, exchange.end_ns
            relay_percent = node_percent(samples, [exchange.relay] if exchange.relay else [], *during)
            rows.append({**row, **times_ns, "relay_percent": relay_percent})
    if not rows:
        return pl.DataFrame()
    by_run = frame_of(rows).group_by("group", "payload_bytes", "run_id").max()
    results = by_run.group_by("group", "payload_bytes").agg(
        pl.col("messages", *_USE_OF_SENDER).sum(), relay_busy=pl.col("relay_percent").cast(float).mean() / 100
    )
    had_ns, busy = (pl.col("elapsed_ns") - pl.col("waited_ns")).clip(1), pl.col("busy")
    message_ns, is_sender = pl.col("cpu_ns") / pl.col("messages"), busy >= BUSY_SHARE
    return (
        results.filter(pl.col("payload_bytes") <= CLIENT_BYTES)
        .sort("group")
        .with_columns(busy=pl.col("cpu_ns") / had_ns)
        .with_columns(
            sender_busy=pl.when(is_sender).then(busy),
            message_ns=message_ns,
            held=pl.when(~is_sender & (pl.col("relay_busy") >= BUSY_SHARE)).then(1 - busy),
        )
    )


CLIENTS = Rows(Subject.RESULT, _clients, in_result)


_SAMPLES_NS = 2_000_000_000
"""Time without a sample (one a second) in which the sampling thread stood still."""


@warning(
    "stood_still",
    Subject.RUN,
    "Latency does not include that time, response (T2 - T0) does. Repeat the run; a stopped process, a paused machine and a "
    "publish that blocks look alike to a subscriber.",
)
def stand_stills(evidence: Evidence) -> Iterator[Observation]:
    """The ping sent nothing though messages were due."""
    stood = evidence.sending.unique(["group", "run_id"], maintain_order=True).filter(pl.col("still") > 0)
    sessions = {exchange.run.run_id: exchange.ping for exchange in evidence.grouping.exchanges}
    machines = {session.session_id: machine_of(session) for session in evidence.campaign.sessions.values()}
    for row in stood.iter_rows(named=True):
        times = "" if row["still"] == 1 else f", {row['still']} times in all"
        ping = sessions[row["run_id"]]
        neighbours = [session_id for session_id, machine in machines.items() if machine == machine_of(ping)]
        samples = evidence.details.host_samples.filter(pl.col("session_id").is_in(neighbours))
        meanwhile = _host_meanwhile(samples, ping.session_id, row["still_ns"], row["still_end_ns"])
        yield evidence.run(
            row["run_id"],
            f"The ping sent nothing for {format_duration(row['still_ns'])} though messages were due, until "
            f"{row['still_end_ns'] / 1e9:.1f} s of its clock{times}; 99 % of all left at most "
            f"{format_duration(row['late_p99_ns'])} late{meanwhile}.",
            (row["group"],),
            min(row["still_ns"] / max(row["elapsed_ns"] or 0, row["still_ns"]), 1.0),
        )


def _host_meanwhile(samples: pl.DataFrame, ping_id: int, still_ns: int, end_ns: int) -> str:
    timed = samples.drop_nulls("monotonic_ns").sort("monotonic_ns")
    rows = timed.filter(session_id=ping_id)
    before = rows.filter(pl.col("monotonic_ns") <= end_ns - still_ns).tail(1).to_dicts()
    after = rows.filter(pl.col("monotonic_ns") >= end_ns).head(1).to_dicts()
    if not before or not after:
        return ""
    lasted_ns, stolen_ns, waited_us = (
        after[0][name] - before[0][name] if None not in (after[0][name], before[0][name]) else 0
        for name in ("monotonic_ns", "cpu_steal_ns", "cpu_pressure_us")
    )
    others = timed.filter(pl.col("session_id") != ping_id)
    events = []
    if _went_on(rows, still_ns, end_ns):
        events.append("the sampling thread of its process went on")
    elif still_ns >= _SAMPLES_NS and others.is_empty():
        events.append("its whole process did nothing, as no sample of the host was taken")
    elif still_ns >= _SAMPLES_NS and _went_on(others, still_ns, end_ns):
        events.append("its whole process did nothing, and other recordings on its machine went on")
    elif still_ns >= _SAMPLES_NS:
        events.append("no recording on its machine took a sample of the host either: the machine stood still")
    if stolen_ns > 0:
        events.append(f"the hypervisor gave {format_duration(stolen_ns)} of processor time to others")
    if waited_us > 0:
        share = percent(min(waited_us * 1000, lasted_ns), lasted_ns)
        events.append(f"some task waited for a processor in {share} of that time")
    return f". Meanwhile {', and '.join(events)}" if events else ""


def _went_on(timed: pl.DataFrame, still_ns: int, end_ns: int) -> bool:
    inside = timed["monotonic_ns"].filter(timed["monotonic_ns"].is_between(end_ns - still_ns, end_ns))
    longest_ns = max(after - before for before, after in pairwise([end_ns - still_ns, *inside, end_ns]))
    return longest_ns < max(still_ns / 2, _SAMPLES_NS) and not inside.is_empty()
