"""Comparisons of two sides, limits and their outcomes for CI."""

from dds_trace.base.extension import Extension

EXTENSION = Extension(
    commands={"compare": "command:app"},
    details={"costs": "costs:cost_frames"},
    parts={
        "read_limits": "limits_file:read_limits",
        "topic_limits": "command:topic_limits",
        "judge_topics": "command:judge_topics",
    },
)
