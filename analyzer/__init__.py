"""Traces in, one frozen `Analysis` out.

from analyzer import analyze
a = analyze("runs/")          # a.summary, a.roundtrips ... are polars frames
"""

from analyzer.analysis import Analysis, Finding, Severity, Source
from analyzer.columns import (
    MEASURED_COLUMNS,
    PARAMETER_COLUMNS,
    ROUNDTRIP_COLUMNS,
    STATISTICS,
    SUMMARY_COLUMNS,
    Column,
)
from analyzer.metrics import METRICS
from analyzer.pair import Outcome
from analyzer.pipeline import analyze, default_output
from analyzer.statistics import PERCENTILES, Percentile

__all__ = [
    "MEASURED_COLUMNS",
    "METRICS",
    "PARAMETER_COLUMNS",
    "PERCENTILES",
    "ROUNDTRIP_COLUMNS",
    "STATISTICS",
    "SUMMARY_COLUMNS",
    "Analysis",
    "Column",
    "Finding",
    "Outcome",
    "Percentile",
    "Severity",
    "Source",
    "analyze",
    "default_output",
]
