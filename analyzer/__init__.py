"""Traces in, one frozen `Analysis` out.

from . import analyze
a = analyze("runs/")          # a.summary, a.roundtrips ... are polars frames
"""

from .analysis import Analysis, Details
from .clocks.boots import ping_wall_offsets
from .clocks.fit import ClockFit, ClockKnot, ClockSegment, ClockStep
from .exports.foxglove import DerivedTrace, write_derived
from .exports.tables import EXPORTERS, export_tables
from .groups.breakdown import (
    STAGES,
    break_down,
    response_against_latency,
    summarize_breakdown,
)
from .groups.freshness import outage_table, summarize_freshness
from .model.column import Column
from .model.columns import (
    MEASURED_COLUMNS,
    ROUNDTRIP_COLUMNS,
    STATISTICS,
    SUMMARY_COLUMNS,
)
from .model.finding import Finding, Severity
from .model.metrics import METRICS
from .model.parameters import MATCH_COLUMNS, PARAMETER_COLUMNS
from .model.source import Source
from .pairing.pair import Outcome
from .pipeline import analyze, default_output
from .recordings.topics import TopicReport, analyze_topics
from .statistics.intervals import Interval, percentile_interval, ratio_interval
from .statistics.percentiles import PERCENTILES, Percentile, minimum_messages, planned_messages
from .verdicts.answers import CaseAnswer, Headline, find_headlines
from .verdicts.compare import CompareOptions, Comparison, compare_roundtrips
from .verdicts.gates import (
    GateOutcome,
    GateResult,
    group_words,
    judge_gates,
    options_for,
    overall_outcome,
    parse_gate,
    varying_columns,
)
from .verdicts.job import Job, parse_job
from .verdicts.recommend import Recommendation, recommend_settings

__all__ = [
    "EXPORTERS",
    "MATCH_COLUMNS",
    "MEASURED_COLUMNS",
    "METRICS",
    "PARAMETER_COLUMNS",
    "PERCENTILES",
    "ROUNDTRIP_COLUMNS",
    "STAGES",
    "STATISTICS",
    "SUMMARY_COLUMNS",
    "Analysis",
    "CaseAnswer",
    "ClockFit",
    "ClockKnot",
    "ClockSegment",
    "ClockStep",
    "Column",
    "CompareOptions",
    "Comparison",
    "DerivedTrace",
    "Details",
    "Finding",
    "GateOutcome",
    "GateResult",
    "Headline",
    "Interval",
    "Job",
    "Outcome",
    "Percentile",
    "Recommendation",
    "Severity",
    "Source",
    "TopicReport",
    "analyze",
    "analyze_topics",
    "break_down",
    "compare_roundtrips",
    "default_output",
    "export_tables",
    "find_headlines",
    "group_words",
    "judge_gates",
    "minimum_messages",
    "options_for",
    "outage_table",
    "overall_outcome",
    "parse_gate",
    "parse_job",
    "percentile_interval",
    "ping_wall_offsets",
    "planned_messages",
    "ratio_interval",
    "recommend_settings",
    "response_against_latency",
    "summarize_breakdown",
    "summarize_freshness",
    "varying_columns",
    "write_derived",
]
