"""A race of candidates: short runs of all, more and longer ones of those that no run excludes.

A candidate that keeps the limits precedes one that does not; of those that keep them the faster one precedes.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from dds_trace.analyzer.statistics.percentiles import minimum_messages, quantile_of
from dds_trace.base.records import to_json
from dds_trace.base.units import format_rate, format_size, three_digits

from .plan.cells import Cell
from .search import exceeds

LOST_MS = 10_000.0
"""Response of a lost message where times are averaged."""

PASSES = 2
"""Runs of a length, one of each candidate in a pass; the next ones take twice as long. So many are needed to exclude one."""

FIRST_SECONDS, MOST_FIRST_SECONDS = 2.0, 6.0
"""Length of the first runs, and where the time of the looks has room for `PASSES` of all candidates."""

FIRST_SHARE, FIRST_RUNS = 0.6, 2
"""Most of the time of the looks that the first pass may take if a limit is kept, and runs of it that are made whatever they take."""

NO_TIME, NO_MORE_TIME = "not tried, time was kept for fresh runs", "with no time for more runs"

LEAST_SPREAD, DISTANCE = 0.05, 2.5
"""A candidate is slower if it is so by as many standard errors; runs spread by at least 5 %."""

QUANTILES = (0.5, 0.99)
"""Quantiles of the response by which candidates are ordered."""

MOSTLY = 0.5
"""Share of late messages for which one run is enough."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A middleware with a bundle of settings, empty and without `path` for the defaults; `cells` are its messages.

    `turn` is 0 for the first of a middleware likely to hold on the link, 1 for other defaults, 2 for the rest.
    """

    middleware: str
    vendor: str
    bundle: str
    cells: tuple[Cell, ...]
    path: Path | None = None
    turn: int = 0

    @property
    def name(self) -> str:
        return f"{self.middleware} {self.bundle or 'default'}"


@dataclass(frozen=True, slots=True)
class Limits:
    """What a candidate has to keep: shares in percent of the messages, CPU of each recording process in percent of one processor."""

    deadline_ms: float = math.inf
    loss_percent: float = 1.0
    late_percent: float = 1.0
    cpu_percent: float = math.inf


@dataclass(frozen=True, slots=True)
class Look:
    """One run of a candidate; `response_ms` has planned send to reply for each message of the plan, infinite where none came."""

    response_ms: tuple[NDArray[np.float64], ...] = ()
    cpu_percent: float = 0.0
    failure: str = ""

    @property
    def level(self) -> float:
        """Logarithm of the geometric mean of p50 and p99 over all messages."""
        ordered = [np.sort(np.minimum(values, LOST_MS)) for values in self.response_ms]
        return float(np.log([quantile_of(values, quantile) for values in ordered for quantile in QUANTILES]).mean())


@dataclass(frozen=True, slots=True)
class Event:
    """A step of the search.

    Attributes:
        stage: `link`, `look`, `proof`, `fit` or `answer`.
        state: of the candidate: `running`, `measured` or `dropped`; empty for a note.
        text: a line for a person.
        messages, lost, late: of all its runs of the stage so far; `p50_ms` and `p99_ms` of the response, infinite where such a message was lost.
        slowest_ms: of too few messages for p99.
        left_s: rest of the time of the whole search.
    """

    stage: str
    text: str = ""
    candidate: Candidate | None = None
    state: str = ""
    runs: int = 0
    messages: int = 0
    lost: int = 0
    late: int = 0
    p50_ms: float | None = None
    p99_ms: float | None = None
    left_s: float = 0.0
    slowest_ms: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the event as JSON takes it: of `candidate` its `name`, `middleware` and `bundle`; an infinite time is null."""
        row: dict[str, Any] = to_json(replace(self, candidate=None), not_finite=lambda _: None)
        if self.candidate is not None:
            row["candidate"] = {key: getattr(self.candidate, key) for key in ("name", "middleware", "vendor", "bundle")}
        return row


