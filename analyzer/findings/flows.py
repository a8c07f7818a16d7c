"""Checks of flows that ran together."""

from __future__ import annotations

from collections.abc import Iterator

import polars as pl

from dds_trace.base.units import counted, format_duration

from ..model.finding import Severity, Subject
from ..run_statistics.change import Verdict
from ..verdicts.interference import Overtaking
from .evidence import Evidence, Observation, check, percent


@check(
    "interference",
    Severity.WARNING,
    Subject.RESULT,
    "Read this flow's numbers by itself as its best case. A link or processors of its own, a priority, or a lower rate or size of the other "
    "may help: measure it as another setup.",
)
def disturbed_flows(evidence: Evidence) -> Iterator[Observation]:
    """A flow is slower, or loses more, with others than by itself."""
    worse = pl.col("verdict") == Verdict.WORSE.value
    loses = pl.col("received_verdict") == Verdict.WORSE.value
    rows = evidence.details.interference.filter(worse | loses)
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
        yield evidence.result(row["group"], f"With {row['with_flows']}, {row['flow']} has {', '.join(parts)}.", effect)


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
