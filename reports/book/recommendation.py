"""The recommendation in words: what was asked for, which settings do it, and what that rests on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.analyzer.model.parameters import SITE_COLUMNS
from dds_trace.analyzer.model.setting import choice_of
from dds_trace.analyzer.verdicts.recommend import Fit, place_of
from dds_trace.base.printable import printable
from dds_trace.base.units import counted, format_duration, format_rate, format_size

from .groups import METRIC_LABELS, data_type_label, format_ratio, setting_labels
from .verdicts import place_label

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from dds_trace.analyzer.verdicts.cases import Setting
    from dds_trace.analyzer.verdicts.job import Job
    from dds_trace.analyzer.verdicts.recommend import Candidate, Recommendation

    from .groups import VendorLabels

COLUMNS = ("Setting", "Does it", "Time", "95 % interval", "Received", "Of those", "Rests on", "Why")
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

    @property
    def brief_rows(self) -> tuple[tuple[str, str, str], ...]:
        """The rows for narrow places: setting, whether it does the job, and all numbers in one text."""
        return tuple(_brief(dict(zip(COLUMNS, row, strict=True))) for row in self.rows)


def _brief(told: Mapping[str, str]) -> tuple[str, str, str]:
    numbers = f"{told['Time']} (95 %: {told['95 % interval']}), received {told['Received']}"
    if told["Time"] == "lost":
        numbers += f" (those in {told['Of those']})"
    return told["Setting"], told["Does it"], f"{numbers}; {told['Rests on']}. {told['Why']}".strip()


def recommendation_info(recommendation: Recommendation | None, vendors: VendorLabels) -> Advice | None:
    """Put a recommendation into words; None without one."""
    if recommendation is None:
        return None
    candidates = recommendation.candidates
    names = setting_labels([_choice(candidate.setting) for candidate in candidates], vendors)
    places = [_place(candidate) for candidate in candidates]
    several = len(set(places)) > 1
    named = [f"{name}, on {place}" if several else name for name, place in zip(names, places, strict=True)]
    at_place: dict[str, list[tuple[Candidate, str]]] = {}
    for candidate, name, place in zip(candidates, names, places, strict=True):
        at_place.setdefault(place, []).append((candidate, name))
    deadline = f"the deadline of {format_duration(recommendation.job.deadline_ns)}"
    said = [
        f"{f'On {place}: ' if several else ''}{_said(told, deadline, opens=not several)}"
        for place, told in at_place.items()
    ]
    return Advice(
        asked=_asked(recommendation.job),
        said=" ".join(said) or _NOTHING,
        rows=tuple(_row(candidate, name) for candidate, name in zip(candidates, named, strict=True)),
    )


_FITS = {Fit.INCONCLUSIVE: "not known"}
"""Words of a fit in place of its name."""


def _choice(setting: Setting) -> Setting:
    """Return a setting without its place, which is told apart."""
    return {**setting, **dict.fromkeys(SITE_COLUMNS, ""), "setting": choice_of(str(setting["setting"]))}


def _place(candidate: Candidate) -> str:
    ping_device, relay_device, connectivity, conditions = place_of(candidate.setting)
    relay = None if relay_device is None else str(relay_device)
    return place_label(str(ping_device), relay, str(connectivity), str(conditions))


_NOTHING = "The traces say nothing of such messages: their size and rate were not measured, and no measured ones surround them."

_JUDGED_BY = {"response": "from planned send to reply", "latency": "by the latency, the mean of both ways"}
"""Metric of a job -> what the deadline is for, in words; any other metric by its label."""


def _asked(job: Job) -> str:
    judged_by = _JUDGED_BY.get(
        job.metric, f"by the {METRIC_LABELS.get(job.metric, printable(job.metric)).lower()}"
    )
    asked = (
        f"{data_type_label(job.data_type)} {format_size(job.payload_bytes)} at {format_rate(job.rate_hz)}: "
        f"{format_ratio(job.reliability)} of the messages within the deadline of {format_duration(job.deadline_ns)}, {judged_by}"
    )
    if job.domain_mode is not None:
        asked += f"; {printable(job.domain_mode)} domain" + ("s" if job.domain_mode == "different" else "")
    return f"{asked}."


def _said(told: Sequence[tuple[Candidate, str]], deadline: str, *, opens: bool) -> str:
    """Return which settings of one place meet the deadline, in one sentence.

    Args:
        told: candidates with their names, best first.
        deadline: the deadline in words.
        opens: whether the words open a sentence.
    """
    best = [name for candidate, name in told if candidate.fit is Fit.MEETS and candidate.tied]
    if best:
        verb = (
            f"meets {deadline}"
            if len(best) == 1
            else f"meet {deadline}, and these traces do not tell them apart"
        )
        return f"{_and(best)} {verb}."
    likely = [name for candidate, name in told if candidate.fit is Fit.LIKELY]
    if likely:
        said = f"nothing is shown to meet {deadline}; likely to meet it: {_and(likely)}."
    elif all(candidate.fit is Fit.MISSES and candidate.measured for candidate, _ in told):
        said = f"every setting that was measured misses {deadline}."
    else:
        said = f"nothing is shown to meet {deadline}, and nothing to miss it for sure."
    return said[0].upper() + said[1:] if opens else said


def _and(names: Sequence[str]) -> str:
    """Join names, which hold commas themselves."""
    *first, last = names
    return f"{'; '.join(first)} and {last}" if first else last


def _row(candidate: Candidate, name: str) -> tuple[str, ...]:
    rests = "a guess"
    if candidate.measured:
        rests = counted(candidate.runs, "run")
        if candidate.basis == "within one run":
            rests += f", {candidate.basis}"
        if candidate.episodes is not None:
            rests += f", {counted(candidate.episodes, 'episode')}"
    return (
        name,
        _FITS.get(candidate.fit, candidate.fit.value),
        _time(candidate.value_ns),
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
