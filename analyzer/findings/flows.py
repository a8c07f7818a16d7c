"""Flows that ran together, messages to several relays, results under a load."""

from __future__ import annotations

from collections.abc import Iterator

import polars as pl

from dds_trace.base.printable import printable
from dds_trace.base.units import SECOND_NS

from ..model.finding import Severity, Subject
from ..run_statistics.change import Verdict
from .evidence import Evidence, Observation, check, percent
from .rows import Rows, in_result

FAN_OUT = Rows(Subject.RESULT, lambda evidence: evidence.details.fan_out, in_result)
HEAD_OF_LINE = Rows(Subject.RESULT, lambda evidence: evidence.details.head_of_line, in_result)

SLOW_MATCH_NS = 2 * SECOND_NS
"""More than the fastest discovery of 20 participants took on a busy machine."""


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
