"""The reports of one analysis."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from dds_trace.analyzer.analysis import DETAIL_FRAMES

from ..blocks import Report, Section
from .contents import Contents
from .report import sections
from .screen import screen

FORMAT_VERSION = 1
"""A field may be added without a new version."""


class Book(Contents, Report):
    name = "report"
    kicker = "Latency report"

    @property
    def document(self) -> Mapping[str, Any]:
        analysis = self.analysis
        details = analysis.details
        return {
            "format": FORMAT_VERSION,
            "title": analysis.title,
            "measured": self.overview.facts,
            "own_cost": self.own_costs,
            "answer": self.answer,
            "findings": analysis.findings,
            "sources": analysis.sources,
            "sessions": [json.loads(session.to_json()) for session in analysis.sessions],
            "runs": [json.loads(run.to_json()) for run in analysis.runs],
            "groups": analysis.summary,
            "topics": analysis.topics,
            "topic_hops": analysis.topic_hops,
            **{name: getattr(details, name) if details.requested else None for name in DETAIL_FRAMES},
            "judgements": analysis.judgements if details.requested else None,
            "answers": details.answers if details.requested else None,
            "deadline_ns": details.deadline_ns,
            "deadline_metric": details.deadline_metric,
            "recommendation": details.recommendation,
        }

    @property
    def sections(self) -> Sequence[Section]:
        return sections(self)

    @property
    def screen(self) -> Sequence[Section]:
        return self.sections if self.shows_all else screen(self)
