"""Checks of flows that ran together, of messages to several relays, and of results under a load."""

from __future__ import annotations

from collections.abc import Iterator

import polars as pl

from dds_trace.base.printable import printable
from dds_trace.base.units import SECOND_NS, counted, format_duration

from ..model.finding import Severity, Subject
from ..run_statistics.change import Verdict
from ..verdicts.interference import Overtaking
from .evidence import Evidence, Observation, check, percent

SLOW_MATCH_NS = 2 * SECOND_NS
"""Above what the fastest discovery of 20 participants took on a busy machine; a robot's start waits for it."""


@check(
    "interference",
    Severity.WARNING,
    Subject.RESULT,
    "Read this flow's numbers by itself as its best case. A link or processors of its own, a priority, or a lower rate or size of the other "
    "may help: measure it as another setup.",
)
def disturbed_flows(evidence: Evidence) -> Iterator[Observation]:
    """A flow is slower, or loses more, with others than by itself."""
    return _worse(evidence, pl.col("flow") != "")


@check(
    "slower_under_load",
    Severity.INFO,
    Subject.RESULT,
    "Processors of its own (--cpu-affinity) or real-time priority (--realtime) may help: measure them as another setup under the same load.",
)
def slowed_results(evidence: Evidence) -> Iterator[Observation]:
    """A result is slower, or loses more, under a load than without."""
    return _worse(evidence, pl.col("flow") == "")


def _worse(evidence: Evidence, which: pl.Expr) -> Iterator[Observation]:
    worse = pl.col("verdict") == Verdict.WORSE.value
    loses = pl.col("received_verdict") == Verdict.WORSE.value
    rows = evidence.details.interference.filter(which, worse | loses)
    for _, changes in rows.group_by("group", maintain_order=True):
        parts = [
            f"{row['statistic']} of the latency {row['ratio']:.3g} times ({row['ratio_low']:.3g} to {row['ratio_high']:.3g}) the usual one"
            for row in changes.filter(worse).iter_rows(named=True)
        ]
        row = changes.row(0, named=True)
        if row["received_verdict"] == Verdict.WORSE.value:
            parts.append(f"{percent(-row['received_difference'], 1)} more of its messages lost")
        ratios = [ratio for ratio in changes["ratio"].to_list() if ratio]
        effect = max([1 - 1 / max(ratios, default=1.0), -(row["received_difference"] or 0.0)])
        words = (
            f"With {printable(row['with_flows'])}, {printable(row['flow']) or 'this result'} has {', '.join(parts)}."
        )
        yield evidence.result(row["group"], words, effect)


@check(
    "head_of_line",
    Severity.WARNING,
    Subject.RESULT,
    "They queue after it, in the middleware, in a process that takes one message at a time, or on the link: a smaller fragment, a node "
    "or a connection of its own for one of the flows, or a priority may help.",
)
def waiting_flows(evidence: Evidence) -> Iterator[Observation]:
    """Messages of a flow wait until a message of another flow is through."""
    for row in evidence.details.head_of_line.filter(verdict=Overtaking.WAITS.value).iter_rows(named=True):
        wait = (
            ""
            if row["wait_p50_ns"] is None
            else f"; half of them took {format_duration(row['wait_p50_ns'])} more than usual"
        )
        yield evidence.result(
            row["group"],
            f"Of {counted(row['caught'], 'message')} of {row['flow']} that left while one of {row['other']} was under way and stayed so for "
            f"twice the usual round trip, {row['overtook']} returned before it{wait}.",
            1 - row["overtook_ratio"],
        )


@check(
    "shared_cores",
    Severity.INFO,
    Subject.RESULT,
    "A rise with the number of relays may be this machine's and not the middleware's: lower rates, or a device for each host "
    "([[devices]] of a plan), may help to judge.",
)
def sharing_recorders(evidence: Evidence) -> Iterator[Observation]:
    """Pings and relays of a result shared processors."""
    for row in evidence.details.fan_out.filter(pl.col("recorders") > pl.col("processors")).iter_rows(named=True):
        cores = counted(row["processors"], "processor")
        effect = 1 - row["processors"] / row["recorders"]
        yield evidence.result(row["group"], f"{row['recorders']} recorders ran on one machine with {cores}.", effect)


@check(
    "slow_discovery",
    Severity.WARNING,
    Subject.RESULT,
    "Wait for all of them before the first message that counts; a list of peers in place of multicast, or fewer participants, may help.",
)
def slow_discovery(evidence: Evidence) -> Iterator[Observation]:
    """Running relays were met late, and messages until then were lost."""
    for row in evidence.details.fan_out.filter(pl.col("matched_max_ns") > SLOW_MATCH_NS).iter_rows(named=True):
        size = row["discovery_bytes_p50"]
        yield evidence.result(
            row["group"],
            f"Until the last of {counted(row['receivers'], 'relay')} answered a ping that had just started, up to "
            f"{format_duration(row['matched_max_ns'])} passed; {row['missed_p50']:.3g} messages to relays were lost until then (p50 of the runs)"
            + (f", and discovery took {size:,.0f} bytes" if size else "")
            + ".",
            1 - SLOW_MATCH_NS / row["matched_max_ns"],
        )
