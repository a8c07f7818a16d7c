"""Answers: which setup is fastest for which kind of message; what loses significantly more, or over `LOSSY_SHARE`, never leads."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
import polars as pl

from ..model.names import group_words
from ..model.parameters import CASE_COLUMNS, CONTENDER_COLUMNS, DEVICE_COLUMNS, ParameterValue
from ..model.runs import RunRows
from ..model.setting import parse_setting
from ..run_statistics.received import Bools, LossExcess, loss_excesses, received_interval
from ..run_statistics.runs import Statistic
from ..statistics.intervals import Basis, Range
from .cases import CONDITIONS, Contender, GroupRows, contender_names, is_too_large, partition_groups, with_conditions
from .judgements import LOSSY_SHARE, PROVEN, Claim, Judgement, Reason, exceeds_lossy_share, is_replacing, judged_losses
from .ranking import Kind, Ranking, RankingOptions, judge_losers, rank_setups
from .setup_runs import SetupRuns

_WORDS = ("data_type", "payload_bytes", "rate_hz", "domain_mode", "connectivity", *DEVICE_COLUMNS, "conditions")
FAMILY = ("connectivity", "domain_mode", "data_type", *DEVICE_COLUMNS, "conditions")
"""Fields of an answer that differ between families, whose spreads are pooled."""

_ROW_COLUMNS = ("run_id", "relay_id", "publish_ns", "latency_ns", "rtt_ns", "outcome")


class Clarity(Enum):
    CLEAR = "clear"
    INCONCLUSIVE = "inconclusive"
    ONLY_ONE = "only one"  # nothing to compare it with


@dataclass(frozen=True, slots=True)
class CaseAnswer:
    """The fastest setups for one kind of message.

    Attributes:
        domain_mode: `same` or `different`.
        data_type: `binary`, `string`, `imu` or another payload's name.
        payload_bytes: application bytes of a message.
        percentile: the one by which `contenders` are sorted, `p99` or `p50`.
        clarity: whether one of them leads at the median, at p99, or at both; two different leaders are inconclusive.
        contenders: setups, best first.
        leaders: the one that leads, the two that lead at one percentile each, else all that are not shown to be slower than the best.
        relay_device: device of the relay, None without its trace.
        conditions: what surrounded the runs, as in `setting`.
        basis: `between runs`, or `within one run` where a setup has fewer than three: then there is no verdict.
        fewest_runs: runs of the setup that has the fewest.
        leader_p50: setup whose median is clearly below every other's; empty if none is.
        leader_p99: the same of the p99; empty also where some setup has no interval for it.
        repeats_p50: repeats that would probably prove the best median's lead over the setups without a proven difference; None if there are none.
        repeats_p99: the same of the p99.
        interleaved: False if some setups of three runs or more were recorded one after the other.
        drift_ratio: the smallest drift between these that a test would call a difference of medians.
        judgements: who is the fastest, slower, loses more, and is not to be used; `subject` and `base` are names of setups.
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
    repeats_p50: int | None = None
    repeats_p99: int | None = None
    interleaved: bool = True
    drift_ratio: float | None = None
    judgements: tuple[Judgement, ...] = ()

    @property
    def words(self) -> str:
        return group_words({name: getattr(self, name) for name in _WORDS}, _WORDS)

    def of_claim(self, claim: Claim, statistic: str = "") -> list[Judgement]:
        return [row for row in self.judgements if row.claim is claim and statistic in ("", row.statistic)]


def find_answers(
    rows: GroupRows,
    confidence: float = 0.95,
    passes: Mapping[int, int] | None = None,
    *,
    wall_offsets_ns: Mapping[int, int] | None = None,
    outages_ns: Mapping[int, Range] | None = None,
    options: RankingOptions = RankingOptions(),  # noqa: B008 - frozen
) -> tuple[CaseAnswer, ...]:
    """Answer each kind of message of at most `cases.MOST_COMPARED_ROWS` round trips, sorted by `CASE_COLUMNS`.

    `confidence` is of the intervals, and of the verdicts of all kinds together; `passes` is run_id -> repeat of the
    sweep; `wall_offsets_ns` is run_id -> wall clock minus the clock of its stamps (the order of other runs is trusted);
    `outages_ns` is run_id -> start and end (None: of the run) of an outage that the sweep made: what is lost in it speaks
    against no setup.
    """
    if not rows.has_rows:
        return ()
    middlewares = rows.groups.filter(pl.col("backend") != "socket")
    groups = rows.groups if middlewares.is_empty() else middlewares
    names = contender_names(with_conditions(groups))
    parts = partition_groups(with_conditions(groups), (*CASE_COLUMNS, CONDITIONS))

    def measure(part: pl.DataFrame) -> tuple[str, SetupRuns]:
        setting = part.select(CONTENDER_COLUMNS).row(0, named=True)
        setup = SetupRuns.of(rows.frame(part, _ROW_COLUMNS))
        estimates = setup.estimates_of("latency", list(_STATISTICS.values()), confidence)
        repeats = [passes[run.run_id] for run in setup.runs if passes and run.run_id in passes]
        starts_ns = [
            wall_offsets_ns[run.run_id] + first
            for run in setup.runs
            if wall_offsets_ns
            and run.run_id in wall_offsets_ns
            and isinstance(first := run.rows["publish_ns"].min(), int)
        ]
        return names[tuple(setting.values())], replace(
            setup,
            runs=(),
            _made={},
            estimates=dict(zip(_STATISTICS, estimates, strict=True)),
            outside=tuple(_outside(run, (outages_ns or {}).get(run.run_id)) for run in setup.runs),
            repeats=tuple(repeats) if len(set(repeats)) == len(setup.runs) else (),
            starts_ns=tuple(starts_ns) if len(starts_ns) == len(setup.runs) else (),
            survivors_ns={key: setup.of_survivors("latency", statistic) for key, statistic in _STATISTICS.items()},
            setting=setting,
            groups=tuple(part["group"].to_list()),
        )

    cases = [  # rows of one in memory at a time
        _kind(part, dict(map(measure, partition_groups(part, CONTENDER_COLUMNS))))
        for part in parts
        if not is_too_large(part)
    ]
    losers = judge_losers(cases, confidence)
    cases = [
        replace(
            case,
            barred=frozenset(
                name for name in case.barred | _losers(rows) if not _replaces(case.columns, case.setups[name])
            ),
        )
        for case, rows in zip(cases, losers, strict=True)
    ]
    excesses = iter(loss_excesses([setup.outside for case in cases for setup in case.setups.values()], LOSSY_SHARE))
    rankings = rank_setups(cases, confidence, options)
    return tuple(
        _answer(case, ranking, confidence, [*rows, *_judged_losses(case, excesses)])
        for case, ranking, rows in zip(cases, rankings, losers, strict=True)
    )


