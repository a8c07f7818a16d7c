"""Limits of topics: of a recording, and of a tap at its end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl

from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.errors import OptionError
from dds_trace.base.limits import nearest
from dds_trace.base.streams import say
from dds_trace.extensions.gates.gate import Against, Gate, GateOutcome, rows_of_gates
from dds_trace.extensions.gates.gates import overall_outcome, result_of
from dds_trace.extensions.gates.sections import fits_any
from dds_trace.extensions.gates.words import Gated, gate_notes, gate_rows

from .analyze import TopicReport
from .card import OTHER_CLOCK_NS


@dataclass(frozen=True, slots=True)
class JudgedTopic(Gated):
    recording: str


def judge_tap(trace: Path, gates: Sequence[Gate]) -> int:
    lost = pl.col("published") - pl.col("received")
    counts = [lost.alias(name) for name in ("missing", "missing_low", "missing_high")]
    topics = analyze(trace, details=False).topics.with_columns(
        *counts, pl.lit(str(trace)).alias("recording"), messages="received", age_bound_ns="bound_ns"
    )
    judged = list(judge_topics(topics, None, gates))
    rows = ("  ".join(filter(None, cells)) for _, cells in gate_rows(judged, shows_all=True))
    for line in (*rows, *gate_notes(judged)):
        say(line)
    return overall_outcome(gated.result.outcome for gated in judged).exit_code


def judge_topics(
    topics: pl.DataFrame, holes: pl.DataFrame | None, gates: Sequence[Gate], base: TopicReport | None = None
) -> Iterator[JudgedTopic]:
    """Judge topics by limits, and by changes against the topics of the same name in `base`."""
    before = {} if base is None else {row["topic"]: row for row in base.topics.rows(named=True)}
    topic_rows, names, are_several = topics.rows(named=True), {*topics["topic"]}, topics["recording"].n_unique() > 1
    chosen = rows_of_gates(gates, [{"data_type": row["topic"]} for row in topic_rows])
    for gate, rows in zip(gates, ([topic_rows[n] for n in indices] for indices in chosen), strict=True):
        if not rows and gate.topic and not fits_any(gate.topic, before):
            raise OptionError(
                f"--fail-if {gate.text!r}: no recording has the topic {gate.topic}; {nearest(gate.topic, names)}"
            )
        if not fits_any(gate.topics or "*", {*names, *before}):  # a file of limits names what there has to be
            missing = result_of(gate, gate.topics, GateOutcome.REGRESSED, reason="no recording has this topic")
            yield JudgedTopic(gate.topics, missing, "")
        for row in rows:
            value, low, high = _measured(row, holes, gate.name)
            if gate.against is not Against.NEW:
                others: Sequence[float | None] = [None] * 3
                if base is not None and row["topic"] in before:
                    others = _measured(before[row["topic"]], base.holes, gate.name)
                value, low, high = _change(gate, others, (value, low, high))
            measured = [value] if low == high else [value, low, high]
            reason = "the value is not known" if value is None else ""
            result = result_of(gate, row["topic"], gate.judge(low, low, high), *measured, reason=reason)
            where = f"{row['topic']} in {row['recording']}" if are_several else row["topic"]
            yield JudgedTopic(where, result, row["recording"])


def _change(gate: Gate, base: Sequence[float | None], new: Sequence[float | None]) -> Sequence[float | None]:
    """Return value, low and high of a ratio or a difference; of a base of 0 there is no ratio."""
    ends = [*zip(new, (base[0], base[2], base[1]), strict=True)]
    if gate.against is Against.RATIO:
        return [None if now is None or not was else now / was for now, was in ends]
    return [None if now is None or was is None else now - was for now, was in ends]


def _measured(row: Mapping[str, Any], holes: pl.DataFrame | None, metric: str) -> Sequence[float | None]:
    if metric in ("jitter", "rate"):
        return [row["jitter_ns" if metric == "jitter" else "rate_hz"]] * 3
    if metric.startswith("age"):
        value, bound = row[f"{metric}_ns"], row["age_bound_ns"] or 0
        is_known = value is not None and 0 <= value < OTHER_CLOCK_NS and row.get("no_age") is None
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
