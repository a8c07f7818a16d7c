"""Answers: which vendor and bridge is fastest for which kind of message, and where the traces cannot tell.

For each kind of message (link, domain mode, data type, size, rate, devices) the contenders' p99, or p50 where not all have an interval
for p99, is compared. The run is the unit: one contender leads if it is faster than each of the others by the test of
their runs (`run_statistics.change`), adjusted by Holm over the others; with fewer than three runs a contender nothing is
said. Lost messages count as infinitely late, and a contender that receives significantly less than another one never
leads. Plain sockets are no middleware, and no contender where a middleware was measured.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from typing import TYPE_CHECKING, Protocol, TypeVar

import polars as pl

from ..model.parameters import CASE_COLUMNS, CONTENDER_COLUMNS
from ..model.runs import passes_of
from ..run_statistics.between_runs import interval_of_runs
from ..run_statistics.change import Verdict, change_of_runs
from ..run_statistics.delivery import change_of_received
from ..run_statistics.runs import Statistic
from ..statistics.intervals import Basis
from ..statistics.power import holm_adjusted
from .cases import (
    CONDITIONS,
    Contender,
    contender_names,
    is_too_large,
    partition_groups,
    with_conditions,
)
from .matching import MatchedGroup

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from .cases import ContenderNames, GroupRows, Setting

T = TypeVar("T")
R = TypeVar("R")

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
        basis: `between runs`, or `within one run` where a contender has fewer than three: then nothing is told apart.
        fewest_runs: runs of the contender that has the fewest.
        leader_p50: name of the contender whose median is clearly below that of each of the others; empty if none is.
        leader_p99: the same of the p99; empty also where `percentile` is p50, because not all have an interval for p99.
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
    basis: str = ""
    fewest_runs: int = 0
    leader_p50: str = ""
    leader_p99: str = ""


class Mapper(Protocol):
    """What `map` does with one sequence, perhaps by other processes."""

    def __call__(self, function: Callable[[T], R], items: Sequence[T], /) -> Iterable[R]:
        """Return the function's results in the order of the items."""


def find_answers(
    rows: GroupRows,
    confidence: float = 0.95,
    passes: Mapping[int, int] | None = None,
    mapper: Mapper = map,
) -> tuple[CaseAnswer, ...]:
    """Answer each kind of message, sorted by `CASE_COLUMNS`; one setting's round trips are in memory at a time.

    A kind with more than `cases.MOST_COMPARED_ROWS` round trips has no answer.

    Args:
        rows: the round trips; without any there is no answer.
        confidence: of the intervals.
        passes: run_id -> pass of the sweep: contenders are compared pass by pass where all runs have one.
        mapper: answers the kinds.
    """
    if not rows.has_rows:
        return ()
    contending = without_floor(rows.groups)
    names = contender_names(contending)
    cases = partition_groups(with_conditions(contending), (*CASE_COLUMNS, CONDITIONS))
    answer = partial(_answer_case, rows=rows, names=names, confidence=confidence, passes=passes or {})
    return tuple(mapper(answer, [case for case in cases if not is_too_large(case)]))


def without_floor(groups: pl.DataFrame) -> pl.DataFrame:
    """Leave out groups of plain sockets, unless there are no others."""
    middlewares = groups.filter(pl.col("backend") != "socket")
    return groups if middlewares.is_empty() else middlewares


def _answer_case(
    case: pl.DataFrame,
    rows: GroupRows,
    names: ContenderNames,
    confidence: float,
    passes: Mapping[int, int],
) -> CaseAnswer:
    """Rank the contenders of one kind of message, whose groups are `case`."""
    measured = {}
    for groups in partition_groups(case, CONTENDER_COLUMNS):
        first = groups.row(0, named=True)
        setting = {name: first[name] for name in CONTENDER_COLUMNS}
        measured[names[tuple(setting.values())]] = setting, MatchedGroup(rows.frame(groups, _ROW_COLUMNS))
    percentile, quantile, contenders = _contenders(measured, confidence)
    groups_of = {name: group for name, (_, group) in measured.items()}
    ranked = sorted(_with_losses(contenders, groups_of, confidence), key=Contender.order)
    beaten = _beaten_by(ranked[0], ranked[1:], groups_of, quantile, confidence, passes)
    by_median = sorted(ranked, key=_median_order)
    below_median = (
        beaten
        if percentile == "p50"
        else _beaten_by(by_median[0], by_median[1:], groups_of, 0.5, confidence, passes)
    )
    if len(ranked) == 1:
        clarity = Clarity.ONLY_ONE
    else:
        clarity = Clarity.CLEAR if len(beaten) == len(ranked) - 1 else Clarity.INCONCLUSIVE
    is_between = all(one.latency.basis is Basis.BETWEEN_RUNS for one in ranked)
    of_case = case.row(0, named=True)
    return CaseAnswer(
        **{name: of_case[name] for name in (*CASE_COLUMNS, CONDITIONS)},
        percentile=percentile,
        clarity=clarity,
        contenders=tuple(ranked),
        leaders=tuple(
            one for one in ranked if one is ranked[0] or not (one.name in beaten or one.loses_more)
        ),
        basis=(Basis.BETWEEN_RUNS if is_between else Basis.WITHIN_RUN).value,
        fewest_runs=min(one.latency.runs for one in ranked),
        leader_p50=_leader(ranked if percentile == "p50" else by_median, below_median),
        leader_p99=_leader(ranked, beaten) if percentile == "p99" else "",
    )


