"""Traces in, one frozen `Analysis` out.

from dds_trace.analyzer import analyze
a = analyze("runs/")          # a.summary, a.roundtrips ... are polars frames
"""

from dds_trace.analyzer.analysis import Analysis, Details, Finding, Severity, Source
from dds_trace.analyzer.clocks.alignment import Alignment, align_clocks, clock_table, ping_boots
from dds_trace.analyzer.clocks.fit import ClockFit, ClockKnot, ClockSegment, ClockStep
from dds_trace.analyzer.exports.foxglove import DerivedTrace, write_derived
from dds_trace.analyzer.exports.tables import EXPORTERS, export_tables
from dds_trace.analyzer.groups.breakdown import (
    STAGES,
    break_down,
    ping_wall_offsets,
    relay_wall_offsets,
    response_against_latency,
    summarize_breakdown,
    with_stamps,
)
from dds_trace.analyzer.groups.freshness import outage_table, summarize_freshness
from dds_trace.analyzer.model.columns import (
    MEASURED_COLUMNS,
    PARAMETER_COLUMNS,
    ROUNDTRIP_COLUMNS,
    STATISTICS,
    SUMMARY_COLUMNS,
    Column,
)
from dds_trace.analyzer.model.metrics import METRICS
from dds_trace.analyzer.pairing.pair import Outcome
from dds_trace.analyzer.pipeline import analyze, default_output
from dds_trace.analyzer.recordings.topics import TopicReport, analyze_topics
from dds_trace.analyzer.statistics.intervals import Interval, percentile_interval, ratio_interval
from dds_trace.analyzer.statistics.percentiles import PERCENTILES, Percentile
from dds_trace.analyzer.statistics.sample_size import (
    RunLength,
    minimum_messages,
    plan_run,
    planned_messages,
    supported_percentiles,
)
from dds_trace.analyzer.verdicts.answers import (
    Answer,
    Clarity,
    Contender,
    Headline,
    Win,
    find_answers,
    find_headlines,
)
from dds_trace.analyzer.verdicts.change import Verdict
from dds_trace.analyzer.verdicts.compare import (
    MATCH_COLUMNS,
    CompareOptions,
    Comparison,
    bridge_cost,
    compare_roundtrips,
)
from dds_trace.analyzer.verdicts.gates import (
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
from dds_trace.analyzer.verdicts.recommend import (
    Candidate,
    Fit,
    Job,
    Recommendation,
    parse_job,
    recommend_settings,
)

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