@dataclass(slots=True)
class Standing:
    """What was measured of a candidate; `dropped` is why it takes no further part."""

    candidate: Candidate
    looks: list[Look] = field(default_factory=list)
    dropped: str = ""

    @property
    def level(self) -> float:
        return float(np.mean([look.level for look in self.looks])) if self.looks else math.inf

    def responses(self) -> list[NDArray[np.float64]]:
        """Return the responses of all runs in ms, an array for each message of the plan."""
        return [np.concatenate(values) for values in zip(*(look.response_ms for look in self.looks), strict=True)]

    def excess(self, limits: Limits) -> tuple[float, str]:
        """Return by what share the limits are exceeded for sure, and in words; 0 where they are kept."""
        excesses = [(0.0, "")]
        for values in self.responses():
            lost, late = int(np.isinf(values).sum()), int((values > limits.deadline_ms).sum())
            for count, percent, words in (
                (lost, limits.loss_percent, "lost"),
                (late, limits.late_percent, f"later than {limits.deadline_ms:g} ms"),
            ):
                if exceeds(count, len(values), percent):
                    share = count / len(values)
                    excesses.append((share - percent / 100, f"{share:.1%} {words}"))
        cpu = float(np.mean([look.cpu_percent for look in self.looks])) if self.looks else 0.0
        if cpu > limits.cpu_percent:
            excesses.append((cpu / limits.cpu_percent - 1, f"{cpu:.0f} % of a processor"))
        return max(excesses)

    def event(self, stage: str, limits: Limits, state: str = "", text: str = "") -> Event:
        """Describe all runs so far."""
        name, values = self.candidate.name, np.sort(np.concatenate([*self.responses(), []]))
        lost, late = int(np.isinf(values).sum()), int((values > limits.deadline_ms).sum())
        if stage == "fit":
            cell = max(self.candidate.cells, key=lambda cell: cell.payload_bit_s or 0.0)
            name += f", {format_size(cell.size or 0)} at" * bool(cell.size) + f" {format_rate(cell.rate)}"
        p50, p99 = (quantile_of(values, quantile) if len(values) else None for quantile in QUANTILES)
        slowest = float(values[-1]) if 0 < len(values) < minimum_messages(QUANTILES[-1]) else None
        slow = f"p99 {ms_words(p99)}" if slowest is None else f"slowest {ms_words(slowest)}"
        words = f"{name}: p50 {ms_words(p50)}, {slow}, {lost} of {len(values)} lost" if len(values) else name
        counts = len(self.looks), len(values), lost, late
        return Event(stage, text or words, self.candidate, state, *counts, p50, p99, slowest_ms=slowest)

    def rank(self, limits: Limits) -> tuple[bool, bool, float, float]:
        return bool(self.dropped), not self.looks, self.excess(limits)[0], self.level


Tell: TypeAlias = Callable[[Event], None]
"""Receiver of the steps, between runs; what it raises ends the search, with its recordings kept."""


class Measurer(Protocol):
    def look(self, candidate: Candidate, number: int, seconds: float) -> Look:
        """Record the candidate's run of this number."""

    def expected_s(self, candidate: Candidate, seconds: float) -> float:
        """Return how long such a run is expected to take with its start and end."""


