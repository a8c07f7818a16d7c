"""`dds-analyze --topics`: the health of other tools' recordings, its files, limits and exit code."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import polars as pl

from dds_trace.analyzer.exports.kinds import EXPORTERS, write_file, write_text_file
from dds_trace.analyzer.recordings.card import DAMAGED, HOLES
from dds_trace.analyzer.recordings.topics import StampCorrector, TopicReport, analyze_topics
from dds_trace.analyzer.verdicts.gate import GateOutcome
from dds_trace.base.errors import OptionError
from dds_trace.base.streams import say
from dds_trace.reports.topics.renderers import print_topics, render_json, render_markdown, render_page
from dds_trace.reports.topics.words import JudgedTopic

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from dds_trace.analyzer.verdicts.gate import TopicGate

HOLES_EXIT_CODE, DAMAGED_EXIT_CODE = 30, 31
_FILES = {
    "html": ("topics.html", render_page),
    "md": ("topics.md", render_markdown),
    "json": ("topics.json", render_json),
}


def report_topics(
    paths: Sequence[Path],
    folder: Path,
    kinds: Sequence[str],
    exports: Sequence[str],
    gates: Sequence[TopicGate],
    clock: StampCorrector | None = None,
) -> tuple[int, list[Path]]:
    """Print the health of recordings and write the reports asked for; return the exit code and the files.

    Raises:
        OptionError: a limit names no topic of the recordings.
        OutputError: a file cannot be written.
    """
    if others := sorted({*exports} - EXPORTERS.keys()):
        raise OptionError(f"--topics exports {' and '.join(EXPORTERS)}; leave out --export {others[0]}")
    report = analyze_topics(paths, skip=[folder], clock=clock)
    judged = list(_judge(report, gates))
    print_topics(report, judged)
    for source in report.sources:
        if source.status != "read" or source.detail:
            say(f"{source.path}: {source.status}: {source.detail}")
    files = [_FILES[kind] for kind in dict.fromkeys(kinds) if kind in _FILES]
    written = [write_text_file(folder / name, render(report, judged)) for name, render in files]
    written += [
        write_file(folder / f"topics.{kind}", partial(EXPORTERS[kind], report.topics.lazy())) for kind in exports
    ]
    return _exit_code(report, judged, gates), written


def _exit_code(report: TopicReport, judged: Sequence[JudgedTopic], gates: Sequence[TopicGate]) -> int:
    if report.verdict == DAMAGED:
        return DAMAGED_EXIT_CODE
    if gates:  # they say which holes are too many
        outcomes = {judgement.outcome for judgement in judged}
        worst = (GateOutcome.REGRESSED, GateOutcome.INCONCLUSIVE, GateOutcome.PASSED)
        return next(outcome for outcome in worst if outcome in outcomes).exit_code
    return HOLES_EXIT_CODE if report.verdict == HOLES else 0


def _judge(report: TopicReport, gates: Sequence[TopicGate]) -> Iterator[JudgedTopic]:
    for gate in gates:
        rows = [row for row in report.topics.iter_rows(named=True) if gate.is_about(row["topic"])]
        if not rows:
            raise OptionError(f"--fail-if {gate.text!r}: no recording has the topic {gate.topic}")
        for row in rows:
            low, high = _ends(row, report.holes, gate.metric)
            yield JudgedTopic(gate, row["recording"], row["topic"], gate.judge(low, high))


def _ends(row: Mapping[str, Any], holes: pl.DataFrame, metric: str) -> tuple[float | None, float | None]:
    if metric == "jitter":
        return row["jitter_ns"], row["jitter_ns"]
    if metric.startswith("age"):
        value, bound = row[f"{metric}_ns"], row["age_bound_ns"] or 0
        return (None, None) if value is None else (value - bound, value + bound)
    if row["missing"] is None:
        return None, None
    if metric == "missing":
        low, high = row["missing_low"], row["missing_high"]
        return low / max(row["messages"] + low, 1), high / max(row["messages"] + high, 1)
    topic_holes = holes.filter((pl.col("recording") == row["recording"]) & (pl.col("topic") == row["topic"]))
    longest_ns = max(topic_holes["duration_s"].to_list(), default=0.0) * 1e9
    return longest_ns, longest_ns
