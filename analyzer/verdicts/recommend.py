"""Recommendation: which middleware, bridge and settings meet the deadline of a job.

A setting meets a job if messages arrive within the deadline with the wanted probability, of runs that held the rate and
finished. Lost messages count as infinitely late, so the question is whether the `reliability` quantile of the job's metric (the response, T2 - T0, unless it names another) is
below the deadline, and its confidence interval from the runs (`analyzer/run_statistics/between_runs.py`) gives the answer:
the setting meets the deadline if the upper end does, it misses it if the lower end does, and otherwise these traces cannot
tell. With fewer than three runs, and where the size and rate were not measured, it is `likely` at best. A reply that was
lost makes its message count as lost. Plain sockets are no candidate where a middleware is one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

import polars as pl

from dds_trace.base.units import SECOND_NS, counted

from ..model.parameters import PLACE_COLUMNS, SETTING_COLUMNS
from ..model.setting import condition_of
from ..run_statistics.between_runs import interval_of_runs
from ..run_statistics.runs import Statistic
from ..run_statistics.spread import runs_to_settle_value
from ..statistics.intervals import MIN_RUNS, Basis, ranges_overlap
from ..statistics.percentiles import planned_messages
from ..statistics.power import messages_to_close
from .cases import parts_of
from .job import guess_time
from .matching import MatchedGroup

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from dds_trace.tracefile.format.descriptions import Run

    from ..model.parameters import ParameterValue
    from ..statistics.intervals import Interval, Range
    from .cases import Setting
    from .job import Job, SizeAndRate


RATE_HELD = 0.98
"""Share of the asked rate that a run must have sent: below, it was not this job that was measured."""


class Fit(Enum):
    """Whether a setting meets a job."""

    MEETS = "meets"
    LIKELY = "likely"  # by fewer than three runs, or by a guess
    INCONCLUSIVE = "inconclusive"
    MISSES = "misses"


_FIT_ORDER = {fit: order for order, fit in enumerate(Fit)}


@dataclass(frozen=True, slots=True)
class Candidate:
    """One setting, and how far it meets a job by the traces.

    Attributes:
        setting: value of each of `SETTING_COLUMNS`.
        fit: whether it meets the deadline.
        measured: whether the job's size and rate were measured; otherwise the numbers are a guess from others around it.
        latency_ns: the `reliability` quantile of the latency; infinite if too many messages were lost, None if unknown.
        lower_ns: lower end of the interval (of a guess: the value divided by the largest held-out error), None if unknown.
        upper_ns: upper end of the interval (of a guess: the value times that error), None if unknown.
        margin_ns: deadline less upper end, negative if that is later; None if it is unknown or infinite.
        messages: published messages of the job's size and rate, 0 for a guess.
        held_out: measurements that a guess's error comes from, 0 for a measured candidate.
        tied: whether the interval overlaps that of the best candidate on the same devices and link, under the same
            conditions, so that these traces do not tell the two apart.
        reason: one sentence: why the fit is not `meets`, or what a guess rests on; empty otherwise.
        received_ratio: share of the messages whose reply came back; None for a guess.
        survivors_ns: the `reliability` quantile of the messages that came back; None for a guess and where they are
            too few.
        rate_held: the least share of the asked rate that a run sent; None for a guess.
        runs: runs of the job's size and rate, 0 for a guess.
        basis: `between runs` or `within one run`; empty for a guess.
        episodes: those that the messages beyond the quantile came in; None where there is none, and for a guess.
    """

    setting: Setting
    fit: Fit
    measured: bool
    latency_ns: float | None
    lower_ns: float | None
    upper_ns: float | None
    margin_ns: float | None
    messages: int
    held_out: int
    tied: bool = False
    reason: str = ""
    received_ratio: float | None = None
    survivors_ns: float | None = None
    rate_held: float | None = None
    runs: int = 0
    basis: str = ""
    episodes: int | None = None

    @property
    def range(self) -> Range:
        """Both ends of the interval, ns."""
        return self.lower_ns, self.upper_ns

    def order(self) -> tuple[int, bool, float, float, str]:
        """Return the key by which candidates are ranked: fit, measured before guessed, upper end, estimate, setting."""
        upper, value = (math.inf if v is None else v for v in (self.upper_ns, self.latency_ns))
        return _FIT_ORDER[self.fit], not self.measured, upper, value, str(list(self.setting.items()))


@dataclass(frozen=True, slots=True)
class Recommendation:
    """The candidates for a job.

    Attributes:
        job: what is asked for.
        candidates: best first: those that meet the deadline by their upper end, then the likely, the inconclusive, the
            others.
    """

    job: Job
    candidates: tuple[Candidate, ...]

    @property
    def best(self) -> tuple[Candidate, ...]:
        """Candidates that meet the deadline and cannot be told apart from the first at their place; empty if none meets it."""
        return tuple(c for c in self.candidates if c.fit is Fit.MEETS and c.tied)

    @property
    def is_conclusive(self) -> bool:
        """Whether at every place one candidate alone is best, or every candidate surely misses the deadline."""
        at_places = _by_place(self.candidates).values()
        return bool(at_places) and all(
            len([c for c in at_place if c.fit is Fit.MEETS and c.tied]) == 1
            or all(c.fit is Fit.MISSES and c.measured for c in at_place)
            for at_place in at_places
        )


def recommend_settings(
    roundtrips: pl.DataFrame, job: Job, confidence: float = 0.95, runs: Iterable[Run] = ()
) -> Recommendation:
    """Rank every setting whose latency for a job was measured or can be guessed.

    Args:
        roundtrips: rows of `docs/trace-format.md`.
        job: what is asked for.
        confidence: of the intervals.
        runs: descriptions of the runs, which say whether each finished; one without a description counts as finished.
    """
    unfinished = frozenset(run.run_id for run in runs if run.state != "finished")
    wanted = pl.col("data_type") == job.data_type
    if job.domain_mode is not None:
        wanted &= pl.col("domain_mode") == job.domain_mode
    candidates = [
        candidate
        for setting, part in parts_of(roundtrips.filter(wanted), SETTING_COLUMNS)
        if (candidate := _candidate(setting, part, _Wanted(job, confidence, unfinished))) is not None
    ]
    judged: list[Candidate] = []
    for at_place in _by_place(candidates).values():
        held = sorted(_without_floor(at_place), key=Candidate.order)
        judged += (replace(c, tied=c is held[0] or _is_tied(c, held[0])) for c in held)
    return Recommendation(job, tuple(sorted(judged, key=Candidate.order)))


def place_of(setting: Setting) -> tuple[ParameterValue, ...]:
    """Return devices, link and conditions of a setting: candidates of unlike places are no alternatives."""
    return *(setting[name] for name in PLACE_COLUMNS), condition_of(str(setting["setting"]))


def _by_place(candidates: Iterable[Candidate]) -> dict[tuple[ParameterValue, ...], list[Candidate]]:
    """Part candidates by their places, each part in the order in which they come."""
    places: dict[tuple[ParameterValue, ...], list[Candidate]] = {}
    for candidate in candidates:
        places.setdefault(place_of(candidate.setting), []).append(candidate)
    return places


def _without_floor(candidates: list[Candidate]) -> list[Candidate]:
    """Leave out plain sockets, which are no middleware, unless there is nothing else."""
    return [one for one in candidates if one.setting["backend"] != "socket"] or candidates


def _is_tied(one: Candidate, best: Candidate) -> bool:
    """Tell whether two candidates are not told apart: their intervals overlap, or one has fewer than three runs."""
    is_between = all(c.basis == Basis.BETWEEN_RUNS.value for c in (one, best))
    return not is_between or ranges_overlap(one.range, best.range)


@dataclass(frozen=True, slots=True)
class _Wanted:
    """A job, the confidence of intervals, and the runs that did not finish."""

    job: Job
    confidence: float
    unfinished: frozenset[int]


@dataclass(frozen=True, slots=True, eq=False)
class _Cell:
    """One size and rate of a setting, as far as it was measured.

    Attributes:
        rate_hz: the asked rate.
        interval: of the `reliability` quantile of the latency, ns.
        received_ratio: share of the messages whose reply came back.
        survivors_ns: the quantile of the messages that came back.
        rate_held: the least share of the asked rate that a run sent; None where no run has two messages.
        unfinished: runs that did not finish.
        messages: published messages.
    """

    rate_hz: float
    interval: Interval
    received_ratio: float | None
    survivors_ns: float | None
    rate_held: float | None
    unfinished: int
    messages: int

    def failure(self, deadline_ns: int) -> str:
        """Return why the cell does not do the job, in words; empty where nothing speaks against it."""
        if self.rate_held is not None and self.rate_held < RATE_HELD:
            return f"sent {self.rate_held * self.rate_hz:.4g} Hz where {self.rate_hz:g} Hz were asked"
        if self.unfinished:
            return f"{counted(self.unfinished, 'run')} did not finish"
        if self.interval.value is not None and self.interval.value > deadline_ns:
            lost = 1 - (self.received_ratio or 0.0)
            return "is later than the deadline" + (f" and loses {lost:.2%}" if lost else "")
        return ""


def _measure(rows: pl.DataFrame, wanted: _Wanted) -> _Cell:
    group, statistic = MatchedGroup(rows), Statistic(wanted.job.reliability)
    rate_hz = float(rows["rate_hz"][0])
    held = [share for run in group.runs if (share := _share_of_rate(run.sent_ns, rate_hz)) is not None]
    return _Cell(
        rate_hz=rate_hz,
        interval=interval_of_runs(group.delivered(wanted.job.metric), statistic, wanted.confidence),
        received_ratio=group.received_ratio(wanted.confidence).value,
        survivors_ns=group.of_survivors(wanted.job.metric, statistic),
        rate_held=min(held, default=None),
        unfinished=sum(run.run_id in wanted.unfinished for run in group.runs),
        messages=len(group),
    )


def _share_of_rate(sent_ns: pl.Series, rate_hz: float) -> float | None:
    """Return the rate that a run sent divided by the asked one; None with fewer than two messages."""
    times = sent_ns.unique().sort()
    if len(times) < 2:
        return None
    return float((len(times) - 1) * SECOND_NS / (int(times[-1]) - int(times[0])) / rate_hz)


def _candidate(setting: Setting, part: pl.DataFrame, wanted: _Wanted) -> Candidate | None:
    """Judge a setting by its round trips; None if nothing can be said of it."""
    size_and_rate = ("payload_bytes", "rate_hz")
    cells: dict[SizeAndRate, pl.DataFrame] = {
        rows.select(size_and_rate).row(0): rows for _, rows in parts_of(part, size_and_rate)
    }
    measured = cells.get((wanted.job.payload_bytes, wanted.job.rate_hz))
    if measured is not None:
        return _measured(setting, _measure(measured, wanted), wanted)
    return _guessed(setting, {at: _measure(rows, wanted) for at, rows in cells.items()}, wanted.job)


def _measured(setting: Setting, cell: _Cell, wanted: _Wanted) -> Candidate:
    fit, reason = _fit_of_cell(cell, wanted)
    interval = cell.interval
    return Candidate(
        setting=setting,
        fit=fit,
        measured=True,
        latency_ns=interval.value,
        lower_ns=interval.lower,
        upper_ns=interval.upper,
        margin_ns=_margin(interval.upper, wanted.job.deadline_ns),
        messages=cell.messages,
        held_out=0,
        reason=reason,
        received_ratio=cell.received_ratio,
        survivors_ns=cell.survivors_ns,
        rate_held=cell.rate_held,
        runs=interval.runs,
        basis=interval.basis.value,
        episodes=interval.episodes,
    )


def _fit_of_cell(cell: _Cell, wanted: _Wanted) -> tuple[Fit, str]:
    """Return whether a measured cell meets the job, and why not."""
    job, interval = wanted.job, cell.interval
    fit = _fit(interval.range, job.deadline_ns)
    if cell.rate_held is not None and cell.rate_held < RATE_HELD:
        return Fit.MISSES, cell.failure(job.deadline_ns)
    if cell.unfinished and fit is not Fit.MISSES:
        return Fit.INCONCLUSIVE, cell.failure(job.deadline_ns)
    if fit is Fit.INCONCLUSIVE:
        return fit, _why_inconclusive(interval, wanted)
    if fit is Fit.MEETS and interval.basis is Basis.WITHIN_RUN:
        return (
            Fit.LIKELY,
            f"{Basis.WITHIN_RUN.value}: it takes {MIN_RUNS} runs, there are {interval.runs}",
        )
    return fit, ""


def _why_inconclusive(interval: Interval, wanted: _Wanted) -> str:
    """Return why an interval does not tell, and what it takes."""
    job = wanted.job
    statistic = Statistic(job.reliability)
    inflation = interval.samples / max(1, interval.independent)
    needs = max(planned_messages(job.reliability, wanted.confidence, inflation), statistic.needs)
    if not interval.samples:
        lacking = "schedule" if job.metric == "response" else "relay trace"
        return f"no {lacking}: these messages have no {job.metric}"
    if interval.samples < needs:
        return f"{counted(interval.samples, 'message')}; an interval at {job.reliability:g} takes {needs}"
    more = messages_to_close(interval, job.reliability)
    if more:
        return f"the tail rests on {counted(interval.episodes or 0, 'episode')}; record about {more} more messages"
    runs = runs_to_settle_value(interval, job.deadline_ns)
    what = "record more runs" if runs is None else f"about {max(runs, interval.runs + 1)} runs would tell"
    return f"the deadline lies within the interval; {what}"


def _guessed(setting: Setting, cells: Mapping[SizeAndRate, _Cell], job: Job) -> Candidate | None:
    at = (float(job.payload_bytes), float(job.rate_hz))
    failing = [
        f"{size:g} B at {rate:g} Hz {failure}"
        for size, rate in _neighbours(list(cells), at)
        if (failure := cells[size, rate].failure(job.deadline_ns))
    ]
    if failing:
        return _unknown(setting, f"not measured, and not guessed: {'; '.join(failing)}")
    values = {
        place: cell.interval.value
        for place, cell in cells.items()
        if cell.interval.value is not None and 0 < cell.interval.value < math.inf
    }
    guess = guess_time(values, at)
    if guess is None:
        return None
    fit = _fit((guess.lower_ns, guess.upper_ns), job.deadline_ns)
    return Candidate(
        setting=setting,
        fit=Fit.LIKELY if fit is Fit.MEETS else fit,
        measured=False,
        latency_ns=guess.value_ns,
        lower_ns=guess.lower_ns,
        upper_ns=guess.upper_ns,
        margin_ns=_margin(guess.upper_ns, job.deadline_ns),
        messages=0,
        held_out=guess.held_out,
        reason=(
            f"not measured: interpolated between measured sizes and rates; "
            f"{counted(guess.held_out, 'held-out cell was', 'held-out cells were')} off by a factor of up to {guess.error_factor:.2f}"
        ),
    )


def _unknown(setting: Setting, reason: str) -> Candidate:
    return Candidate(setting, Fit.INCONCLUSIVE, False, None, None, None, None, 0, 0, reason=reason)


def _neighbours(cells: Sequence[SizeAndRate], at: SizeAndRate) -> list[SizeAndRate]:
    """Return the measured cells next to a size and rate; none where the measured ones do not surround it."""
    sides = [_next_to({cell[axis] for cell in cells}, at[axis]) for axis in (0, 1)]
    return [cell for cell in cells if cell[0] in sides[0] and cell[1] in sides[1]]


def _next_to(values: set[float], at: float) -> set[float]:
    """Return the value itself, or the two around it; empty where it lies outside."""
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


def _margin(upper: float | None, deadline_ns: int) -> float | None:
    return None if upper is None or math.isinf(upper) else deadline_ns - upper
