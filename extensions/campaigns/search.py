"""The search for the highest rate that holds (docs/how-to/sweep.md): bisection, repeated at the knee."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import Enum
from statistics import fmean
from typing import NamedTuple

from dds_trace.base.units import counted

from .plan.cells import Cell
from .plan.plan import Plan, Search
from .plan.schedule import RELAY_OVERHEAD_S, Estimate, carried_rate, group_by_relay, loss_seconds
from .run.result import CellResult
from .run.runner import Runner
from .run.state import Status

SUSTAINED_SHARE = 0.95
"""Share of the requested rate that the sender must reach."""

LOST_BY_CHANCE = 0.05
"""Losses below this probability are not chance: one of 225 messages says nothing about a limit of 0.1 %."""

MESSAGES_FOR_PERCENTILE = 1.0
"""Messages beyond a percentile: p99 takes 100 messages."""

KNEE_STEPS = 16
"""Most steps by which repeats may move the rate after the bisection."""

_ROUNDED = 1.01
"""Rates of three digits may exceed the resolution by this factor."""


class RateAnswer(Enum):
    FOUND = "found"
    AT_LEAST = "at least"  # the plan's highest rate is sustained, or the steps ran out while the rate still rose
    BELOW = "below"  # not even the lowest rate of the plan is
    FAILED = "failed"  # a trial could not be run


@dataclass(frozen=True, slots=True)
class MaxRate:
    cell: Cell
    answer: RateAnswer
    failing_hz: float | None
    held_repeats: tuple[int, int]
    reason: str


class TrialFailedError(Exception):
    """Failure to run a trial; the text gives the reason."""


class Knee(NamedTuple):
    """The highest sustained rate, the lowest that is not, and the reason."""

    answer: RateAnswer
    rate_hz: float
    failing_hz: float | None
    reason: str


@dataclass(slots=True)
class Bisection:
    """A search of a rate or size; `trial` runs the n-th trial at a value and returns why it was not sustained."""

    lowest: float
    highest: float
    resolution: float
    repeats: int
    trial: Callable[[float, int], str]

    def run(self) -> Knee:
        low, high = self.lowest, self.highest
        is_low_sustained, why = False, ""
        while high / low > self.resolution:
            middle = round_rate(math.sqrt(low * high))
            if not low < middle < high:
                break
            if reason := self._confirmed(middle):
                high, why = middle, reason
            else:
                low, is_low_sustained = middle, True
        # The two given rates cost the most: they are tried only if the search ends at one.
        if not is_low_sustained and (reason := self._majority(low)):
            return Knee(RateAnswer.BELOW, low, low, reason)
        if not why and not (why := self._majority(high)):
            return Knee(RateAnswer.AT_LEAST, high, None, "")
        return self._settle(low, high, why)

    def _settle(self, low: float, high: float, reason: str) -> Knee:
        """Repeat the trials at the knee; a majority moves it, upwards by doubling strides, then by bisection."""
        stride, is_open = self.resolution, False
        for _ in range(KNEE_STEPS):
            if why := self._majority(low):
                high, reason, is_open = low, why, False
                low = round_rate(max(self.lowest, low / self.resolution))
                if high <= self.lowest:
                    return Knee(RateAnswer.BELOW, high, high, reason)
            elif why := self._majority(high):
                reason, is_open, stride = why, False, self.resolution
                if high / low <= _ROUNDED * self.resolution:
                    return Knee(RateAnswer.FOUND, low, high, why)
                middle = round_rate(math.sqrt(low * high))
                low, high = (low, middle) if self._confirmed(middle) else (middle, high)
            else:
                low, high = high, round_rate(min(self.highest, high * stride))
                stride, is_open = stride * stride, True
                if low >= self.highest:
                    return Knee(RateAnswer.AT_LEAST, low, None, "")
        return Knee(RateAnswer.AT_LEAST, low, None, "") if is_open else Knee(RateAnswer.FOUND, low, high, reason)

    def _confirmed(self, rate_hz: float) -> str:
        return self.trial(rate_hz, 1) and self._majority(rate_hz)

    def _majority(self, rate_hz: float) -> str:
        repeats = self.repeats
        reasons = []
        for number in range(1, repeats + 1):
            reasons.append(self.trial(rate_hz, number))
            failed = sum(map(bool, reasons))
            if failed > repeats // 2:
                return next(reason for reason in reversed(reasons) if reason)
            if len(reasons) - failed > repeats // 2:
                return ""
        return ""


def bisect_rates(search: Search, trial: Callable[[float, int], str]) -> Knee:
    return Bisection(search.min_rate, search.max_rate, search.resolution, search.knee_repeats, trial).run()


def round_rate(rate_hz: float) -> float:
    return float(f"{rate_hz:.3g}")


def why_not_sustained(search: Search, rate_hz: float, result: CellResult) -> str:
    achieved_hz = result.achieved_rate_hz or 0.0
    percentile = f"p{search.percentile:g}"
    response_ms = result.response_ms[percentile] if result.response_ms else math.inf
    conditions = (
        (result.cut_off, f"cut off after {result.published:,} of {counted(result.planned, 'message')}"),
        (achieved_hz < SUSTAINED_SHARE * rate_hz, f"{achieved_hz:.0f} of {rate_hz:g} Hz sent"),
        (
            exceeds(result.published - result.received, result.published, search.loss_percent),
            f"{result.loss_percent:.3g} % lost",
        ),
        (response_ms > search.deadline_ms, f"response {percentile} {response_ms:.3g} ms"),
        (bool(result.not_applied), f"not applied: {result.not_applied}"),
    )
    return "; ".join(text for failed, text in conditions if failed)


def exceeds(count: int, total: int, percent: float) -> bool:
    """Return whether a share is above a limit, and not by chance."""
    allowed = percent * total / 100
    fewer = (
        math.fsum(math.exp(n * math.log(allowed) - allowed - math.lgamma(n + 1)) for n in range(count))
        if allowed
        else 1.0
    )
    return count > allowed and 1 - fewer < LOST_BY_CHANCE


def search_plan(plan: Plan) -> Plan:
    cells = dict.fromkeys(replace(cell, rate=plan.search.max_rate) for cell in plan.cells)
    return replace(
        plan,
        name=f"{plan.name}-max-rate",
        cells=tuple(cells),
        run=replace(plan.run, seconds=plan.search.seconds, messages=0, min_messages=messages_needed(plan.search)),
    )


def messages_needed(search: Search) -> int:
    return math.ceil(MESSAGES_FOR_PERCENTILE / (1 - search.percentile / 100) - 1e-9)


class SearchEstimate(NamedTuple):
    recordings: int
    seconds: float


def search_estimate(plan: Plan, cell: Cell, sustained_hz: float) -> SearchEstimate:
    """Return what the search of a cell costs that sustains such a rate."""
    trials: dict[Cell, bool] = {}

    def trial(rate_hz: float, number: int) -> str:
        is_beyond = rate_hz > sustained_hz * _KNEE[number % len(_KNEE)]
        trials[replace(cell, rate=rate_hz, repeat=number)] = is_beyond
        return "beyond" if is_beyond else ""

    bisect_rates(plan.search, trial)
    estimate = Estimate(plan)
    lost = sum(is_beyond and not estimate.link_seconds(tried) for tried, is_beyond in trials.items())
    return SearchEstimate(len(trials), sum(map(estimate.cell_seconds, trials)) + lost * loss_seconds(cell))


def search_estimates(plan: Plan) -> tuple[SearchEstimate, SearchEstimate, SearchEstimate]:
    """Return least, expected and most; expected is the link's rate, without one in half of all cases that all rates work."""
    lowest, highest = plan.search.min_rate, plan.search.max_rate
    rates = [lowest / 2, *(lowest * (highest / lowest) ** (step / _STEPS) for step in range(_STEPS + 1)), 2 * highest]
    relays_s = RELAY_OVERHEAD_S * len(group_by_relay(plan, plan.cells))
    costs, likely = list[list[SearchEstimate]](), list[list[SearchEstimate]]()
    for cell in plan.cells:
        tried = [search_estimate(plan, cell, rate) for rate in rates]
        filled_hz = FILLED_SHARE * carried_rate(plan, cell)
        is_known = filled_hz < 2 * highest
        likely.append([search_estimate(plan, cell, filled_hz)] if is_known else [*tried, *tried[-1:] * len(tried)])
        costs.append([*tried, *likely[-1]])

    def total(choose: Callable[[list[float]], float], cells: list[list[SearchEstimate]]) -> SearchEstimate:
        recordings, seconds = (sum(choose([cost[index] for cost in tried]) for tried in cells) for index in range(2))
        return SearchEstimate(round(recordings), relays_s + seconds)

    return total(min, costs), total(fmean, likely), total(max, costs)


