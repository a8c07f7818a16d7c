"""Which settings meet the deadline of a job, by the share of late messages, lost ones included, over runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import polars as pl

from dds_trace.analyzer.model.parameters import SETTING_COLUMNS, ParameterValue
from dds_trace.analyzer.run_statistics.between_runs import interval_of_runs
from dds_trace.analyzer.run_statistics.received import LateShare, late_share
from dds_trace.analyzer.run_statistics.runs import Statistic
from dds_trace.analyzer.run_statistics.spread import runs_to_settle_value
from dds_trace.analyzer.statistics.intervals import MIN_RUNS, Basis, Interval, Range, ranges_overlap
from dds_trace.analyzer.statistics.percentiles import planned_messages
from dds_trace.analyzer.statistics.power import messages_to_close
from dds_trace.analyzer.verdicts.cases import Setting, partition_groups
from dds_trace.analyzer.verdicts.job import Guess, Job
from dds_trace.analyzer.verdicts.recommend import Candidate, Fit, Recommendation, alternatives_of
from dds_trace.analyzer.verdicts.setup_runs import SetupRuns
from dds_trace.base.units import SECOND_NS, counted, format_rate, format_size
from dds_trace.tracefile.format.descriptions import Run

from .learning.model import overload

SizeAndRate: TypeAlias = tuple[float, float]

Estimate: TypeAlias = Callable[[Mapping[str, ParameterValue], str], Guess]
"""Values of `SETTING_COLUMNS` and `CELL_COLUMNS`, and why no number can be given (or empty) -> what is known of that result."""

LEAST_RATE = 0.98
"""Share of the planned rate below which another job was measured."""


RARE_KIND = 0.1
"""Share of the runs of a kind that may have been missed."""


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
    for alternatives in alternatives_of(candidates):
        middlewares = [candidate for candidate in alternatives if candidate.setting["backend"] != "socket"]
        ordered = sorted(middlewares or alternatives, key=Candidate.order)
        ranked += (replace(c, tied=_is_tied(c, ordered[0])) for c in ordered)
    return Recommendation(job, tuple(sorted(ranked, key=Candidate.order)))


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
    if fit is Fit.MISSES:
        load = overload(str(setting["setting"]), float(rows["payload_bytes"][0]), rate_hz)
        reason = "; ".join(filter(None, (reason, load)))
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
    if guess.value_ns is guess.lower_ns is None and not failing and around and len(around) == len(sizes) * len(rates):
        works = all(measured[point][0].fit in (Fit.MEETS, Fit.LIKELY) for point in around)
        does = "the deadline is met" if works else "it is not decided"
        guess = replace(guess, reason=f"{guess.reason}; {' and '.join(words.values())} {does}")
        fit = Fit.MEETS if works else fit
    if guess.lower_ns != math.inf:  # no more than the link carries
        fit = Fit.LIKELY if fit is Fit.MEETS else Fit.INCONCLUSIVE
    return _candidate_of(
        *(setting, job, fit),
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
