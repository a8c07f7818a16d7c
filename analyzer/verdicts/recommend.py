"""Recommendation: the settings for a job, best first."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from ..model.parameters import SITE_COLUMNS, ParameterValue
from ..model.setting import condition_of
from ..statistics.intervals import Range
from .cases import Setting
from .job import Job

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


def place_of(setting: Setting) -> tuple[ParameterValue, ...]:
    """Return device pair, link and conditions of a setting: others are no alternatives."""
    return *(setting[name] for name in SITE_COLUMNS), condition_of(str(setting["setting"]))


def alternatives_of(candidates: Iterable[Candidate]) -> list[list[Candidate]]:
    """Return the candidates of each place, in their order."""
    rankings: dict[tuple[ParameterValue, ...], list[Candidate]] = {}
    for candidate in candidates:
        rankings.setdefault(place_of(candidate.setting), []).append(candidate)
    return list(rankings.values())
