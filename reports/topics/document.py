"""`topics.json`: the health of recordings for scripts."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict

from dds_trace.analyzer.recordings.topics import TopicReport

from .words import JudgedTopic, topics_of

FORMAT_VERSION = 1
"""A field may be added without a new version."""

_RENAMED = {"topic": "name", "stamps_backwards": "backward_stamps"}
_OF_HOLE = ("start_s", "duration_s", "missing", "inside")


def render(report: TopicReport, judged: Sequence[JudgedTopic] = ()) -> str:
    """Return the report as JSON; a value that is not known is null."""
    topics = [
        {
            **{_RENAMED.get(name, name): _plain(value) for name, value in row.items()},
            "holes": [{name: hole[name] for name in _OF_HOLE} for hole in holes],
            "strip": [round(share, 4) for share in strip],
        }
        for health in report.recordings
        for row, holes, strip in topics_of(report, health.path)
    ]
    document = {
        "format": FORMAT_VERSION,
        "verdict": report.verdict,
        "recordings": [
            {**asdict(health), "pauses": [{"start_s": start, "duration_s": length} for start, length in health.pauses]}
            for health in report.recordings
        ],
        "topics": topics,
        "gates": [_of_gate(one) for one in judged],
        "sources": [asdict(source) for source in report.sources],
    }
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def _of_gate(judged: JudgedTopic) -> Mapping[str, str]:
    return {
        "gate": judged.gate.text,
        "recording": judged.recording,
        "topic": judged.topic,
        "outcome": judged.outcome.value,
    }


def _plain(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value
