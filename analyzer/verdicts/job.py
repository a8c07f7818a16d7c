"""A job, as `dds-trace choose` reads it, and guesses of its time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from dds_trace.base.errors import OptionError
from dds_trace.base.units import parse_duration, parse_rate, parse_size, split_quantity

from ..model.metrics import METRICS

DEFAULT_RELIABILITY = "0.99"
"""Share of messages within the deadline where a job names none: 1000 messages can decide it."""


@dataclass(frozen=True, slots=True)
class Job:
    """Messages to send, and the deadline for their latency.

    Attributes:
        payload_bytes: application bytes of a message.
        deadline_ns: time within which a reply must arrive.
        reliability: share of messages that must arrive within the deadline, between 0 and 1.
        domain_mode: `same` or `different`; None accepts both.
        metric: of the deadline: `response` (planned send to reply), or another.
    """

    data_type: str
    payload_bytes: int
    rate_hz: float
    deadline_ns: int
    reliability: float
    domain_mode: str | None = None
    metric: str = "response"


Value = TypeVar("Value")


def _read(name: str, parse: Callable[[str], Value | None], text: str, example: str) -> Value:
    with suppress(OptionError):
        value = parse(text)
        if value is not None:
            return value
    raise OptionError(f"--{name} {text!r} is not understood; write {example}")


def _share(text: str) -> float | None:
    number, unit = split_quantity(text) or (0.0, "")
    share = {"": number, "%": number / 100}.get(unit, 0.0)
    return share if 0 < share < 1 else None


def make_job(
    *,
    size: str,
    rate: str,
    deadline: str,
    reliability: str = DEFAULT_RELIABILITY,
    data: str = "binary",
    domain: str | None = None,
    metric: str = "response",
) -> Job:
    """Return the job of the words of `dds-trace choose`: `make_job(size="502KB", rate="20", deadline="50ms")`.

    Raises:
        OptionError: a value is of another kind.
    """
    modes = {"same", "different"}
    return Job(
        data_type=data,
        payload_bytes=_read("size", lambda text: parse_size(text) or None, size, "502KB"),
        rate_hz=_read("rate", parse_rate, rate, "20"),
        deadline_ns=_read("deadline", parse_duration, deadline, "50ms"),
        reliability=_read("reliability", _share, reliability, "0.99 or 99%"),
        domain_mode=domain
        and _read("domain", lambda text: text if text in modes else None, domain, "same or different"),
        metric=_read("metric", lambda text: text if text in METRICS else None, metric, " or ".join(METRICS)),
    )


SizeAndRate = tuple[float, float]
"""Payload in bytes and rate in Hz, both above 0."""

MIN_ERRORS = 3
"""Held-out measurements below which no guess is made: the largest of so few errors bounds nothing."""


@dataclass(frozen=True, slots=True)
class Guess:
    """An interpolated time, off by at most `error_factor` at all held-out measurements."""

    value_ns: float
    lower_ns: float
    upper_ns: float
    error_factor: float
    held_out: int


def guess_time(measured_ns: Mapping[SizeAndRate, float], at: SizeAndRate) -> Guess | None:
    """Interpolate a time from measured ones; None if these do not surround it, or too few can be held out."""
    logs = {(math.log(size), math.log(rate)): math.log(value) for (size, rate), value in measured_ns.items()}
    log_value = _interpolate(logs, (math.log(at[0]), math.log(at[1])))
    errors = [
        abs(predicted - value)
        for point, value in logs.items()
        if (predicted := _interpolate({other: v for other, v in logs.items() if other != point}, point)) is not None
    ]
    if log_value is None or len(errors) < MIN_ERRORS:
        return None
    value_ns, factor = math.exp(log_value), math.exp(max(errors))
    return Guess(value_ns, value_ns / factor, value_ns * factor, factor, len(errors))


def _interpolate(logs: Mapping[SizeAndRate, float], at: SizeAndRate) -> float | None:
    size, rate = at
    swapped = {(r, s): value for (s, r), value in logs.items()}
    values = [v for v in (_two_steps(logs, size, rate), _two_steps(swapped, rate, size)) if v is not None]
    return sum(values) / len(values) if values else None


def _two_steps(logs: Mapping[SizeAndRate, float], first: float, second: float) -> float | None:
    lines: dict[float, dict[float, float]] = {}
    for (x, y), value in logs.items():
        lines.setdefault(y, {})[x] = value
    across = {y: at_first for y, line in lines.items() if (at_first := _between(line, first)) is not None}
    return _between(across, second)


def _between(line: Mapping[float, float], x: float) -> float | None:
    at, values = zip(*sorted(line.items()), strict=True) if line else ((), ())
    return float(np.interp(x, at, values)) if at and at[0] <= x <= at[-1] else None
