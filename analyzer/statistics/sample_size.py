"""How many messages a percentile takes: before a run to plan its length, after it to say what it supports.

A two-sided interval for the q-quantile by order statistics exists once the sample is unlikely to lie wholly on one
side of it: `q**n <= (1 - confidence) / 2`, and the same for `1 - q` (H. A. David and H. N. Nagaraja, "Order
Statistics", 3rd ed. 2003, section 7.1). That is 368 independent messages for p99 and 3,688 for p99.9 at 95 %.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

from .percentiles import PERCENTILES


def planned_messages(quantile: float, confidence: float = 0.95, inflation: float = 1.0) -> int:
    """Messages after which a two-sided confidence interval for a quantile exists.

    Args:
        quantile: between 0 and 1, both excluded.
        confidence: between 0 and 1, both excluded.
        inflation: how many messages count as one because neighbours are alike (`variance_inflation`).
    """
    _check(quantile, confidence)
    independent = math.log((1 - confidence) / 2) / math.log(max(quantile, 1 - quantile))
    return math.ceil(round(independent * max(inflation, 1.0), 9))


def minimum_messages(quantile: float) -> int:
    """Messages below which a quantile is not given at all, because the sample holds nothing beyond it.

    One over the share of the distribution that lies beyond: 10 for p90, 20 for p95, 100 for p99, 1000 for p99.9
    (`docs/trace-format.md`). That makes a point estimate; the interval takes `planned_messages`.
    """
    _check(quantile, 0.5)
    if quantile <= 0.5:
        return 1
    return math.ceil(
        1 / (1 - Fraction(str(quantile)))
    )  # exact: 1 / (1 - 0.9) is 10.000000000000002 in floats


def supported_percentiles(messages: int) -> tuple[str, ...]:
    """Names of the summary's percentiles that a sample of this size supports."""
    return tuple(p.name for p in PERCENTILES if messages >= p.needs)


@dataclass(frozen=True, slots=True)
class RunLength:
    """How long a run has to be for one percentile.

    Attributes:
        quantile: the wanted quantile.
        confidence: of the two-sided interval.
        messages: messages to count, warm-up and losses not included.
        duration_s: their time at the asked rate.
    """

    quantile: float
    confidence: float
    messages: int
    duration_s: float


def plan_run(
    quantile: float,
    rate_hz: float,
    *,
    confidence: float = 0.95,
    inflation: float = 1.0,
    received_ratio: float = 1.0,
) -> RunLength:
    """The length of a run whose sample gives the quantile a confidence interval.

    Args:
        quantile: the wanted quantile.
        rate_hz: messages per second.
        confidence: of the two-sided interval.
        inflation: as for `planned_messages`, from an earlier run on the same link.
        received_ratio: share of messages that come back; lost ones add nothing to a latency sample.
    """
    if not rate_hz > 0 or not 0 < received_ratio <= 1:
        raise ValueError("a run has a rate above 0 and a received ratio between 0 and 1")
    messages = math.ceil(planned_messages(quantile, confidence, inflation) / received_ratio)
    return RunLength(quantile, confidence, messages, messages / rate_hz)


def _check(quantile: float, confidence: float) -> None:
    if not 0 < quantile < 1 or not 0 < confidence < 1:
        raise ValueError("quantile and confidence lie between 0 and 1, both excluded")
