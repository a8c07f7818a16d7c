"""Which middleware, bridge and settings do for a job: `data=binary size=502KB rate=20 deadline=50ms reliability=0.999`.

A setting does if messages arrive within the deadline with the wanted probability. Lost messages count as infinitely
late, so the question is whether the `reliability` quantile of the latency is below the deadline, and its confidence
interval (`analyzer/statistics/intervals.py`) gives the answer: it meets the deadline if the upper end does, it misses it if the
lower end does, and otherwise these traces cannot tell. A reply that was lost makes its message count as lost.
"""

from __future__ import annotations

import difflib
import math
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from dds_trace.tracefile.errors import OptionError
from dds_trace.tracefile.units.counts import counted
from dds_trace.tracefile.units.durations import parse_duration
from dds_trace.tracefile.units.quantities import split_quantity
from dds_trace.tracefile.units.rates import parse_rate
from dds_trace.tracefile.units.sizes import parse_size

from ..model.parameters import SETTING_COLUMNS
from ..statistics.intervals import percentile_interval, ranges_overlap
from ..statistics.percentiles import minimum_messages, planned_messages
from .interpolation import guess_cell

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

IMU_BYTES = 296
"""37 float64, the only size that `data=imu` has."""


@dataclass(frozen=True, slots=True)
class Job:
    """What is asked for.

    Attributes:
        reliability: share of messages that must arrive within the deadline, between 0 and 1, both excluded.
        domain_mode: `same`, `different`, or None where both will do.
    """

    data_type: str
    payload_bytes: int
    rate_hz: float
    deadline_ns: int
    reliability: float
    domain_mode: str | None = None


def parse_job(text: str) -> Job:
    """The job that `KEY=VALUE ...` describes.

    Keys: `data`, `size` (bytes, KB, MB, KiB, MiB; `data=imu` needs none), `rate` (Hz), `deadline` (ns, us, ms, s),
    `reliability` (0.999 or 99.9%), and optionally `domain` (same or different).

    Raises:
        OptionError: a key is unknown, given twice or missing, or a value is not of its kind; the message names it.
    """
    values: dict[str, Any] = {}
    for word in text.split():
        key, equals, value = word.partition("=")
        if key not in _KEYS:
            near = difflib.get_close_matches(key, _KEYS, n=1, cutoff=0)[0]
            raise OptionError(f"--recommend {text!r}: no key {key!r}; did you mean {near!r}?")
        if not equals or not value:
            raise OptionError(f"--recommend {text!r}: {key} has no value; write {key}={_EXAMPLES[key]}")
        if key in values:
            raise OptionError(f"--recommend {text!r}: {key} is given twice")
        with suppress(OptionError):
            values[key] = _KEYS[key](value)
        if values.get(key) is None:
            raise OptionError(
                f"--recommend {text!r}: {key}={value} is not understood; write {key}={_EXAMPLES[key]}"
            )
    if values.get("data") == "imu":
        values.setdefault("size", IMU_BYTES)
    missing = [key for key in _KEYS if key not in values and key != "domain"]
    if missing:
        wanted = " ".join(f"{key}={_EXAMPLES[key]}" for key in missing)
        raise OptionError(f"--recommend {text!r}: {', '.join(missing)} missing; add {wanted}")
    return Job(
        values["data"],
        values["size"],
        values["rate"],
        values["deadline"],
        values["reliability"],
        values.get("domain"),
    )


def _share(text: str) -> float | None:
    number, unit = split_quantity(text) or (0.0, "")
    share = {"": number, "%": number / 100}.get(unit, 0.0)
    return share if 0 < share < 1 else None


_KEYS: dict[str, Callable[[str], Any]] = {
    "data": str,
    "size": lambda text: parse_size(text) or None,
    "rate": parse_rate,
    "deadline": parse_duration,
    "reliability": _share,
    "domain": lambda text: text if text in {"same", "different"} else None,
}
_EXAMPLES = {
    "data": "binary",
    "size": "502KB",
    "rate": "20",
    "deadline": "50ms",
    "reliability": "0.999",
    "domain": "same",
}


class Fit(Enum):
    """Whether a setting does for a job."""

    MEETS = "meets"
    INCONCLUSIVE = "inconclusive"
    MISSES = "misses"


_FIT_ORDER = {fit: order for order, fit in enumerate(Fit)}


@dataclass(frozen=True, slots=True)
class Candidate:
    """One setting and what the traces say of it for a job.

    Attributes:
        setting: the columns `SETTING_COLUMNS`.
        fit: whether it does.
        measured: False where the cell was not measured and the numbers are a guess from cells around it.
        latency_ns: the `reliability` quantile of the latency; infinite if too many messages were lost, None if unknown.
        lower_ns: lower end of its interval (of a guess: the value divided by the largest held-out error), None if unknown.
        upper_ns: upper end, likewise.
        margin_ns: deadline less upper end; negative where it is beyond, None where it is unknown or infinite.
        messages: published messages of the cell, 0 for a guess.
        held_out: cells that a guess's error comes from, 0 for a measured cell.
        tied: its interval overlaps that of the best candidate, so these traces do not tell the two apart.
        reason: one sentence: why it is inconclusive, or what a guess rests on; empty otherwise.
    """

    setting: Mapping[str, Any]
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


