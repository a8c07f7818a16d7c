"""Answers: which vendor and bridge is fastest for which kind of message, and where the traces cannot tell.

For each kind of message (link, domain mode, data type, size, rate, devices) the contenders' p99, or p50 where not all have an interval
for p99, is compared by confidence intervals. One contender leads if its interval lies wholly below all the others;
where the best interval overlaps another the answer is 'inconclusive'. Lost messages count as infinitely late. Plain
sockets are the floor beneath every middleware, and no contender where a middleware was measured.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from ..model.parameters import CASE_COLUMNS, CONTENDER_COLUMNS
from ..statistics.intervals import percentile_interval, ranges_overlap, ratio_interval
from .cases import (
    CONDITIONS,
    Contender,
    contender_names,
    delivered_latencies,
    is_too_large,
    partition_groups,
    with_conditions,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .cases import ContenderNames, GroupRows

_ROW_COLUMNS = ("run_id", "relay_id", "publish_ns", "latency_ns", "rtt_ns", "outcome")
"""Columns of the round trips that an answer rests on."""


class Clarity(Enum):
    """How far an answer can be relied on."""

    CLEAR = "clear"
    INCONCLUSIVE = "inconclusive"
    ONLY_ONE = "only one"  # nothing to compare it with


@dataclass(frozen=True, slots=True)
class CaseAnswer:
    """The fastest contenders for one kind of message.

    Attributes:
        connectivity: the link, as the ping was told.
        domain_mode: `same` or `different`.
        data_type: `binary`, `string`, `imu` or another payload's name.
        payload_bytes: application bytes of a message.
        rate_hz: rate that the schedule asked for.
        percentile: the compared one, `p99` or `p50`.
        clarity: whether one of them leads.
        contenders: best first.
        leaders: contenders that cannot be told apart from the best, which is the first of them.
        ping_device: device of the ping.
        relay_device: device of the relay, None without its trace.
        conditions: what surrounded the runs, as in `setting` (values of an emulated link, concurrent runs ...).
    """

    connectivity: str
    domain_mode: str
    data_type: str
    payload_bytes: int
    rate_hz: float
    percentile: str
    clarity: Clarity
    contenders: tuple[Contender, ...]
    leaders: tuple[Contender, ...]
    ping_device: str = ""
    relay_device: str | None = None
    conditions: str = ""


def find_answers(rows: GroupRows, confidence: float = 0.95) -> tuple[CaseAnswer, ...]:
    """Answer each kind of message, sorted by `CASE_COLUMNS`; one setting's round trips are in memory at a time.

    A kind with more than `cases.MOST_COMPARED_ROWS` round trips has no answer.

    Args:
        rows: the round trips; without any there is no answer.
        confidence: of the intervals.
    """
    if not rows.has_rows:
        return ()
    contending = without_floor(rows.groups)
    names = contender_names(contending)
    return tuple(
        _answer_case(case, rows, names, confidence)
        for case in partition_groups(with_conditions(contending), (*CASE_COLUMNS, CONDITIONS))
        if not is_too_large(case)
    )


def without_floor(groups: pl.DataFrame) -> pl.DataFrame:
    """Leave out groups of plain sockets, unless there are no others."""
    middlewares = groups.filter(pl.col("backend") != "socket")
    return groups if middlewares.is_empty() else middlewares


def _answer_case(case: pl.DataFrame, rows: GroupRows, names: ContenderNames, confidence: float) -> CaseAnswer:
    """Rank the contenders of one kind of message, whose groups are `case`."""
    percentile, contenders = _compared(case, rows, names, confidence)
    ranked = tuple(sorted(contenders, key=Contender.order))
    best = ranked[0]
    leaders = tuple(
        contender
        for contender in ranked
        if contender is best or ranges_overlap(best.latency.range, contender.latency.range)
    )
    if len(ranked) == 1:
        clarity = Clarity.ONLY_ONE
    else:
        clarity = Clarity.CLEAR if len(leaders) == 1 else Clarity.INCONCLUSIVE
    return CaseAnswer(
        **case.select(*CASE_COLUMNS, CONDITIONS).row(0, named=True),
        percentile=percentile,
        clarity=clarity,
        contenders=ranked,
        leaders=leaders,
    )


def _compared(
    case: pl.DataFrame, rows: GroupRows, names: ContenderNames, confidence: float
) -> tuple[str, list[Contender]]:
    """Return the percentile that can be compared, and the contenders with it."""
    medians, tails = [], []
    for groups in partition_groups(case, CONTENDER_COLUMNS):
        setting = groups.select(CONTENDER_COLUMNS).row(0, named=True)
        roundtrips = rows.frame(groups, _ROW_COLUMNS).sort("run_id", "relay_id", "publish_ns")
        latencies = delivered_latencies(roundtrips)
        ordered = np.sort(latencies)
        median, tail = (
            Contender(
                name=names[tuple(setting.values())],
                setting=setting,
                latency=percentile_interval(latencies, quantile, confidence, ordered=ordered),
                received=ratio_interval((roundtrips["outcome"] == "completed").to_numpy(), confidence),
            )
            for quantile in (0.5, 0.99)
        )
        medians.append(median)
        tails.append(tail)
    if all(contender.latency.is_two_sided for contender in tails):
        return "p99", tails
    return "p50", medians


@dataclass(frozen=True, slots=True)
class Lead:
    """A contender that leads clearly in some cases of a headline.

    Attributes:
        name: the contender's name.
        cases: number of cases that it leads.
    """

    name: str
    cases: int


@dataclass(frozen=True, slots=True)
class Headline:
    """The answers for one link, domain mode and data type in one line.

    Attributes:
        connectivity: the link.
        domain_mode: `same` or `different`.
        data_type: `binary`, `string`, `imu` or another payload's name.
        cases: sizes and rates with at least two contenders.
        leads: contenders that lead clearly somewhere, most cases first.
        inconclusive: cases without a clear leader.
        only_one: cases with one contender only, not among `cases`.
    """

    connectivity: str
    domain_mode: str
    data_type: str
    cases: int
    leads: tuple[Lead, ...]
    inconclusive: int
    only_one: int


def find_headlines(answers: Sequence[CaseAnswer]) -> tuple[Headline, ...]:
    """Summarize answers by link, domain mode and data type, in the order of the answers."""
    headlines = []
    for key in dict.fromkeys((a.connectivity, a.domain_mode, a.data_type) for a in answers):
        cases = [a for a in answers if (a.connectivity, a.domain_mode, a.data_type) == key]
        won = Counter(a.leaders[0].name for a in cases if a.clarity is Clarity.CLEAR)
        leads = [Lead(name, count) for name, count in won.items()]
        headlines.append(
            Headline(
                *key,
                cases=sum(a.clarity is not Clarity.ONLY_ONE for a in cases),
                leads=tuple(sorted(leads, key=lambda lead: (-lead.cases, lead.name))),
                inconclusive=sum(a.clarity is Clarity.INCONCLUSIVE for a in cases),
                only_one=sum(a.clarity is Clarity.ONLY_ONE for a in cases),
            ),
        )
    return tuple(headlines)
