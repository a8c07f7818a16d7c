"""`dds-trace bag`: the health of other tools' recordings, its files, limits and exit code."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import polars as pl
from dds_trace.reports.card import topics_card, write_picture

from dds_trace.analyzer.exports.kinds import EXPORTERS, write_file, write_text_file
from dds_trace.analyzer.verdicts.sections import fits_any
from dds_trace.base.errors import OptionError
from dds_trace.base.limits import nearest
from dds_trace.base.streams import say
from dds_trace.extensions.exports.perfetto import topic_slices, write_slices
from dds_trace.extensions.gates.gate import GateOutcome, rows_of_gates
from dds_trace.extensions.gates.gates import overall_outcome, result_of
from dds_trace.extensions.gates.limits_file import topic_limits_text, write_limits
from dds_trace.extensions.gates.words import gate_notes, gate_rows
from dds_trace.reports.book.groups import joined
from dds_trace.reports.reporters import load_reporter
from dds_trace.reports.terminal import print_report

from .analyze import StampCorrector, analyze_topics
from .card import DAMAGED, HOLES, OTHER_CLOCK_NS
from .report import BagReport, JudgedTopic

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from dds_trace.extensions.gates.gate import Gate

HOLES_EXIT_CODE, DAMAGED_EXIT_CODE = 30, 31
_FILES = ("html", "md", "json")
_EXPORTS = (*EXPORTERS, "perfetto")


def report_topics(
    paths: Sequence[Path],
    folder: Path,
    kinds: Sequence[str],
    exports: Sequence[str],
    gates: Sequence[Gate],
    clock: StampCorrector | None = None,
    limits_out: Path | None = None,
    *,
    card: bool = False,
) -> tuple[int, list[Path]]:
    if others := sorted({*exports} - {*_EXPORTS}):
        raise OptionError(f"a bag has no round trips: it exports {joined(_EXPORTS)}; leave out --export {others[0]}")
    report = analyze_topics(paths, skip=[folder], clock=clock)
    judged = list(_judge(report.topics, report.holes, gates))
    contents = BagReport(report, judged)
    print_report(contents)
    for source in report.sources:
        if source.status == "skipped":
            say(f"{source.path}: skipped: {source.detail}")
    written = [
        write_text_file(folder / f"{contents.name}.{kind}", load_reporter(kind).render(contents))
        for kind in dict.fromkeys(kinds)
        if kind in _FILES
    ]
    for kind in exports:
        if kind == "perfetto":
            written.append(write_file(folder / "topics.pftrace", partial(write_slices, topic_slices(report))))
        else:
            written.append(write_file(folder / f"topics.{kind}", partial(EXPORTERS[kind], report.topics.lazy())))
    if card:
        folder.mkdir(parents=True, exist_ok=True)
        written += write_picture(*topics_card(report), folder, say)
    if limits_out is not None:
        write_limits(topic_limits_text(report.topics), limits_out)
    if report.verdict == DAMAGED:
        return DAMAGED_EXIT_CODE, written
    if gates:  # they say which holes are too many
        return overall_outcome(gated.result.outcome for gated in judged).exit_code, written
    return HOLES_EXIT_CODE if report.verdict == HOLES else 0, written


def judge_tap(trace: Path, gates: Sequence[Gate]) -> int:
    from dds_trace.analyzer.pipeline import analyze

    lost = pl.col("published") - pl.col("received")
    counts = [lost.alias(name) for name in ("missing", "missing_low", "missing_high")]
    topics = analyze(trace, details=False).topics.with_columns(
        *counts, pl.lit(str(trace)).alias("recording"), messages="received", age_bound_ns="bound_ns"
    )
    judged = list(_judge(topics, None, gates))
    rows = ("  ".join(filter(None, cells)) for _, cells in gate_rows(judged, shows_all=True))
    for line in (*rows, *gate_notes(judged)):
        say(line)
    return overall_outcome(gated.result.outcome for gated in judged).exit_code


def _judge(topics: pl.DataFrame, holes: pl.DataFrame | None, gates: Sequence[Gate]) -> Iterator[JudgedTopic]:
    topic_rows, names, are_several = topics.rows(named=True), {*topics["topic"]}, topics["recording"].n_unique() > 1
    chosen = rows_of_gates(gates, [{"data_type": row["topic"]} for row in topic_rows])
    for gate, rows in zip(gates, ([topic_rows[n] for n in indices] for indices in chosen), strict=True):
        if not rows and gate.topic:
            raise OptionError(
                f"--fail-if {gate.text!r}: no recording has the topic {gate.topic}; {nearest(gate.topic, names)}"
            )
        if not fits_any(gate.topics or "*", names):  # a file of limits names what there has to be
            missing = result_of(gate, gate.topics, GateOutcome.REGRESSED, reason="no recording has this topic")
            yield JudgedTopic(gate.topics, missing, "")
        for row in rows:
            value, low, high = _measured(row, holes, gate.name)
            measured = [value] if low == high else [value, low, high]
            reason = "the value is not known" if value is None else ""
            result = result_of(gate, row["topic"], gate.judge(low, low, high), *measured, reason=reason)
            where = f"{row['topic']} in {row['recording']}" if are_several else row["topic"]
            yield JudgedTopic(where, result, row["recording"])


def _measured(row: Mapping[str, Any], holes: pl.DataFrame | None, metric: str) -> Sequence[float | None]:
    if metric in ("jitter", "rate"):
        return [row["jitter_ns" if metric == "jitter" else "rate_hz"]] * 3
    if metric.startswith("age"):
        value, bound = row[f"{metric}_ns"], row["age_bound_ns"] or 0
        is_known = value is not None and 0 <= value < OTHER_CLOCK_NS
        return [value, value - bound, value + bound] if is_known else [None] * 3
    if row["missing"] is None or (metric == "hole" and holes is None):
        return [None] * 3
    if metric in ("missing", "received_ratio"):
        counts = [row[name] for name in ("missing", "missing_low", "missing_high")]
        share, low, high = (count / max(row["messages"] + count, 1) for count in counts)
        return [share, low, high] if metric == "missing" else [1 - share, 1 - high, 1 - low]
    assert holes is not None
    topic_holes = holes.filter((pl.col("recording") == row["recording"]) & (pl.col("topic") == row["topic"]))
    return [max(topic_holes["duration_s"].to_list(), default=0.0) * 1e9] * 3