@dataclass(frozen=True, slots=True)
class Recommendation:
    """The ranking for a job.

    Attributes:
        candidates: best first: those that meet the deadline by their upper end, then the inconclusive, then the others.
    """

    job: Job
    candidates: tuple[Candidate, ...]

    @property
    def best(self) -> tuple[Candidate, ...]:
        """The candidates that meet the deadline and cannot be told apart from the first; empty if none meets it."""
        return tuple(c for c in self.candidates if c.fit is Fit.MEETS and c.tied)

    @property
    def is_conclusive(self) -> bool:
        """Whether one candidate alone is best, or every candidate surely misses the deadline."""
        return len(self.best) == 1 or (
            bool(self.candidates) and all(c.fit is Fit.MISSES for c in self.candidates)
        )


def delivered_latencies(roundtrips: pl.DataFrame) -> NDArray[np.float64]:
    """Latency of each message in the order of the frame, infinite if it was lost; empty if no latency is known.

    A reply that came back without the relay's stamps took at most half of its round trip. It counts with that: left
    out, it would give the lost ones more weight than they have.
    """
    if roundtrips["latency_ns"].null_count() == len(roundtrips):
        return np.empty(0, np.float64)
    lost = pl.col("outcome") != "completed"
    at_most = pl.coalesce(pl.col("latency_ns").cast(pl.Float64), pl.col("rtt_ns") / 2)
    return (
        roundtrips.select(pl.when(lost).then(math.inf).otherwise(at_most)).to_series().drop_nulls().to_numpy()
    )


def recommend_settings(roundtrips: pl.DataFrame, job: Job, confidence: float = 0.95) -> Recommendation:
    """The ranking of every setting that the traces say something about.

    Args:
        roundtrips: frame of `docs/trace-format.md`.
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
    candidates.sort(key=_order)
    if candidates:
        best = candidates[0]
        candidates = [replace(c, tied=c is best or _overlap(c, best)) for c in candidates]
    return Recommendation(job, tuple(candidates))


def parts_of(frame: pl.DataFrame, columns: Sequence[str]) -> Iterator[tuple[dict[str, Any], pl.DataFrame]]:
    """The frame by the values of some columns, messages of a part in the order of time within each run."""

    def key(part: pl.DataFrame) -> list[tuple[bool, Any]]:
        return [(value is not None, value) for value in part.row(0)]

    parts = [(part.select(columns), part) for part in frame.partition_by(*columns, maintain_order=True)]
    for of_part, part in sorted(parts, key=lambda held: key(held[0])):
        yield of_part.row(0, named=True), part.sort("run_id", "relay_id", "publish_ns")


def _candidate(setting: dict[str, Any], part: pl.DataFrame, job: Job, confidence: float) -> Candidate | None:
    cells = {
        (c["payload_bytes"], c["rate_hz"]): rows for c, rows in parts_of(part, ("payload_bytes", "rate_hz"))
    }
    measured = cells.get((job.payload_bytes, job.rate_hz))
    if measured is not None:
        return _measured(setting, measured, job, confidence)
    return _guessed(setting, cells, job)


def _measured(setting: dict[str, Any], cell: pl.DataFrame, job: Job, confidence: float) -> Candidate:
    latencies = delivered_latencies(cell)
    interval = percentile_interval(latencies, job.reliability, confidence)
    fit = _fit(interval.lower, interval.upper, job.deadline_ns)
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


def _guessed(
    setting: dict[str, Any], cells: Mapping[tuple[float, float], pl.DataFrame], job: Job
) -> Candidate | None:
    values = {
        cell: value
        for cell, rows in cells.items()
        if (value := percentile_interval(delivered_latencies(rows), job.reliability).value) is not None
        and 0 < value < math.inf
    }
    guess = guess_cell(values, (job.payload_bytes, job.rate_hz))
    if guess is None:
        return None
    return Candidate(
        setting=setting,
        fit=_fit(guess.lower_ns, guess.upper_ns, job.deadline_ns),
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


def _fit(lower: float | None, upper: float | None, deadline_ns: int) -> Fit:
    if upper is not None and upper <= deadline_ns:
        return Fit.MEETS
    if lower is not None and lower > deadline_ns:
        return Fit.MISSES
    return Fit.INCONCLUSIVE


def _margin(upper: float | None, deadline_ns: int) -> float | None:
    return None if upper is None or math.isinf(upper) else deadline_ns - upper


def _order(candidate: Candidate) -> tuple[int, bool, float, float, str]:
    """Those that meet first, measured before guessed, then by upper end and estimate (infinite where unknown)."""
    upper, value = (math.inf if v is None else v for v in (candidate.upper_ns, candidate.latency_ns))
    return (
        _FIT_ORDER[candidate.fit],
        not candidate.measured,
        upper,
        value,
        str(list(candidate.setting.items())),
    )


def _overlap(one: Candidate, other: Candidate) -> bool:
    return ranges_overlap((one.lower_ns, one.upper_ns), (other.lower_ns, other.upper_ns))
