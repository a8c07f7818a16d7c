"""Traces in, one frozen `Analysis` out.

from analyzer import analyze
a = analyze("runs/")          # a.summary, a.roundtrips ... are polars frames
"""

from analyzer.analysis import Analysis, Details, Finding, Severity, Source
from analyzer.answers import Answer, Clarity, Contender, Headline, Win, find_answers, find_headlines
from analyzer.breakdown import (
    STAGES,
    break_down,
    ping_wall_offsets,
    relay_wall_offsets,
    response_against_latency,
    summarize_breakdown,
    with_stamps,
)
from analyzer.change import Verdict
from analyzer.clock_fit import ClockFit, ClockKnot, ClockSegment, ClockStep
from analyzer.clocks import Alignment, align_clocks, clock_table, ping_boots
from analyzer.columns import (
    MEASURED_COLUMNS,
    PARAMETER_COLUMNS,
    ROUNDTRIP_COLUMNS,
    STATISTICS,
    SUMMARY_COLUMNS,
    Column,
)
from analyzer.compare import (
    MATCH_COLUMNS,
    CompareOptions,
    Comparison,
    bridge_cost,
    compare_roundtrips,
)
from analyzer.comparison_text import comparison_junit, comparison_markdown, plain_line
from analyzer.derived import DerivedTrace, write_derived
from analyzer.exports import EXPORTERS, export_tables
from analyzer.freshness import outage_table, summarize_freshness
from analyzer.gates import (
    Gate,
    GateOutcome,
    GateResult,
    group_words,
    judge_gates,
    options_for,
    overall_outcome,
    parse_gate,
    varying_columns,
)
from analyzer.intervals import Interval, percentile_interval, ratio_interval
from analyzer.metrics import METRICS
from analyzer.pair import Outcome
from analyzer.pipeline import analyze, default_output
from analyzer.recommend import Candidate, Fit, Job, Recommendation, parse_job, recommend_settings
from analyzer.sample_size import (
    RunLength,
    minimum_messages,
    plan_run,
    planned_messages,
    supported_percentiles,
)
from analyzer.statistics import PERCENTILES, Percentile
from analyzer.topics import TopicReport, analyze_topics

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
    "Alignment",
    "Analysis",
    "Answer",
    "Candidate",
    "Clarity",
    "ClockFit",
    "ClockKnot",
    "ClockSegment",
    "ClockStep",
    "Column",
    "CompareOptions",
    "Comparison",
    "Contender",
    "DerivedTrace",
    "Details",
    "Finding",
    "Fit",
    "Gate",
    "GateOutcome",
    "GateResult",
    "Headline",
    "Interval",
    "Job",
    "Outcome",
    "Percentile",
    "Recommendation",
    "RunLength",
    "Severity",
    "Source",
    "TopicReport",
    "Verdict",
    "Win",
    "align_clocks",
    "analyze",
    "analyze_topics",
    "break_down",
    "bridge_cost",
    "clock_table",
    "compare_roundtrips",
    "comparison_junit",
    "comparison_markdown",
    "default_output",
    "export_tables",
    "find_answers",
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
    "ping_boots",
    "ping_wall_offsets",
    "plain_line",
    "plan_run",
    "planned_messages",
    "ratio_interval",
    "recommend_settings",
    "relay_wall_offsets",
    "response_against_latency",
    "summarize_breakdown",
    "summarize_freshness",
    "supported_percentiles",
    "varying_columns",
    "with_stamps",
    "write_derived",
]
