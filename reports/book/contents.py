"""Contents of the reports of one analysis, computed once for every reporter and figure."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.groups.report_values import RunSpan, bridge_loads
from dds_trace.base.extension import load
from dds_trace.base.printable import printable

from ..blocks import Block
from .answer import Conclusion, answer_info
from .facets import Facets, facets_info
from .fastest import Fastest, fastest_setups
from .findings import FindingKind, findings_info
from .groups import Groups, groups_info, is_of_topics
from .numbers import BridgedCell, Curves, Intervals, Values, bridge_costs, curves_info, intervals_info, values_info
from .overview import Overview, overview_info
from .recording import OwnCost, RunTime, own_costs, run_times
from .sizes import Glance, SizeTable, glance_info, size_table


class Contents:
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
    def advice(self) -> Any:
        """The recommendation in words; None without a job."""
        recommendation = self.analysis.details.recommendation
        if recommendation is None:
            return None
        return load("parts", "advice")(recommendation, self.groups.vendors, self.analysis.summary)

    def advice_blocks(self, most: int | None = None) -> list[Block]:
        return [*self.advice.blocks(most)] if self.advice else []

    @cached_property
    def findings(self) -> tuple[FindingKind, ...]:
        return findings_info(self.analysis, self.groups, self.values)
