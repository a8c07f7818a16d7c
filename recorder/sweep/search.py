"""The highest rate that a middleware holds: bisection between two rates, repeated at the knee.

A rate holds if the schedule was kept, no more was lost than allowed, and the percentile of the response time
(planned send to reply, so that a sender that falls behind is not let off) keeps the deadline.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

from dds_trace.tracefile.units.counts import counted

from .plan.schedule import group_by_relay
from .run.state import Status

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from typing import Any

    from .plan.cells import Cell
    from .plan.plan import Plan, Search
    from .run.runner import Runner

HELD_SHARE = 0.95
"""Of the asked rate, that the sender has to reach."""

MESSAGES_FOR_PERCENTILE = 1.0
"""A percentile needs at least one message beyond it: p99 takes 100 messages."""

KNEE_STEPS = 10
"""Most steps away from where the bisection ended, if repeats contradict it."""


class Answer(Enum):
    """What a search found."""

    FOUND = "found"
    AT_LEAST = "at least"  # even the highest rate of the plan holds
    BELOW = "below"  # even the lowest rate of the plan does not hold
    FAILED = "failed"  # a trial could not be run at all


@dataclass(frozen=True, slots=True)
class MaxRate:
    """The answer for one cell, its rate apart.

    Attributes:
        cell: what was searched; its `rate` is the answer.
        answer: how to read the rate.
        failing_hz: the lowest rate known not to hold, None if none was found.
        held_repeats: how many of the runs at the answer held, of how many.
        reason: why the next rate did not hold, or why the search failed.
    """

    cell: Cell
    answer: Answer
    failing_hz: float | None
    held_repeats: tuple[int, int]
    reason: str


class TrialFailedError(Exception):
    """A trial could not be run; the text says why."""


@dataclass(slots=True)
class Bisection:
    """Searches between the plan's two rates.

    Attributes:
        trial: runs one trial at a rate for the n-th time; empty text if it held, else why it did not.
    """

    search: Search
    trial: Callable[[float, int], str]

    def run(self) -> tuple[Answer, float, float | None, str]:
        """Answer, the highest rate that holds, the lowest that does not, and why it does not."""
        low, high = self.search.min_rate, self.search.max_rate
        low_held, why = False, ""
        while high / low > self.search.resolution:
            middle = round_rate(math.sqrt(low * high))
            if not low < middle < high:
                break
            if said := self.trial(middle, 1):
                high, why = middle, said
            else:
                low, low_held = middle, True
        # The two given rates are tried only where the search ended at one of them: they cost the most.
        if not low_held and (said := self._majority(low)):
            return Answer.BELOW, low, low, said
        if not why and not (why := self._majority(high)):
            return Answer.AT_LEAST, high, None, ""
        return self._settle(low, high, why)

    def _settle(self, low: float, high: float, reason: str) -> tuple[Answer, float, float | None, str]:
        """Repeats at the knee; where the majority contradicts the single trial, it moves by one step."""
        for _ in range(KNEE_STEPS):
            if why := self._majority(low):
                high, reason = low, why
                low = round_rate(max(self.search.min_rate, low / self.search.resolution))
                if high <= self.search.min_rate:
                    return Answer.BELOW, high, high, reason
            elif why := self._majority(high):
                return Answer.FOUND, low, high, why
            else:
                low, high = high, round_rate(min(self.search.max_rate, high * self.search.resolution))
                if low >= self.search.max_rate:
                    return Answer.AT_LEAST, low, None, ""
        return Answer.FOUND, low, high, reason

    def _majority(self, rate_hz: float) -> str:
        """Why most repeats at this rate did not hold; empty if most did."""
        repeats = self.search.knee_repeats
        reasons = []
        for number in range(1, repeats + 1):
            reasons.append(self.trial(rate_hz, number))
            failed = sum(map(bool, reasons))
            if failed > repeats // 2:
                return next(reason for reason in reversed(reasons) if reason)
            if len(reasons) - failed > repeats // 2:
                return ""
        return ""


def round_rate(rate_hz: float) -> float:
    """Three digits, so that a rate can be named and met again."""
    return float(f"{rate_hz:.3g}")


def why_not_held(search: Search, asked_hz: float, result: Mapping[str, Any]) -> str:
    """Why a run did not hold its rate, empty if it did.

    Args:
        search: the conditions.
        asked_hz: the rate that was asked for.
        result: a `CellResult` as a mapping.
    """
    achieved_hz = result["achieved_rate_hz"] or 0.0
    lost = result["published"] - result["received"]
    loss_percent = 100.0 * lost / result["published"] if result["published"] else 100.0
    percentile = f"p{search.percentile:g}"
    response_ms = result["response_ms"][percentile] if result["response_ms"] else math.inf
    conditions = (
        (
            result["cut_off"],
            f"cut off after {result['published']} of {counted(result['planned'], 'message')}",
        ),
        (achieved_hz < HELD_SHARE * asked_hz, f"{achieved_hz:.0f} of {asked_hz:g} messages a second sent"),
        (loss_percent > search.loss_percent, f"{loss_percent:.3g} % lost"),
        (response_ms > search.deadline_ms, f"response {percentile} {response_ms:.3g} ms"),
    )
    return "; ".join(text for failed, text in conditions if failed)


def search_plan(plan: Plan) -> Plan:
    """The plan whose runs are long enough for the percentile, each rate apart (`cells` keep one rate each)."""
    cells = dict.fromkeys(replace(cell, rate=plan.search.max_rate) for cell in plan.cells)
    return replace(
        plan,
        name=f"{plan.name}-max-rate",
        cells=tuple(cells),
        run=replace(
            plan.run, seconds=plan.search.seconds, messages=0, min_messages=messages_needed(plan.search)
        ),
    )


def messages_needed(search: Search) -> int:
    """Messages that a run takes for the search's percentile to be more than its largest value."""
    return math.ceil(MESSAGES_FOR_PERCENTILE / (1 - search.percentile / 100) - 1e-9)


def find_max_rates(plan: Plan, runner: Runner) -> Iterator[MaxRate]:
    """The answer for each cell of a `search_plan`, as it is found; trials that are complete are not run again."""
    for group in group_by_relay(plan, plan.cells):
        found: list[tuple[Cell, tuple[Answer, float, float | None, str]]] = []
        with runner.relay(group) as relay:
            for cell in group.cells:

                def trial(rate_hz: float, number: int, cell: Cell = cell) -> str:
                    tried = replace(cell, rate=rate_hz, repeat=number)
                    state = runner.state[tried.name]
                    if not state.done:
                        state = runner.record(tried, relay)
                    if state.status is Status.FAILED:
                        raise TrialFailedError(state.reason)
                    return why_not_held(plan.search, rate_hz, state.result)

                try:
                    found.append((cell, Bisection(plan.search, trial).run()))
                except TrialFailedError as err:
                    found.append((cell, (Answer.FAILED, 0.0, None, str(err))))
        for cell, (answer, rate_hz, failing_hz, reason) in found:
            yield MaxRate(
                replace(cell, rate=rate_hz), answer, failing_hz, _held(plan, runner, cell, rate_hz), reason
            )


def _held(plan: Plan, runner: Runner, cell: Cell, rate_hz: float) -> tuple[int, int]:
    names = [
        replace(cell, rate=rate_hz, repeat=number).name for number in range(1, plan.search.knee_repeats + 1)
    ]
    tried = [runner.state[name] for name in names if runner.state[name].done]
    return sum(not why_not_held(plan.search, rate_hz, state.result) for state in tried), len(tried)
