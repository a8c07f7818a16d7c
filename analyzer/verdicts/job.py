"""A job, as `dds-trace choose` reads it, and guesses of its time."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from typing import Generic, TypeVar

from dds_trace.base.errors import OptionError
from dds_trace.base.units import parse_duration, parse_rate, parse_size, split_quantity

from ..model.metrics import METRICS

DEFAULT_RELIABILITY = "0.99"
"""Share of messages within the deadline where a job names none: 1000 messages can decide it."""

IMU_BYTES = 296
"""Size of a message of `data=imu`: 37 float64."""


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


@dataclass(frozen=True, slots=True)
class _Key(Generic[Value]):
    name: str
    example: str
    parse: Callable[[str], Value | None]

    def value(self, words: Mapping[str, str]) -> Value:
        with suppress(OptionError):
            value = self.parse(words[self.name])
            if value is not None:
                return value
        raise OptionError(f"{self.name} {words[self.name]!r} is not understood; give one as {self.name} {self.example}")


def _share(text: str) -> float | None:
    number, unit = split_quantity(text) or (0.0, "")
    share = {"": number, "%": number / 100}.get(unit, 0.0)
    return share if 0 < share < 1 else None


_DATA = _Key("data", "binary", str)
_SIZE = _Key("size", "502KB", lambda text: parse_size(text) or None)
_RATE = _Key("rate", "20", parse_rate)
_DEADLINE = _Key("deadline", "50ms", parse_duration)
_RELIABILITY = _Key("reliability", "0.999", _share)
_DOMAIN = _Key("domain", "same", lambda text: text if text in {"same", "different"} else None)
_METRIC = _Key("metric", "response", lambda text: text if text in METRICS else None)
_KEYS: dict[str, _Key[str] | _Key[int] | _Key[float]] = {
    key.name: key for key in (_DATA, _SIZE, _RATE, _DEADLINE, _RELIABILITY, _DOMAIN, _METRIC)
}


def parse_job(text: str) -> Job:
    """Read a job from `KEY=VALUE ...`.

    Raises:
        OptionError: a key is unknown, given twice or missing, or a value is of another kind.
    """
    words: dict[str, str] = {}
    for word in text.split():
        name, equals, value = word.partition("=")
        if name not in _KEYS:
            near = difflib.get_close_matches(name, _KEYS, n=1, cutoff=0)[0]
            raise OptionError(f"job {text!r}: no key {name!r}; did you mean {near!r}?")
        if not equals or not value:
            raise OptionError(f"job {text!r}: {name} has no value; write {name}={_KEYS[name].example}")
        if name in words:
            raise OptionError(f"job {text!r}: {name} is given twice")
        words[name] = value
        _KEYS[name].value(words)  # here, to report the first of several errors
    return make_job(words)


def make_job(words: Mapping[str, str]) -> Job:
    """Return the job of key -> value in words.

    Raises:
        OptionError: a key is missing, or a value is of another kind.
    """
    words = {_RELIABILITY.name: DEFAULT_RELIABILITY, _METRIC.name: "response", **words}
    if words.get(_DATA.name) == "imu":
        words.setdefault(_SIZE.name, str(IMU_BYTES))
    missing = [name for name in _KEYS if name not in words and name != _DOMAIN.name]
    if missing:
        examples = ", ".join(f"{name} {_KEYS[name].example}" for name in missing)
        raise OptionError(f"{', '.join(missing)} missing; add {examples}")
    return Job(
        data_type=_DATA.value(words),
        payload_bytes=_SIZE.value(words),
        rate_hz=_RATE.value(words),
        deadline_ns=_DEADLINE.value(words),
        reliability=_RELIABILITY.value(words),
        domain_mode=_DOMAIN.value(words) if _DOMAIN.name in words else None,
        metric=_METRIC.value(words),
    )


SizeAndRate = tuple[float, float]
"""Payload in bytes and rate in Hz, both above 0."""

MIN_ERRORS = 3
"""Held-out measurements below which no guess is made: the largest of so few errors bounds nothing."""


@dataclass(frozen=True, slots=True)
class Guess:
    """An interpolated time, off by at most `error_factor` at all held-out measurements."""

    value_ns: float
    error_factor: float
    held_out: int

    @property
    def lower_ns(self) -> float:
        """The value divided by its error factor."""
        return self.value_ns / self.error_factor

    @property
    def upper_ns(self) -> float:
        """The value times its error factor."""
        return self.value_ns * self.error_factor


def guess_time(measured_ns: Mapping[SizeAndRate, float], at: SizeAndRate) -> Guess | None:
    """Interpolate a time from measured ones; None if these do not surround it, or too few can be held out."""
    logs = {(math.log(size), math.log(rate)): math.log(value) for (size, rate), value in measured_ns.items()}
    log_value = _interpolate(logs, (math.log(at[0]), math.log(at[1])))
    errors = [abs(error) for error in _held_out_errors(logs)]
    if log_value is None or len(errors) < MIN_ERRORS:
        return None
    return Guess(math.exp(log_value), math.exp(max(errors)), len(errors))


def _held_out_errors(logs: Mapping[SizeAndRate, float]) -> Iterable[float]:
    for at, value in logs.items():
        predicted = _interpolate({other: v for other, v in logs.items() if other != at}, at)
        if predicted is not None:
            yield predicted - value


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
    if x in line:
        return line[x]
    for low, high in pairwise(sorted(line)):
        if low < x < high:
            return line[low] + (line[high] - line[low]) * (x - low) / (high - low)
    return None
