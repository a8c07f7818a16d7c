"""The recommendation in words: what was asked for, which settings do it, and what that rests on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.tracefile.units.counts import counted
from dds_trace.tracefile.units.durations import format_duration
from dds_trace.tracefile.units.rates import format_rate
from dds_trace.tracefile.units.sizes import format_size
from dds_trace.tracefile.visible import visible

from ..text import format_ratio
from .groups import data_type_label

if TYPE_CHECKING:
    from collections.abc import Mapping

    from dds_trace.analyzer import Recommendation
    from dds_trace.analyzer.model.parameters import ParameterValue
    from dds_trace.analyzer.verdicts.recommend import Candidate

COLUMNS = ("Setting", "Does it", "Latency", "95 % interval", "Received", "Of those", "Rests on", "Why")
"""Headings of `Advice.rows`; `Of those` is the figure of the messages that came back."""


@dataclass(frozen=True, slots=True)
class Advice:
    """A recommendation as text.

    Attributes:
        asked: the job in words, with its deadline.
        said: one sentence: which settings meet it.
        rows: one row of text per candidate, columns of `COLUMNS`.
    """

    asked: str
    said: str
    rows: tuple[tuple[str, ...], ...]


def recommendation_info(recommendation: Recommendation | None) -> Advice | None:
    """Put a recommendation into words; None without one."""
    if recommendation is None:
        return None
    job = recommendation.job
    asked = (
        f"{data_type_label(job.data_type)} {format_size(job.payload_bytes)} at {format_rate(job.rate_hz)}: "
        f"{format_ratio(job.reliability)} of the messages within the deadline of {format_duration(job.deadline_ns)}"
    )
    if job.domain_mode is not None:
        asked += f", {visible(job.domain_mode)} domain" + ("s" if job.domain_mode == "different" else "")
    varying = _varying(recommendation.candidates)
    return Advice(
        asked=f"{asked}.",
        said=_said(recommendation, varying),
        rows=tuple(_row(candidate, varying) for candidate in recommendation.candidates),
    )


def _said(recommendation: Recommendation, varying: list[str]) -> str:
    if not recommendation.candidates:
        return "The traces say nothing of such messages."
    best = [_name(candidate.setting, varying) for candidate in recommendation.best]
    if best:
        told = "meets it" if len(best) == 1 else "meet it, and these traces do not tell them apart"
        return f"{', '.join(best)} {told}."
    likely = [_name(c.setting, varying) for c in recommendation.candidates if c.fit.value == "likely"]
    if likely:
        return f"Nothing is shown to meet it; likely: {', '.join(likely)}."
    if recommendation.is_conclusive:
        return "Every setting that was measured misses it."
    return "Inconclusive: no setting is shown to meet it."


def _varying(candidates: tuple[Candidate, ...]) -> list[str]:
    """Return the parameters that tell candidates apart, and always those of middleware and bridge."""
    always = {"vendor", "bridge"}
    names = list(candidates[0].setting) if candidates else []
    return [name for name in names if name in always or len({c.setting[name] for c in candidates}) > 1]


def _name(setting: Mapping[str, ParameterValue], varying: list[str]) -> str:
    return " ".join(f"{name}={visible(setting[name])}" for name in varying if setting[name] is not None)


def _row(candidate: Candidate, varying: list[str]) -> tuple[str, ...]:
    rests = "a guess"
    if candidate.measured:
        rests = counted(candidate.runs, "run")
        if candidate.basis == "within one run":
            rests += f", {candidate.basis}"
        if candidate.episodes is not None:
            rests += f", {counted(candidate.episodes, 'episode')}"
    return (
        _name(candidate.setting, varying),
        candidate.fit.value,
        _time(candidate.latency_ns),
        f"{_time(candidate.lower_ns)} to {_time(candidate.upper_ns)}",
        format_ratio(candidate.received_ratio),
        _time(candidate.survivors_ns),
        rests,
        candidate.reason,
    )


def _time(value_ns: float | None) -> str:
    if value_ns is None:
        return "unknown"
    return "lost" if math.isinf(value_ns) else format_duration(value_ns)