_STEPS = 40
_KNEE = (1.0, 1.1, 0.9)
"""The rate that works differs from run to run."""
FILLED_SHARE = 0.9
"""Share of a link's rate that messages reach."""


def find_max_rates(plan: Plan, runner: Runner) -> Iterator[MaxRate]:
    for group in group_by_relay(plan, plan.cells):
        knees: list[tuple[Cell, Knee]] = []
        with runner.relay(group) as relay:
            for cell in group.cells:

                def trial(rate_hz: float, number: int, cell: Cell = cell) -> str:
                    tried = replace(cell, rate=rate_hz, repeat=number)
                    state = runner.state[tried.name]
                    if not state.done:
                        state = runner.record(tried, relay)
                    if state.status is Status.FAILED or state.result is None:
                        raise TrialFailedError(state.reason)
                    return why_not_sustained(plan.search, rate_hz, state.result)

                try:
                    knees.append((cell, bisect_rates(plan.search, trial)))
                except TrialFailedError as err:
                    knees.append((cell, Knee(RateAnswer.FAILED, 0.0, None, str(err))))
        for cell, knee in knees:
            repeats = _count_sustained(plan, runner, cell, knee.rate_hz)
            yield MaxRate(replace(cell, rate=knee.rate_hz), knee.answer, knee.failing_hz, repeats, knee.reason)


def _count_sustained(plan: Plan, runner: Runner, cell: Cell, rate_hz: float) -> tuple[int, int]:
    names = [replace(cell, rate=rate_hz, repeat=number).name for number in range(1, plan.search.knee_repeats + 1)]
    states = [runner.state[name] for name in names]
    results = [state.result for state in states if state.done and state.result is not None]
    return sum(not why_not_sustained(plan.search, rate_hz, result) for result in results), len(results)
