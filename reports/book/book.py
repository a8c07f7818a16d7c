"""The report of one analysis."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from dds_trace.analyzer.analysis import DETAIL_FRAMES
from dds_trace.analyzer.model.columns import PARQUET_ENCODINGS

from ..blocks import MARKDOWN, Block, Facts, Heading, Points, Report, Section, Sentence
from .contents import Contents
from .findings import finding_block
from .groups import LATENCY_MEANING, group_labels, topic_parts
from .results import clocks, costs, results, wire
from .screen import screen
from .sizes import HOW_TO_READ, size_block

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
            "parquet_encodings": PARQUET_ENCODINGS,
        }

    @property
    def sections(self) -> Sequence[Section]:
        answer = self.answer
        findings: list[Block] = [finding_block(kind, group_labels(self.groups)) for kind in self.findings]
        return [
            Section([Heading(f"Latency report: {self.title}", 1)]),
            Section(self.advice_blocks(), media=MARKDOWN),
            Section([Sentence(answer.headline, "headline"), Points(answer.points)]),
            *([Section([size_block(self.sizes), Sentence(HOW_TO_READ, "soft")])] if self.sizes else []),
            Section([Points(answer.remarks), *([Sentence(answer.rule, "soft")] if answer.rule else [])]),
            *topic_parts(self.analysis, "topic_sections"),
            Section(
                [
                    Heading("What was measured", media=MARKDOWN),
                    Facts([(fact.label, fact.value) for fact in self.overview.facts]),
                    Sentence(LATENCY_MEANING, media=MARKDOWN),
                ]
            ),
            Section(
                [Heading("Findings", media=MARKDOWN), *(findings or [Sentence("Nothing doubtful was found.", "soft")])]
            ),
            Section([*results(self)]),
            Section([*costs(self), *wire(self), *clocks(self)], media=MARKDOWN),
            *screen(self),
        ]

    @property
    def screen(self) -> Sequence[Section]:
        return self.sections if self.shows_all else screen(self)
