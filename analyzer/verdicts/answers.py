"""Answers: which middleware and bridge is fastest for which kind of message, and where the traces are inconclusive.

For each kind of message the setups' p99, or p50 where not all have an interval for p99, is compared. One setup leads if it is
faster than each of the others by the test of their runs (`run_statistics.change`), adjusted by Holm. Lost messages count as
infinitely late, and a setup that receives significantly less than another one never leads.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import polars as pl

from ..model.parameters import CASE_COLUMNS, CONTENDER_COLUMNS
from ..model.runs import passes_of
from ..run_statistics.between_runs import estimates_of_runs
from ..run_statistics.change import Verdict, change_of_estimates
from ..run_statistics.received import change_of_received
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

    from ..run_statistics.between_runs import Estimate
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
    """The fastest setups for one kind of message.

    Attributes:
        connectivity: the link.
        domain_mode: `same` or `different`.
        data_type: `binary`, `string`, `imu` or another payload's name.
        payload_bytes: application bytes of a message.
        rate_hz: planned rate.
        percentile: the compared one, `p99` or `p50`.
        clarity: whether one of them leads.
        contenders: setups, best first.
        leaders: setups that cannot be ranked below the best.
        ping_device: device of the ping.
        relay_device: device of the relay, None without its trace.
        conditions: what surrounded the runs, as in `setting`.
        basis: `between runs`, or `within one run` where a setup has fewer than three: then there is no verdict.
        fewest_runs: runs of the setup that has the fewest.
        leader_p50: setup whose median is clearly below every other's; empty if none is.
        leader_p99: the same of the p99; empty also where `percentile` is p50.
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
    """`map` over one sequence, perhaps in other processes."""

    def __call__(self, function: Callable[[T], R], items: Sequence[T], /) -> Iterable[R]:
        """Return the function's results in the order of the items."""


def find_answers(
    rows: GroupRows,
    confidence: float = 0.95,
    passes: Mapping[int, int] | None = None,
    mapper: Mapper = map,
) -> tuple[CaseAnswer, ...]:
    """Answer each kind of message of at most `cases.MOST_COMPARED_ROWS` round trips, one at a time, sorted by `CASE_COLUMNS`.

    `passes` (run_id -> repeat) compares setups repeat by repeat where all runs have one; `mapper` answers the kinds.
    """
    if not rows.has_rows:
        return ()
    groups = without_sockets(rows.groups)
    names = contender_names(groups)
    cases = partition_groups(with_conditions(groups), (*CASE_COLUMNS, CONDITIONS))
    answer = partial(_answer_case, rows=rows, names=names, confidence=confidence, passes=passes or {})
    return tuple(mapper(answer, [case for case in cases if not is_too_large(case)]))


def without_sockets(groups: pl.DataFrame) -> pl.DataFrame:
    """Leave out plain sockets, unless there is nothing else."""
    middlewares = groups.filter(pl.col("backend") != "socket")
    return groups if middlewares.is_empty() else middlewares


_STATISTICS = {"p50": Statistic(0.5), "p99": Statistic(0.99)}


@dataclass(frozen=True, slots=True, eq=False)
class _Setup:
    """A setup's round trips, and its estimates of `_STATISTICS`."""

    setting: Setting
    group: MatchedGroup
    estimates: Mapping[str, Estimate]

    @classmethod
    def of(cls, setting: Setting, group: MatchedGroup, confidence: float) -> _Setup:
        estimates = estimates_of_runs(group.delivered("latency"), list(_STATISTICS.values()), confidence)
        return cls(setting, group, dict(zip(_STATISTICS, estimates, strict=True)))

    def contender(self, name: str, percentile: str, confidence: float) -> Contender:
        return Contender(
            name=name,
            setting=self.setting,
            latency=self.estimates[percentile].interval,
            received=self.group.received_ratio(confidence),
            survivors_ns=self.group.of_survivors("latency", _STATISTICS[percentile]),
            p50_ns=self.estimates["p50"].interval.value,
            p99_ns=self.estimates["p99"].interval.value,
        )