_STATISTICS = {"p50": Statistic(0.5), "p99": Statistic(0.99)}


def _losers(judged: Sequence[Judgement]) -> frozenset[str]:
    return frozenset(row.subject for row in judged if row.claim is Claim.LOSES_MORE and row.verdict == PROVEN)


def _judged_losses(case: Kind, excesses: Iterator[LossExcess]) -> Iterator[Judgement]:
    for name, setup in case.setups.items():
        requested = Reason.NONE
        if "lifespan_ns" in parse_setting(str(setup.setting["setting"])):
            requested = Reason.AS_REQUESTED
        elif _replaces(case.columns, setup):
            requested = Reason.REPLACED
        if row := judged_losses(name, next(excesses), setup.group, requested):
            yield row


def _replaces(columns: Mapping[str, ParameterValue], setup: SetupRuns) -> bool:
    return is_replacing(columns["rate_hz"], setup.setting["history"])


def _kind(case: pl.DataFrame, setups: Mapping[str, SetupRuns]) -> Kind:
    lossy = frozenset(name for name, setup in setups.items() if exceeds_lossy_share(1.0 - setup.received_share))
    columns = case.select(*CASE_COLUMNS, CONDITIONS).row(0, named=True)
    has_tails = all(setup.estimates["p99"].interval.is_two_sided for setup in setups.values())
    percentiles = tuple(_STATISTICS) if has_tails else ("p50",)
    barred = lossy if len(lossy) < len(setups) else frozenset[str]()  # where all lose too much, one of them may lead
    return Kind(tuple(columns[name] for name in FAMILY), setups, percentiles, columns, barred)


def _outside(run: RunRows, outage_ns: Range | None) -> Bools:
    if outage_ns is None:
        return run.received
    sent_ns = run.rows["publish_ns"].to_numpy()
    start_ns, end_ns = outage_ns
    is_within = (sent_ns >= (start_ns or 0)) & (sent_ns < (np.inf if end_ns is None else end_ns))
    return np.asarray(run.received[~is_within])


def _answer(case: Kind, rankings: Mapping[str, Ranking], confidence: float, losses: Sequence[Judgement]) -> CaseAnswer:
    median, tail = rankings["p50"], rankings.get("p99")
    leaders = list(dict.fromkeys(ranking.leader for ranking in rankings.values() if ranking.leader))
    percentile = "p99" if tail is not None and (tail.leader or not median.leader) else "p50"
    losers = _losers(losses)
    by_name = {
        name: Contender(
            name=name,
            setting=setup.setting,
            latency=setup.estimates[percentile].interval,
            received=received_interval(setup.received, confidence),
            survivors_ns=setup.survivors_ns[percentile],
            loses_more=name in losers,
            p50_ns=setup.estimates["p50"].interval.value,
            p99_ns=setup.estimates["p99"].interval.value,
            letters_p50=median.letters[name],
            letters_p99=tail.letters[name] if tail else "",
            groups=setup.groups,
        )
        for name, setup in case.setups.items()
    }
    ranked = sorted(by_name.values(), key=Contender.order)
    clarity = Clarity.CLEAR if len(leaders) == 1 else Clarity.INCONCLUSIVE
    if len(ranked) == 1:
        clarity = Clarity.ONLY_ONE
    letters = rankings[percentile].letters
    undecided = [
        ranked_setup
        for ranked_setup in ranked
        if ranked_setup is ranked[0]
        or (set(letters[ranked_setup.name]) & set(letters[ranked[0].name]) and not ranked_setup.loses_more)
    ]
    is_between = all(ranked_setup.latency.basis is Basis.BETWEEN_RUNS for ranked_setup in ranked)
    return CaseAnswer(
        **case.columns,
        percentile=percentile,
        clarity=clarity,
        contenders=tuple(ranked),
        leaders=tuple(by_name[name] for name in leaders) or tuple(undecided),
        basis=(Basis.BETWEEN_RUNS if is_between else Basis.WITHIN_RUN).value,
        fewest_runs=min(ranked_setup.latency.runs for ranked_setup in ranked),
        leader_p50=median.leader,
        leader_p99=tail.leader if tail else "",
        repeats_p50=median.lead.needs,
        repeats_p99=tail.lead.needs if tail else None,
        interleaved=median.is_interleaved,
        drift_ratio=median.drift_ratio,
        judgements=(*(row for ranking in rankings.values() for row in (ranking.lead, *ranking.slower)), *losses),
    )
