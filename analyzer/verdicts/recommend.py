"""Recommendation: which settings meet the deadline of a job, by the share of late messages, lost ones included, over runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING, Any, TypeAlias

from dds_trace.base.units import SECOND_NS, counted, format_rate, format_size
from dds_trace.tracefile.format.descriptions import Run

from ..model.parameters import SETTING_COLUMNS, SITE_COLUMNS, ParameterValue
from ..model.setting import condition_of
from ..run_statistics.between_runs import interval_of_runs
from ..run_statistics.received import LateShare, late_share
from ..run_statistics.runs import Statistic
from ..run_statistics.spread import runs_to_settle_value
from ..statistics.intervals import MIN_RUNS, Basis, Interval, Range, ranges_overlap
from ..statistics.percentiles import planned_messages
from ..statistics.power import messages_to_close
from .cases import Setting, partition_groups
from .job import Guess, Job
from .matching import SetupRuns

if TYPE_CHECKING:
    import polars as pl

SizeAndRate: TypeAlias = tuple[float, float]

Estimate: TypeAlias = Callable[[Mapping[str, ParameterValue], str], Guess]
"""Values of `SETTING_COLUMNS` and `CELL_COLUMNS`, and why no number can be given (or empty) -> what is known of that result."""

LEAST_RATE = 0.98
"""Share of the planned rate below which another job was measured."""


RARE_KIND = 0.1
"""Share of the runs of a kind that may have been missed."""


LONG_BURST = 30
"""Messages."""


class Fit(Enum):
    """Whether a setting meets a job."""

    MEETS = "meets"
    LIKELY = "likely"  # by fewer than three runs, or by a guess
    INCONCLUSIVE = "inconclusive"
    MISSES = "misses"


_FIT_ORDER = {fit: order for order, fit in enumerate(Fit)}


@dataclass(frozen=True, slots=True)
class Candidate:
    """One setting, and how well it meets a job by the traces.

    Attributes:
        setting: value of each of `SETTING_COLUMNS`.
        fit: whether it meets the deadline.
        measured: whether the job's size and rate were measured; otherwise the numbers are learned from other results.
        value_ns: the `reliability` quantile of `metric`; infinite if too many messages were lost, None if unknown.
        lower_ns: lower end of its interval (of a guess: of 90 %, by left-out results).
        upper_ns: upper end of its interval.
        margin_ns: deadline less upper end; None if that is unknown or infinite.
        messages: published messages of the job's size and rate, 0 for a guess.
        held_out: left-out results that a guess's interval is of.
        tied: whether the interval overlaps with the best candidate's on the same device pair and link, under the same
            conditions.
        reason: one sentence: why the fit is not `meets`, or what a guess rests on; empty otherwise.
        received_ratio: share of the messages whose reply came back; None for a guess.
        survivors_ns: the `reliability` quantile of the received messages; None for a guess and where they are too few.
        rate_held: the least share of the planned rate that a run sent; None for a guess.
        runs: runs of the job's size and rate, 0 for a guess.
        basis: `between runs` or `within one run`; empty for a guess.
        episodes: bursts that the messages beyond the quantile came in; None where there is none, and for a guess.
        late_ratio: share of the messages that were late or lost; None for a guess.
        late_ratio_upper: upper limit of that share for further runs; None for a guess and below three runs.
        unseen_ratio: probability that these runs miss a kind of run that comes once in ten; None for a guess.
        needed: messages in all from which the tail is known; None where it is, and for a guess.
        needed_runs: runs that would decide; None where more of them do not.
        latency_ns: deprecated since 0.2.0, use `value_ns`, which is equal.
    """

    setting: Setting
    fit: Fit
    measured: bool
    value_ns: float | None
    lower_ns: float | None
    upper_ns: float | None
    margin_ns: float | None
    messages: int
    held_out: int
    metric: str
    tied: bool = False
    reason: str = ""
    received_ratio: float | None = None
    survivors_ns: float | None = None
    rate_held: float | None = None
    runs: int = 0
    basis: str = ""
    episodes: int | None = None
    late_ratio: float | None = None
    late_ratio_upper: float | None = None
    unseen_ratio: float | None = None
    needed: int | None = None
    needed_runs: int | None = None
    latency_ns: float | None = None

    def missed_ratio(self, reliability: float) -> float:
        """Return how likely none is late if twice as many as allowed are lost in bursts of `LONG_BURST`."""
        return 0.0 if self.late_ratio else math.exp(-2 * (1 - reliability) * self.messages / LONG_BURST)

    @property
    def range(self) -> Range:
        """Both ends of the interval, ns."""
        return self.lower_ns, self.upper_ns

    def order(self) -> tuple[int, bool, float, float, float, str]:
        """Return the key by which candidates are ranked."""
        upper, value = (math.inf if v is None else v for v in (self.upper_ns, self.value_ns))
        received = -(self.received_ratio or 0.0)
        return _FIT_ORDER[self.fit], not self.measured, upper, value, received, str(list(self.setting.items()))


@dataclass(frozen=True, slots=True)
class Recommendation:
    """The candidates for a job.

    Attributes:
        candidates: best first.
    """

    job: Job
    candidates: tuple[Candidate, ...]

    @property
    def best(self) -> tuple[Candidate, ...]:
        """Candidates that meet the deadline and are tied with the first of their place."""
        return tuple(c for c in self.candidates if c.fit is Fit.MEETS and c.tied)

    @property
    def is_conclusive(self) -> bool:
        """Whether at every place a single candidate is best, or every candidate surely misses the deadline."""
        rankings = _alternatives(self.candidates)
        return bool(rankings) and all(
            sum(c.fit is Fit.MEETS and c.tied for c in candidates) == 1
            or all(c.fit is Fit.MISSES and c.measured for c in candidates)
            for candidates in rankings
        )


def recommend_settings(
    roundtrips: pl.DataFrame,
    job: Job,
    confidence: float = 0.95,
    runs: Iterable[Run] = (),
    estimate: Estimate = lambda _, why: Guess(": ".join(filter(None, ("not measured", why)))),
) -> Recommendation:
    """Rank every setting for a job, as measured or as `estimate` says of its parameters; a run without a description counts as finished."""
    unfinished = frozenset(run.run_id for run in runs if run.state != "finished")
    request = _Request(job, confidence, unfinished, estimate)
    accepted = {"data_type": job.data_type, **({"domain_mode": job.domain_mode} if job.domain_mode else {})}
    parts = partition_groups(roundtrips.filter(**accepted), SETTING_COLUMNS)
    candidates = [_candidate(rows, request) for rows in parts]
    ranked: list[Candidate] = []
    for alternatives in _alternatives(candidates):
        middlewares = [candidate for candidate in alternatives if candidate.setting["backend"] != "socket"]
        ordered = sorted(middlewares or alternatives, key=Candidate.order)
        ranked += (replace(c, tied=_is_tied(c, ordered[0])) for c in ordered)
    return Recommendation(job, tuple(sorted(ranked, key=Candidate.order)))


def place_of(setting: Setting) -> tuple[ParameterValue, ...]:
    """Return device pair, link and conditions of a setting: others are no alternatives."""
    return *(setting[name] for name in SITE_COLUMNS), condition_of(str(setting["setting"]))


def _alternatives(candidates: Iterable[Candidate]) -> list[list[Candidate]]:
    rankings: dict[tuple[ParameterValue, ...], list[Candidate]] = {}
    for candidate in candidates:
        rankings.setdefault(place_of(candidate.setting), []).append(candidate)
    return list(rankings.values())


def _is_tied(candidate: Candidate, best: Candidate) -> bool:
    is_between = all(c.basis == Basis.BETWEEN_RUNS.value for c in (candidate, best))
    return candidate is best or not is_between or ranges_overlap(candidate.range, best.range)


@dataclass(frozen=True, slots=True)
class _Request:
    job: Job
    confidence: float
    unfinished: frozenset[int]
    estimate: Estimate


def _share_of_rate(sent_ns: pl.Series, rate_hz: float) -> float | None:
    times = sent_ns.unique().sort()
    if len(times) < 2 or not rate_hz:
        return None
    return float((len(times) - 1) * SECOND_NS / (int(times[-1]) - int(times[0])) / rate_hz)


def _candidate(rows: pl.DataFrame, request: _Request) -> Candidate:
    setting, size_and_rate = rows.select(SETTING_COLUMNS).row(0, named=True), ("payload_bytes", "rate_hz")
    parts = {part.select(size_and_rate).row(0): part for part in partition_groups(rows, size_and_rate)}
    measured = parts.get((request.job.payload_bytes, request.job.rate_hz))
    if measured is not None:
        return _measured(setting, measured, request)[0]
    return _guessed(setting, {at: _measured(setting, part, request) for at, part in parts.items()}, request)


def _measured(setting: Setting, rows: pl.DataFrame, request: _Request) -> tuple[Candidate, str]:
    """Judge one size and rate, and return why nothing is estimated from it."""
    job, group, statistic = request.job, SetupRuns.of(rows), Statistic(request.job.reliability)
    delivered, rate_hz = group.delivered(job.metric), float(rows["rate_hz"][0])
    interval = interval_of_runs(delivered, statistic, request.confidence)
    late = late_share(delivered, job.deadline_ns, request.confidence)
    shares = (_share_of_rate(run.sent_ns, rate_hz) for run in group.runs)
    rate_held = min((share for share in shares if share is not None), default=None)
    unfinished = sum(run.run_id in request.unfinished for run in group.runs)
    is_slow = rate_held is not None and rate_held < LEAST_RATE
    failure = ""
    if is_slow:
        failure = f"{format_rate((rate_held or 0) * rate_hz)} were sent where {format_rate(rate_hz)} were planned"
    elif unfinished:
        failure = f"{counted(unfinished, 'run')} did not finish"
    fit, reason = _fit_by_runs(interval, late, request)
    if is_slow or (unfinished and fit is not Fit.MISSES):
        fit, reason = Fit.MISSES if is_slow else Fit.INCONCLUSIVE, failure
    received_ratio = group.received_share
    if not failure and interval.value == math.inf:
        failure = f"{100 * (1 - received_ratio):.3g} % are lost"
    candidate = _candidate_of(
        *(setting, job, fit, interval.value, interval.range),
        measured=True,
        messages=group.published,
        reason=reason,
        received_ratio=received_ratio,
        survivors_ns=group.of_survivors(job.metric, statistic),
        rate_held=rate_held,
        runs=interval.runs,
        basis=interval.basis.value,
        episodes=interval.episodes,
        late_ratio=late.observed if late else None,
        late_ratio_upper=late.upper if late else None,
        unseen_ratio=(1 - RARE_KIND) ** interval.runs,
        needed=_needed_messages(interval, request) or _messages_against_bursts(late, interval, request),
        needed_runs=_needed_runs(interval, request) if fit is Fit.INCONCLUSIVE else None,
    )
    return candidate, failure


def _candidate_of(
    setting: Setting,
    job: Job,
    fit: Fit,
    value_ns: float | None,
    ends_ns: Range,
    *,
    measured: bool,
    messages: int = 0,
    held_out: int = 0,
    **more: Any,
) -> Candidate:
    upper_ns = ends_ns[1]
    margin_ns = None if upper_ns is None or math.isinf(upper_ns) else job.deadline_ns - upper_ns
    times_ns = value_ns, *ends_ns, margin_ns
    return Candidate(setting, fit, measured, *times_ns, messages, held_out, job.metric, latency_ns=value_ns, **more)


def _fit_by_runs(interval: Interval, late: LateShare | None, request: _Request) -> tuple[Fit, str]:
    allowed = 1 - request.job.reliability + _ROUNDING
    fit = _fit(interval.range, request.job.deadline_ns)
    is_late = late is not None and late.observed > allowed
    if late is not None and is_late and (fit is Fit.MISSES or (late.lower or 0.0) > allowed):
        return Fit.MISSES, ""
    if fit is Fit.INCONCLUSIVE or late is None:
        return Fit.INCONCLUSIVE, _why_inconclusive(interval, request)
    if is_late or fit is Fit.MISSES or (late.upper_of_seen or 0.0) > allowed:
        limit = "" if late.upper is None else f", of further runs up to {100 * late.upper:.3g} %"
        ends = f"the job allows {100 * (1 - request.job.reliability):.3g} %; record more runs"
        return Fit.INCONCLUSIVE, f"{100 * late.observed:.3g} % of the messages were late{limit}, {ends}"
    lacking = _why_likely(interval, late, request)
    return (Fit.LIKELY, lacking) if lacking else (fit, "")


def _why_likely(interval: Interval, late: LateShare, request: _Request) -> str:
    if interval.basis is Basis.WITHIN_RUN:
        if interval.runs >= MIN_RUNS:
            needs = Statistic(request.job.reliability).needs
            return f"the runs are too short: record {MIN_RUNS} of {needs:,} messages"
        verb = "is" if interval.runs == 1 else "are"
        return f"{interval.basis.value}: it takes {MIN_RUNS} runs, there {verb} {interval.runs}"
    needed = _messages_against_bursts(late, interval, request)
    return f"a burst may not have come: send {needed:,} messages; there are {interval.samples:,}" if needed else ""


def _messages_against_bursts(late: LateShare | None, interval: Interval, request: _Request) -> int | None:
    allowed = 1 - request.job.reliability + _ROUNDING
    if late is None or max(late.observed, late.upper_of_seen or 0.0) > allowed or (late.upper or 0.0) <= allowed:
        return None
    return math.ceil((late.upper or 0.0) * interval.samples / allowed)


_ROUNDING = 1e-12
"""Error of `1 - reliability` in floats."""


def _needed_messages(interval: Interval, request: _Request) -> int | None:
    """Return the messages in all from which the tail is known, if there are fewer."""
    reliability, samples = request.job.reliability, interval.samples
    needs = planned_messages(reliability, request.confidence, samples / max(1, interval.independent))
    needs = max(needs, Statistic(reliability).needs * (interval.runs if interval.basis is Basis.WITHIN_RUN else 1))
    more = needs - samples if samples < needs else messages_to_close(interval, reliability)
    return samples + more if samples and more else None


def _needed_runs(interval: Interval, request: _Request) -> int | None:
    if _fit(interval.range, request.job.deadline_ns) is not Fit.INCONCLUSIVE or _needed_messages(interval, request):
        return None
    runs = runs_to_settle_value(interval, request.job.deadline_ns)
    return None if runs is None else max(runs, interval.runs + 1)


def _why_inconclusive(interval: Interval, request: _Request) -> str:
    job, needed = request.job, _needed_messages(interval, request)
    if not interval.samples:
        lacking = "schedule" if job.metric == "response" else "relay trace"
        return f"no {lacking}: these messages have no {job.metric}"
    if needed is not None:
        return f"to prove {100 * job.reliability:.6g} %, send {needed:,} messages; there are {interval.samples:,}"
    runs = _needed_runs(interval, request)
    advice = "record more runs" if runs is None else f"about {runs} runs would decide"
    return f"the deadline is within the interval; {advice}"


def _guessed(setting: Setting, measured: Mapping[SizeAndRate, tuple[Candidate, str]], request: _Request) -> Candidate:
    job = request.job
    at = (float(job.payload_bytes), float(job.rate_hz))
    sizes, rates = (_next_to({point[axis] for point in measured}, at[axis]) for axis in (0, 1))
    around = [(size, rate) for size, rate in measured if size in sizes and rate in rates]
    words = {point: f"at {format_size(round(point[0]))} and {format_rate(point[1])}" for point in around}
    failing = [f"{words[point]} {failure}" for point in around if (failure := measured[point][1])]
    message: Setting = {"data_type": job.data_type, "payload_bytes": job.payload_bytes, "rate_hz": job.rate_hz}
    guess = request.estimate({**setting, **message}, "; ".join(failing))
    fit = _fit((guess.lower_ns, guess.upper_ns), job.deadline_ns)
    if guess.value_ns is None and not failing and around and len(around) == len(sizes) * len(rates):
        works = all(measured[point][0].fit in (Fit.MEETS, Fit.LIKELY) for point in around)
        does = "the deadline is met" if works else "it is not decided"
        guess = replace(guess, reason=f"{guess.reason}; {' and '.join(words.values())} {does}")
        fit = Fit.MEETS if works else fit
    return _candidate_of(
        *(setting, job, Fit.LIKELY if fit is Fit.MEETS else Fit.INCONCLUSIVE),
        *(guess.value_ns, (guess.lower_ns, guess.upper_ns)),
        measured=False,
        held_out=guess.held_out,
        reason=guess.reason,
    )


def _next_to(values: set[float], at: float) -> set[float]:
    if at in values:
        return {at}
    below, above = [v for v in values if v < at], [v for v in values if v > at]
    return {max(below), min(above)} if below and above else set()


def _fit(interval_ns: Range, deadline_ns: int) -> Fit:
    lower, upper = interval_ns
    if upper is not None and upper <= deadline_ns:
        return Fit.MEETS
    if lower is not None and lower > deadline_ns:
        return Fit.MISSES
    return Fit.INCONCLUSIVE
