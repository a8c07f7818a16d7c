"""Checks of the latency over the time of a run: a warm-up that is too short, a rise, two modes.

A campaign has hundreds of runs, and each is tested. So a group is reported if half of its runs or more show the same. With
the false alarms of a run below, of groups of five sound runs at most 3 in 10,000 are reported (10 p^3 for three of five), and
of groups of one run as many as of runs.
"""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

import polars as pl

from dds_trace.tracefile.units.counts import counted
from dds_trace.tracefile.units.durations import format_ms

from ..model.finding import Finding, Severity

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .evidence import Evidence

_HALF = 2
"""A group is reported from one in so many of its runs on."""


def short_warm_up(evidence: Evidence) -> Iterator[Finding]:
    """Report groups whose runs begin with counted messages unlike the others, and propose the warm-up (MSER-5).

    Of simulated runs without a warm-up, independent or with correlations up to 0.95, about 1 % at most are taken for one with
    a warm-up (6 of 500 with 300 messages and 0.9), and 3.1 % where one message in twenty is in a burst
    (`run_statistics.warm_up`).
    """
    for group, shapes, runs in _groups_that_show(evidence, "warm_up_messages"):
        longest = shapes.sort("warm_up_messages").row(-1, named=True)
        ratio = shapes["warm_up_ratio"].median()
        assert isinstance(ratio, float)
        skipped = max(
            e.run.warmup_messages
            for e, g in zip(evidence.grouping.exchanges, evidence.exchange_groups(), strict=True)
            if g == group
        )
        yield Finding(
            Severity.WARNING,
            "short_warm_up",
            evidence.group_names[group],
            f"In {shapes.height} of {counted(runs, 'run')} the first messages are not like the others: {ratio:.2g} times "
            f"their latency, for up to {counted(longest['warm_up_messages'], 'message')} ({longest['warm_up_s']:.2g} s).",
            f"Record with --warmup {skipped + longest['warm_up_messages']}, which leaves them out.",
            (group,),
            effect=min(abs(ratio - 1), 1.0),
        )


def rising_latency(evidence: Evidence) -> Iterator[Finding]:
    """Report groups whose latency rises through their runs.

    Of simulated runs without a trend at most 0.5 % (correlations up to 0.95; 1.1 % at 0.99) are taken for one
    (`run_statistics.trend`).
    """
    for group, shapes, runs in _groups_that_show(evidence, "trend_ratio", pl.col("trend_ratio") > 1):
        worst = shapes.sort("trend_ratio").row(-1, named=True)
        yield Finding(
            Severity.WARNING,
            "latency_rises",
            evidence.group_names[group],
            f"In {shapes.height} of {counted(runs, 'run')} the latency rises from the begin to the end, by up to "
            f"{100 * (worst['trend_ratio'] - 1):.3g} % ({evidence.run_name(worst['run_id'])}).",
            "Look at the timeline: a queue that fills, a processor that gets hot, a link that degrades. Longer runs "
            "will give other percentiles.",
            (group,),
            effect=min(worst["trend_ratio"] - 1, 1.0),
        )


def two_modes(evidence: Evidence) -> Iterator[Finding]:
    """Report groups whose latency is mostly one of two values, between which a median or a mean has no message.

    Of simulated runs with one mode none is taken for one with two, and 1.4 % where one message in twenty is in a burst of
    twenty that is five times as slow (`run_statistics.modes`).
    """
    for group, shapes, runs in _groups_that_show(evidence, "modes_share"):
        low_ns, high_ns, share = (
            shapes[name].median() for name in ("modes_low_ns", "modes_high_ns", "modes_share")
        )
        assert isinstance(low_ns, float)
        assert isinstance(high_ns, float)
        assert isinstance(share, float)
        yield Finding(
            Severity.INFO,
            "two_modes",
            evidence.group_names[group],
            f"In {shapes.height} of {counted(runs, 'run')} the latency is mostly one of two values, about {format_ms(round(low_ns))} ms and "
            f"{format_ms(round(high_ns))} ms; {100 * share:.2g} % of the messages are of the smaller one.",
            "Do not read a median or a mean as typical; look for two paths: a retransmission, a sleeping core, two transports.",
            (group,),
            effect=share,
        )


def _groups_that_show(
    evidence: Evidence, column: str, also: pl.Expr | None = None
) -> Iterator[tuple[int, pl.DataFrame, int]]:
    """Yield each group half of whose runs show something, the rows that do, and the number of runs and relays."""
    showing = evidence.shapes.drop_nulls(column)
    showing = showing if also is None else showing.filter(also)
    runs: dict[int, int] = defaultdict(int)
    for group in evidence.shapes["group"]:
        runs[group] += 1
    for (key,), rows in showing.group_by(["group"], maintain_order=True):
        group = int(str(key))
        if rows.height * _HALF >= runs[group]:
            yield group, rows, runs[group]
