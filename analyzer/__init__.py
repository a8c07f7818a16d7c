"""Traces in, one frozen `Analysis` out.

    from dds_trace import analyze
    a = analyze("runs/")  # a.summary, a.load_roundtrips() ... are polars frames

What the rooms above use; the names for users are on the page of `dds_trace`.
"""

from typing import TYPE_CHECKING

from dds_trace.lazy import contents_page

if TYPE_CHECKING:
    from .analysis import DETAIL_FRAMES, Analysis
    from .clocks.boots import ping_wall_offsets
    from .exports.foxglove import write_derived
    from .exports.tables import export_tables
    from .model.finding import Finding, Severity
    from .model.names import group_words
    from .model.runs import pass_numbers
    from .pipeline import analyze, default_output
    from .recordings.topics import TopicReport, analyze_topics
    from .saving.records import to_json
    from .verdicts.answers import CaseAnswer, Headline, find_headlines
    from .verdicts.compare import CompareOptions, Comparison, compare
    from .verdicts.compared.ignoring import match_without
    from .verdicts.false_alarms import FalseAlarms, count_false_alarms
    from .verdicts.gate import GateOutcome, parse_gates
    from .verdicts.gates import (
        GateResult,
        judge_gates,
        options_for,
        overall_outcome,
        varying_columns,
    )
    from .verdicts.job import parse_job
    from .verdicts.precision import check_statistic, half_widths
    from .verdicts.recommend import Recommendation
else:
    __getattr__, __dir__ = contents_page(__name__)

__all__ = [
    "DETAIL_FRAMES",
    "Analysis",
    "CaseAnswer",
    "CompareOptions",
    "Comparison",
    "FalseAlarms",
    "Finding",
    "GateOutcome",
    "GateResult",
    "Headline",
    "Recommendation",
    "Severity",
    "TopicReport",
    "analyze",
    "analyze_topics",
    "check_statistic",
    "compare",
    "count_false_alarms",
    "default_output",
    "export_tables",
    "find_headlines",
    "group_words",
    "half_widths",
    "judge_gates",
    "match_without",
    "options_for",
    "overall_outcome",
    "parse_gates",
    "parse_job",
    "pass_numbers",
    "ping_wall_offsets",
    "to_json",
    "varying_columns",
    "write_derived",
]