def _leader(ranked: Sequence[Contender], beaten: set[str]) -> str:
    """Return the name of the first of several contenders if it beats all others; empty otherwise."""
    return ranked[0].name if len(ranked) > 1 and len(beaten) == len(ranked) - 1 else ""


def _median_order(contender: Contender) -> tuple[bool, float, str]:
    median_ns = math.inf if contender.p50_ns is None else contender.p50_ns
    return contender.loses_more, median_ns, contender.name


def _contenders(
    measured: Mapping[str, tuple[Setting, MatchedGroup]], confidence: float
) -> tuple[str, float, list[Contender]]:
    """Return the percentile that can be compared, its quantile, and the contenders with it."""
    medians, tails = (
        {
            name: interval_of_runs(group.delivered("latency"), Statistic(quantile), confidence)
            for name, (_, group) in measured.items()
        }
        for quantile in (0.5, 0.99)
    )
    has_tails = all(tail.is_two_sided for tail in tails.values())
    percentile, quantile, latencies = ("p99", 0.99, tails) if has_tails else ("p50", 0.5, medians)
    contenders = [
        Contender(
            name=name,
            setting=setting,
            latency=latencies[name],
            received=group.received_ratio(confidence),
            survivors_ns=group.of_survivors("latency", Statistic(quantile)),
            p50_ns=medians[name].value,
            p99_ns=tails[name].value,
        )
        for name, (setting, group) in measured.items()
    ]
    return percentile, quantile, contenders


def _with_losses(
    contenders: Sequence[Contender], groups: Mapping[str, MatchedGroup], confidence: float
) -> list[Contender]:
    """Mark contenders that receive significantly less than the one that receives most."""
    most = max(contenders, key=lambda one: (one.received.value or 0.0, one.name))
    return [
        replace(
            one,
            loses_more=one is not most
            and change_of_received(
                groups[most.name].received, groups[one.name].received, confidence
            ).verdict()
            is Verdict.WORSE,
        )
        for one in contenders
    ]


def _beaten_by(
    best: Contender,
    others: Sequence[Contender],
    groups: Mapping[str, MatchedGroup],
    quantile: float,
    confidence: float,
    passes: Mapping[int, int],
) -> set[str]:
    """Return the names of the contenders that the best is faster than, by tests adjusted by Holm over all others."""
    statistic = Statistic(quantile)
    changes = [
        change_of_runs(
            groups[best.name].delivered("latency"),
            groups[other.name].delivered("latency"),
            statistic,
            confidence,
            passes_of(groups[best.name].runs, groups[other.name].runs, passes),
        )
        for other in others
    ]
    adjusted = holm_adjusted([1.0 if change.p_value is None else change.p_value for change in changes])
    return {
        other.name
        for other, change, p in zip(others, changes, adjusted.tolist(), strict=True)
        if change.verdict(0.0) is Verdict.WORSE and p <= 1 - confidence
    }


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
    """The answers for one pair of devices, link, set of conditions, domain mode and data type in one line.

    Attributes:
        connectivity: the link.
        domain_mode: `same` or `different`.
        data_type: `binary`, `string`, `imu` or another payload's name.
        cases: sizes and rates with at least two contenders.
        leads: contenders that lead clearly somewhere, most cases first.
        inconclusive: cases without a clear leader.
        only_one: cases with one contender only, not among `cases`.
        ping_device: device of the ping.
        relay_device: device of the relay, None without its trace.
        conditions: what surrounded the runs, as in `setting`.
        within_one_run: inconclusive cases in which a contender has fewer than three runs.
    """

    connectivity: str
    domain_mode: str
    data_type: str
    cases: int
    leads: tuple[Lead, ...]
    inconclusive: int
    only_one: int
    ping_device: str = ""
    relay_device: str | None = None
    conditions: str = ""
    within_one_run: int = 0


def find_headlines(answers: Sequence[CaseAnswer]) -> tuple[Headline, ...]:
    """Summarize answers, each pair of devices and link for itself, in the order of the answers."""
    of_key: dict[tuple[str | None, ...], list[CaseAnswer]] = {}
    for answer in answers:
        of_key.setdefault(_headline_key(answer), []).append(answer)
    return tuple(_headline(cases) for cases in of_key.values())


def _headline_key(answer: CaseAnswer) -> tuple[str | None, ...]:
    return (
        answer.connectivity,
        answer.domain_mode,
        answer.data_type,
        answer.ping_device,
        answer.relay_device,
        answer.conditions,
    )


def _headline(cases: Sequence[CaseAnswer]) -> Headline:
    """Summarize the answers of one key."""
    first, compared = cases[0], [case for case in cases if case.clarity is not Clarity.ONLY_ONE]
    unclear = [case for case in compared if case.clarity is Clarity.INCONCLUSIVE]
    won = Counter(case.leaders[0].name for case in compared if case.clarity is Clarity.CLEAR)
    leads = [Lead(name, count) for name, count in won.items()]
    return Headline(
        connectivity=first.connectivity,
        domain_mode=first.domain_mode,
        data_type=first.data_type,
        cases=len(compared),
        leads=tuple(sorted(leads, key=lambda lead: (-lead.cases, lead.name))),
        inconclusive=len(unclear),
        only_one=len(cases) - len(compared),
        ping_device=first.ping_device,
        relay_device=first.relay_device,
        conditions=first.conditions,
        within_one_run=sum(case.basis == Basis.WITHIN_RUN.value for case in unclear),
    )
