"""The report of one analysis, its contents computed once for every format and figure."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

from dds_trace.analyzer.analysis import DETAIL_FRAMES, Analysis
from dds_trace.analyzer.groups.report_values import RunSpan, bridge_loads
from dds_trace.base.printable import printable

from ..blocks import MARKDOWN, Block, Facts, Heading, Points, Report, Section, Sentence
from .answer import Conclusion, answer_info
from .facets import Facets, facets_info
from .fastest import Fastest, fastest_setups
from .findings import FindingKind, finding_block, findings_info
from .groups import LATENCY_MEANING, Groups, group_labels, groups_info
from .numbers import BridgedCell, Curves, Intervals, Values, bridge_costs, curves_info, intervals_info, values_info
from .overview import Overview, overview_info
from .recommendation import Advice, advice_blocks, recommendation_info
from .recording import OwnCost, RunTime, own_costs, run_times
from .results import clocks, costs, results, wire
from .screen import screen
from .sizes import HOW_TO_READ, Glance, SizeTable, glance_info, size_block, size_table
from .topics import is_of_topics, topic_sections

FORMAT_VERSION = 1
"""A field may be added without a new version."""


class Book(Report):
    name = "report"
    kicker = "Latency report"

    def __init__(self, analysis: Analysis, *, shows_all: bool = False) -> None:
        self.analysis = analysis
        self.title = printable(analysis.title)
        self.shows_all = shows_all

    @cached_property
    def groups(self) -> Groups:
        return groups_info(self.analysis)

    @cached_property
    def facets(self) -> Facets:
        return facets_info(self.groups)

    @cached_property
    def values(self) -> Values:
        return values_info(self.analysis)

    @cached_property
    def intervals(self) -> Intervals:
        return intervals_info(self.analysis)

    @cached_property
    def curves(self) -> Curves:
        return curves_info(self.analysis)

    @cached_property
    def run_times(self) -> tuple[RunTime, ...]:
        return run_times(self.analysis)

    @cached_property
    def bridge_costs(self) -> tuple[Mapping[int, BridgedCell], int]:
        spans = (
            RunSpan(run.group, run.session.session_id, run.origin_ns, run.last_ns)
            for run in self.run_times
            if run.session is not None
        )
        return bridge_costs(self.analysis, self.groups, bridge_loads(self.analysis.details.host_samples, spans))

    @cached_property
    def own_costs(self) -> tuple[OwnCost, ...]:
        return own_costs(self.analysis)

    @cached_property
    def overview(self) -> Overview:
        return overview_info(self.analysis, self.groups, self.own_costs, self.run_times)

    @cached_property
    def fastest(self) -> list[Fastest]:
        answers = self.analysis.details.answers if self.values.default_metric == "latency" else ()
        return fastest_setups(answers, self.groups.vendors)

    @cached_property
    def answer(self) -> Conclusion:
        return answer_info(self.analysis, self.groups, self.values, self.fastest)

    @cached_property
    def sizes(self) -> SizeTable | None:
        return None if is_of_topics(self.analysis) else size_table(self.analysis, self.groups.vendors)

    @cached_property
    def glance(self) -> Glance | None:
        return glance_info(self.sizes, self.intervals, self.facets)

    @cached_property
    def advice(self) -> Advice | None:
        return recommendation_info(self.analysis.details.recommendation, self.groups.vendors, self.analysis.summary)

    @cached_property
    def findings(self) -> tuple[FindingKind, ...]:
        return findings_info(self.analysis, self.groups, self.values)

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
        answer = self.answer
        findings: list[Block] = [finding_block(kind, group_labels(self.groups)) for kind in self.findings]
        return [
            Section([Heading(f"Latency report: {self.title}", 1)]),
            Section([*advice_blocks(self.advice)], media=MARKDOWN),
            Section([Sentence(answer.headline, "headline"), Points(answer.points)]),
            *([Section([size_block(self.sizes), Sentence(HOW_TO_READ, "soft")])] if self.sizes else []),
            Section([Points(answer.remarks), *([Sentence(answer.rule, "soft")] if answer.rule else [])]),
            *topic_sections(self.analysis),
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
