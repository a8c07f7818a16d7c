"""Stretches and holes of topics as slices of a timeline."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count

from dds_trace.base.units import counted
from dds_trace.extensions.exports.perfetto import Slice

from .analyze import TopicReport


def topic_slices(report: TopicReport) -> Iterator[Slice]:
    starts_ns, numbers = {health.path: health.start_ns for health in report.recordings}, count(1)
    for row in report.topics.iter_rows(named=True):
        recording, topic, at_ns = row["recording"], row["topic"], row["start_ns"]
        parts: list[tuple[str, int, int]] = []
        for hole in report.holes.filter(recording=recording, topic=topic).iter_rows(named=True):
            begin_ns = starts_ns[recording] + round(hole["start_s"] * 1e9)
            end_ns = begin_ns + round(hole["duration_s"] * 1e9)
            name = f"hole: {counted(hole['missing'], 'message')}" if hole["missing"] else "no messages"
            parts += [("messages", at_ns, begin_ns), (name, begin_ns, end_ns)]
            at_ns = end_ns
        parts.append(("messages", at_ns, row["start_ns"] + row["duration_ns"]))
        for name, begin_ns, end_ns in parts:
            if end_ns > begin_ns:
                yield Slice(recording, topic, name, begin_ns, end_ns, next(numbers))
