"""A job, as `--recommend` takes it: `data=binary size=502KB rate=20 deadline=50ms reliability=0.999`."""

from __future__ import annotations

import difflib
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

from dds_trace.tracefile.errors import OptionError
from dds_trace.tracefile.units.durations import parse_duration
from dds_trace.tracefile.units.quantities import split_quantity
from dds_trace.tracefile.units.rates import parse_rate
from dds_trace.tracefile.units.sizes import parse_size

from ..model.metrics import METRICS

if TYPE_CHECKING:
    from collections.abc import Callable

DEFAULT_RELIABILITY = "0.99"
"""Share of messages that must arrive within the deadline where a job does not say: what 1000 messages can tell."""

IMU_BYTES = 296
"""Size of a message of `data=imu`: 37 float64."""


@dataclass(frozen=True, slots=True)
class Job:
    """Messages to send, and what is asked of their latency.

    Attributes:
        data_type: `binary`, `string`, `imu` or another payload's name.
        payload_bytes: application bytes of a message.
        rate_hz: messages per second.
        deadline_ns: time within which a reply must be there.
        reliability: share of messages that must arrive within the deadline, between 0 and 1, both excluded.
        domain_mode: `same` or `different`; None accepts both.
        metric: time that the deadline is for: `response` (planned send to reply), or another metric.
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
    """A key of the text.

    Attributes:
        name: as it is written.
        example: a value, for error messages.
        parse: value of the text; None, or `OptionError`, if it is not of the key's kind.
    """

    name: str
    example: str
    parse: Callable[[str], Value | None]

    def value(self, words: dict[str, str], text: str) -> Value:
        """Return the value that `words` has for this key.

        Raises:
            OptionError: the value is not of the key's kind.
        """
        with suppress(OptionError):
            value = self.parse(words[self.name])
            if value is not None:
                return value
        raise OptionError(
            f"--recommend {text!r}: {self.name}={words[self.name]} is not understood; write {self.name}={self.example}"
        )


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

    Keys: `data`, `size` (bytes, KB, MB, KiB, MiB; `data=imu` needs none), `rate` (Hz), `deadline` (ns, us, ms, s),
    and optionally `reliability` (0.999 or 99.9%; `DEFAULT_RELIABILITY`) and `domain` (same or different).

    Raises:
        OptionError: a key is unknown, given twice or missing, or a value is not of its kind; the message names it.
    """
    words: dict[str, str] = {}
    for word in text.split():
        name, equals, value = word.partition("=")
        if name not in _KEYS:
            near = difflib.get_close_matches(name, _KEYS, n=1, cutoff=0)[0]
            raise OptionError(f"--recommend {text!r}: no key {name!r}; did you mean {near!r}?")
        if not equals or not value:
            raise OptionError(
                f"--recommend {text!r}: {name} has no value; write {name}={_KEYS[name].example}"
            )
        if name in words:
            raise OptionError(f"--recommend {text!r}: {name} is given twice")
        words[name] = value
        _KEYS[name].value(words, text)  # here, so that of several errors the first one is reported
    if words.get(_DATA.name) == "imu":
        words.setdefault(_SIZE.name, str(IMU_BYTES))
    words.setdefault(_RELIABILITY.name, DEFAULT_RELIABILITY)
    missing = [name for name in _KEYS if name not in words and name not in (_DOMAIN.name, _METRIC.name)]
    if missing:
        wanted = " ".join(f"{name}={_KEYS[name].example}" for name in missing)
        raise OptionError(f"--recommend {text!r}: {', '.join(missing)} missing; add {wanted}")
    return Job(
        data_type=_DATA.value(words, text),
        payload_bytes=_SIZE.value(words, text),
        rate_hz=_RATE.value(words, text),
        deadline_ns=_DEADLINE.value(words, text),
        reliability=_RELIABILITY.value(words, text),
        domain_mode=_DOMAIN.value(words, text) if _DOMAIN.name in words else None,
        metric=_METRIC.value(words, text) if _METRIC.name in words else "response",
    )