def _answer_case(
    case: pl.DataFrame,
    rows: GroupRows,
    names: ContenderNames,
    confidence: float,
    passes: Mapping[int, int],
) -> CaseAnswer:
    setups: dict[str, _Setup] = {}
    for groups in partition_groups(case, CONTENDER_COLUMNS):
        setting = groups.select(CONTENDER_COLUMNS).row(0, named=True)
        group = MatchedGroup(rows.frame(groups, _ROW_COLUMNS))
        setups[names[tuple(setting.values())]] = _Setup.of(setting, group, confidence)
    has_tails = all(setup.estimates["p99"].interval.is_two_sided for setup in setups.values())
    percentile = "p99" if has_tails else "p50"
    contenders = [setup.contender(name, percentile, confidence) for name, setup in setups.items()]
    ranked = sorted(_with_losses(contenders, setups, confidence), key=Contender.order)
    by_median = sorted(ranked, key=_median_order)
    beaten_at_p50 = _beaten(by_median if has_tails else ranked, setups, "p50", confidence, passes)
    beaten = _beaten(ranked, setups, "p99", confidence, passes) if has_tails else beaten_at_p50
    if len(ranked) == 1:
        clarity = Clarity.ONLY_ONE
    else:
        clarity = Clarity.CLEAR if len(beaten) == len(ranked) - 1 else Clarity.INCONCLUSIVE
    is_between = all(one.latency.basis is Basis.BETWEEN_RUNS for one in ranked)
    return CaseAnswer(
        **case.select(*CASE_COLUMNS, CONDITIONS).row(0, named=True),
        percentile=percentile,
        clarity=clarity,
        contenders=tuple(ranked),
        leaders=tuple(
            one for one in ranked if one is ranked[0] or not (one.name in beaten or one.loses_more)
        ),
        basis=(Basis.BETWEEN_RUNS if is_between else Basis.WITHIN_RUN).value,
        fewest_runs=min(one.latency.runs for one in ranked),
        leader_p50=_leader(by_median if has_tails else ranked, beaten_at_p50),
        leader_p99=_leader(ranked, beaten) if has_tails else "",
    )


def _leader(ranked: Sequence[Contender], beaten: set[str]) -> str:
    return ranked[0].name if len(ranked) > 1 and len(beaten) == len(ranked) - 1 else ""


def _median_order(contender: Contender) -> tuple[bool, float, str]:
    median_ns = math.inf if contender.p50_ns is None else contender.p50_ns
    return contender.loses_more, median_ns, contender.name


def _with_losses(
    contenders: Sequence[Contender], setups: Mapping[str, _Setup], confidence: float
) -> list[Contender]:
    most = max(contenders, key=lambda one: (one.received.value or 0.0, one.name))

    def loses_more(one: Contender) -> bool:
        base, new = (setups[name].group.received for name in (most.name, one.name))
        return one is not most and change_of_received(base, new, confidence).verdict() is Verdict.WORSE

    return [replace(one, loses_more=loses_more(one)) for one in contenders]


def _beaten(
    ranked: Sequence[Contender],
    setups: Mapping[str, _Setup],
    percentile: str,
    confidence: float,
    passes: Mapping[int, int],
) -> set[str]:
    """Return the setups that the first one beats, by tests adjusted by Holm over all others."""
    best, *others = (setups[one.name] for one in ranked)
    changes = [
        change_of_estimates(
            best.estimates[percentile],
            other.estimates[percentile],
            passes_of(best.group.runs, other.group.runs, passes),
        )
        for other in others
    ]
    adjusted = holm_adjusted([1.0 if change.p_value is None else change.p_value for change in changes])
    return {
        other.name
        for other, change, p in zip(ranked[1:], changes, adjusted.tolist(), strict=True)
        if change.verdict(0.0) is Verdict.WORSE and p <= 1 - confidence
    }


@dataclass(frozen=True, slots=True)
class Lead:
    """A setup that leads clearly in so many cases."""

    name: str
    cases: int


@dataclass(frozen=True, slots=True)
class Headline:
    """The answers for one device pair, link, set of conditions, domain mode and data type in one line.

    `cases` have at least two setups; of these some lead, `inconclusive` have no clear leader, `within_one_run` for lack of three runs.
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


_HEADLINE_KEY = (
    "connectivity",
    "domain_mode",
    "data_type",
    "ping_device",
    "relay_device",
    "conditions",
)


def find_headlines(answers: Sequence[CaseAnswer]) -> tuple[Headline, ...]:
    """Summarize answers, each device pair and link for itself."""
    by_key: dict[tuple[Any, ...], list[CaseAnswer]] = {}
    for answer in answers:
        by_key.setdefault(attrgetter(*_HEADLINE_KEY)(answer), []).append(answer)
    return tuple(_headline(key, cases) for key, cases in by_key.items())


def _headline(key: tuple[Any, ...], cases: Sequence[CaseAnswer]) -> Headline:
    compared = [case for case in cases if case.clarity is not Clarity.ONLY_ONE]
    unclear = [case for case in compared if case.clarity is Clarity.INCONCLUSIVE]
    won = Counter(case.leaders[0].name for case in compared if case.clarity is Clarity.CLEAR)
    leads = sorted(won.items(), key=lambda lead: (-lead[1], lead[0]))
    return Headline(
        **dict(zip(_HEADLINE_KEY, key, strict=True)),
        cases=len(compared),
        leads=tuple(Lead(name, count) for name, count in leads),
        inconclusive=len(unclear),
        only_one=len(cases) - len(compared),
        within_one_run=sum(case.basis == Basis.WITHIN_RUN.value for case in unclear),
    )
