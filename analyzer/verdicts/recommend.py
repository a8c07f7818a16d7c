"""Recommendation: which middleware, bridge and settings meet the deadline of a job.

A setting meets a job if messages arrive within the deadline with the wanted probability. Lost messages count as infinitely
late, so the question is whether the `reliability` quantile of the latency is below the deadline, and its confidence
interval (`analyzer/statistics/intervals.py`) gives the answer: the setting meets the deadline if the upper end does, it misses
it if the lower end does, and otherwise these traces cannot tell. A reply that was lost makes its message count as lost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

import polars as pl

from dds_trace.tracefile.units.counts import counted

from ..model.parameters import SETTING_COLUMNS
from ..statistics.intervals import percentile_interval, ranges_overlap
from ..statistics.percentiles import minimum_messages, planned_messages
from .cases import delivered_latencies, parts_of
from .interpolation import guess_time

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..statistics.intervals import Range
    from .cases import Setting
    from .interpolation import SizeAndRate
    from .job import Job


class Fit(Enum):
    """Whether a setting meets a job."""

    MEETS = "meets"
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
        tied: whether the interval overlaps that of the best candidate, so that these traces do not tell the two apart.
        reason: one sentence: why the fit is inconclusive, or what a guess rests on; empty otherwise.
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
        candidates: best first: those that meet the deadline by their upper end, then the inconclusive, then the others.
    """

    job: Job
    candidates: tuple[Candidate, ...]

    @property
    def best(self) -> tuple[Candidate, ...]:
        """Candidates that meet the deadline and cannot be told apart from the first; empty if no candidate meets it."""
        return tuple(c for c in self.candidates if c.fit is Fit.MEETS and c.tied)

    @property
    def is_conclusive(self) -> bool:
        """Whether one candidate alone is best, or every candidate surely misses the deadline."""
        return len(self.best) == 1 or (
            bool(self.candidates) and all(c.fit is Fit.MISSES for c in self.candidates)
        )


def recommend_settings(roundtrips: pl.DataFrame, job: Job, confidence: float = 0.95) -> Recommendation:
    """Rank every setting whose latency for a job was measured or can be guessed.

    Args:
        roundtrips: rows of `docs/trace-format.md`.
        job: what is asked for.
        confidence: of the intervals.
    """
    wanted = pl.col("data_type") == job.data_type
    if job.domain_mode is not None:
        wanted &= pl.col("domain_mode") == job.domain_mode
    candidates = [
        candidate
        for setting, part in parts_of(roundtrips.filter(wanted), SETTING_COLUMNS)
        if (candidate := _candidate(setting, part, job, confidence)) is not None
    ]
    candidates.sort(key=Candidate.order)
    if candidates:
        best = candidates[0]
        candidates = [replace(c, tied=c is best or ranges_overlap(c.range, best.range)) for c in candidates]
    return Recommendation(job, tuple(candidates))


def _candidate(setting: Setting, part: pl.DataFrame, job: Job, confidence: float) -> Candidate | None:
    """Judge a setting by its round trips; None if nothing can be said of it."""
    size_and_rate = ("payload_bytes", "rate_hz")
    cells: dict[SizeAndRate, pl.DataFrame] = {
        rows.select(size_and_rate).row(0): rows for _, rows in parts_of(part, size_and_rate)
    }
    measured = cells.get((job.payload_bytes, job.rate_hz))
    if measured is not None:
        return _measured(setting, measured, job, confidence)
    return _guessed(setting, cells, job)


def _measured(setting: Setting, cell: pl.DataFrame, job: Job, confidence: float) -> Candidate:
    latencies = delivered_latencies(cell)
    interval = percentile_interval(latencies, job.reliability, confidence)
    fit = _fit(interval.range, job.deadline_ns)
    reason = ""
    if fit is Fit.INCONCLUSIVE:
        needs = planned_messages(job.reliability, confidence, interval.samples / max(1, interval.independent))
        needs = max(needs, minimum_messages(job.reliability))
        if not len(latencies):
            reason = "no relay trace: these messages have no latency"
        elif len(latencies) < needs:
            reason = f"{counted(len(latencies), 'message')}; an interval at {job.reliability:g} takes {needs}"
        else:
            reason = "the deadline lies within the interval; record more messages"
    return Candidate(
        setting=setting,
        fit=fit,
        measured=True,
        latency_ns=interval.value,
        lower_ns=interval.lower,
        upper_ns=interval.upper,
        margin_ns=_margin(interval.upper, job.deadline_ns),
        messages=len(cell),
        held_out=0,
        reason=reason,
    )


def _guessed(setting: Setting, cells: Mapping[SizeAndRate, pl.DataFrame], job: Job) -> Candidate | None:
    values = {
        cell: value
        for cell, rows in cells.items()
        if (value := percentile_interval(delivered_latencies(rows), job.reliability).value) is not None
        and 0 < value < math.inf
    }
    guess = guess_time(values, (job.payload_bytes, job.rate_hz))
    if guess is None:
        return None
    return Candidate(
        setting=setting,
        fit=_fit((guess.lower_ns, guess.upper_ns), job.deadline_ns),
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


def _fit(interval_ns: Range, deadline_ns: int) -> Fit:
    lower, upper = interval_ns
    if upper is not None and upper <= deadline_ns:
        return Fit.MEETS
    if lower is not None and lower > deadline_ns:
        return Fit.MISSES
    return Fit.INCONCLUSIVE


def _margin(upper: float | None, deadline_ns: int) -> float | None:
    return None if upper is None or math.isinf(upper) else deadline_ns - upper
