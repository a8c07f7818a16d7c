"""A job, as `dds-trace choose` reads it, and a guess of its time."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

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


@dataclass(frozen=True, slots=True)
class Guess:
    """A learned time with its interval by `held_out` results, or why nothing is known (`reason`)."""

    reason: str
    value_ns: float | None = None
    lower_ns: float | None = None
    upper_ns: float | None = None
    held_out: int = 0