@dataclass(slots=True)
class Race:
    """The runs of some candidates, `tell` gets each; what begins is expected to end before `until_s` of `clock`.

    `reserve_s` is what later steps need of it.
    """

    measurer: Measurer
    limits: Limits
    until_s: float
    tell: Tell
    clock: Callable[[], float] = time.monotonic
    stage: str = "look"
    reserve_s: Callable[[], float] = lambda: 0.0
    _began_s: float = field(init=False)
    _is_open: bool = field(default=True, init=False)  # no candidate has kept the limits yet

    def __post_init__(self) -> None:
        self._began_s = self.clock()

    def has_time(self, candidate: Candidate, seconds: float, number: int = 0) -> bool:
        """Return whether such a run is expected to end in time."""
        return self.measurer.expected_s(candidate, seconds) <= self._left_s(number)

    def _left_s(self, number: int) -> float:
        share = FIRST_SHARE if number == 1 and not self._is_open else 1.0
        until_s = self._began_s + share * (self.until_s - self.reserve_s() - self._began_s)
        return until_s - self.clock()

    def run(self, standing: Standing, seconds: float, number: int = 0) -> None:
        """Record the next run of a candidate, or the run of this number; of one that cannot run nothing counts."""
        candidate, number = standing.candidate, number or len(standing.looks) + 1
        self._tell(standing, "running", f"{candidate.name}: run {number}")
        look = self.measurer.look(candidate, number, seconds)
        if look.failure:
            standing.looks.clear()
            self.drop(standing, look.failure)
            return
        standing.looks.append(look)
        self._is_open = self._is_open and standing.excess(self.limits)[0] > 0
        self._tell(standing, "measured")

    def drop(self, standing: Standing, reason: str) -> None:
        standing.dropped = reason
        self._tell(standing, "dropped", f"{standing.candidate.name} gets no more runs: {reason}")

    def halve(self, candidates: Sequence[Candidate], first_s: float = FIRST_SECONDS) -> list[Standing]:
        """Return all candidates, best first; those that no time was left for are dropped, too."""
        standings = [Standing(candidate) for candidate in candidates]
        racing, seconds = standings, first_s
        for number in itertools.count(1):
            if number > 1:
                racing = self._affordable(racing, seconds, number)
            for index, standing in enumerate(racing):  # the best first: the time may end
                if (number == 1 and index < FIRST_RUNS) or self.has_time(standing.candidate, seconds, number):
                    self.run(standing, seconds)
                elif not standing.looks:
                    self.drop(standing, NO_TIME)
            if len(racing := self._not_excluded(racing)) < 2 and number >= PASSES:
                break
            seconds *= 2 if number % PASSES == 0 else 1
        running = [standing for standing in standings if not standing.dropped]
        for standing in running:  # of an unfinished pass some have more and longer runs
            del standing.looks[min(len(row.looks) for row in running) :]
        return sorted(standings, key=lambda standing: standing.rank(self.limits))

    def _affordable(self, racing: Sequence[Standing], seconds: float, number: int) -> list[Standing]:
        """Drop those without time in a pass and the next of its length; of two none is dropped, or both are run."""
        left_s = self._left_s(number)
        passes = 1 if number == PASSES else PASSES - (number - 1) % PASSES
        costs_s = (passes * self.measurer.expected_s(standing.candidate, seconds) for standing in racing)
        fitting = sum(total_s <= left_s for total_s in itertools.accumulate(costs_s))
        for standing in racing[max(FIRST_RUNS, fitting) :]:
            self.drop(standing, f"{self._times_words(standing, racing[0])}, {NO_MORE_TIME}")
        return list(racing[:fitting]) if fitting >= min(FIRST_RUNS, len(racing)) else []

    def _not_excluded(self, racing: Sequence[Standing]) -> list[Standing]:
        """Drop what the evidence excludes; return the others, best first."""
        ranked = sorted((row for row in racing if not row.dropped), key=lambda row: row.rank(self.limits))
        spread = self._spread(ranked)
        for standing in ranked[1:]:
            best, (excess, words) = ranked[0], standing.excess(self.limits)
            least_excess = best.excess(self.limits)[0]
            error = spread * math.sqrt(1 / len(best.looks) + 1 / len(standing.looks))
            is_sure = min(len(best.looks), len(standing.looks)) >= PASSES
            if excess > (least_excess if is_sure and not least_excess else max(MOSTLY, least_excess)):
                self.drop(standing, words)
            elif is_sure and excess == least_excess and standing.level - best.level > DISTANCE * error:
                self.drop(standing, self._times_words(standing, best))
        return [standing for standing in ranked if not standing.dropped]

    @staticmethod
    def _spread(standings: Sequence[Standing]) -> float:
        """Return the standard deviation of runs of one candidate, pooled."""
        squares = [(look.level - row.level) ** 2 for row in standings for look in row.looks]
        return max(LEAST_SPREAD, math.sqrt(sum(squares) / max(1, len(squares) - len(standings))))

    @staticmethod
    def _times_words(standing: Standing, best: Standing) -> str:
        return f"{math.exp(standing.level - best.level):.2f} times as long as {best.candidate.name}"

    def _tell(self, standing: Standing, state: str, text: str = "") -> None:
        self.tell(standing.event(self.stage, self.limits, state, text))


def ms_words(value: float | None) -> str:
    """Write a time to three digits; infinite is a lost message."""
    return "-" if value is None else "lost" if math.isinf(value) else f"{three_digits(value)} ms"
