"""The records of a saved analysis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dds_trace.base.records import RecordReader

from ..model.finding import Finding, Source
from ..statistics.intervals import Interval
from ..verdicts.answers import CaseAnswer
from ..verdicts.job import Job
from ..verdicts.judgements import Judgement
from ..verdicts.recommend import Recommendation

_NAMES = {
    "CaseAnswer": CaseAnswer,
    "Finding": Finding,
    "Interval": Interval,
    "Job": Job,
    "Judgement": Judgement,
    "Mapping": Mapping,
    "Recommendation": Recommendation,
    "Setting": Mapping[str, str | int | float | None],
    "Source": Source,
}


@dataclass(frozen=True, slots=True)
class Content:
    """All fields of `Analysis` and `Details` but the frames; `sessions` and `runs` are JSON texts."""

    title: str
    sources: tuple[Source, ...]
    sessions: tuple[str, ...]
    runs: tuple[str, ...]
    timeline_decimated: bool
    findings: tuple[Finding, ...]
    outputs: Mapping[str, str]
    answers: tuple[CaseAnswer, ...]
    deadline_ns: int | None
    deadline_metric: str
    recommendation: Recommendation | None
    requested: bool
    unsent: Mapping[str, int]


from_json = RecordReader(_NAMES).read
"""Read what `to_json` wrote, equal or refused."""
