"""Results for tools that keep a history over commits; times in ns."""

from __future__ import annotations

import csv
import io
import json
import os
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, NamedTuple

import polars as pl

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.exports.kinds import write_text_file
from dds_trace.analyzer.model.names import group_words
from dds_trace.analyzer.model.parameters import PARAMETER_NAMES
from dds_trace.base.streams import plain
from dds_trace.base.units import finite

_OF_A_MACHINE = ("ping_device", "relay_device", "ping_domain_id", "relay_domain_id")
"""Left out of names where results differ in others: they change from job to job."""

_MOST_NAME, _MOST_MEASURE = 1024, 64

COMMIT_VARIABLES = ("GITHUB_SHA", "CI_COMMIT_SHA")


class Measure(NamedTuple):
    result: str
    name: str
    value: float
    low: float | None
    high: float | None


def _measures(analysis: Analysis) -> Iterator[Measure]:
    rows = [{**row, "rate_hz": row["rate_hz"] or "max"} for row in analysis.summary.to_dicts()]
    short = [name for name in PARAMETER_NAMES if name not in _OF_A_MACHINE]
    words = [_words(row, short) for row in rows]
    counts = Counter(words)
    names = [word if counts[word] == 1 else _words(row, PARAMETER_NAMES) for word, row in zip(words, rows, strict=True)]
    is_shown = (pl.col("metric") == "latency") & pl.col("percentile").is_in(["p50", "p99"])
    for row in analysis.details.intervals.filter(is_shown).iter_rows(named=True):
        value, low, high = (finite(row[f"{name}_ns"]) for name in ("estimate", "low", "high"))
        if value is not None:
            yield Measure(names[row["group"]], f"latency_{row['percentile']}", value, low, high)
    for name, row in zip(names, rows, strict=True):
        if row["received_ratio"] is not None:
            yield Measure(name, "received_ratio", row["received_ratio"], None, None)


def _words(row: dict[str, Any], columns: Sequence[str]) -> str:
    return plain(group_words(row, [name for name in columns if row[name] not in (None, "")]))[:_MOST_NAME]


def bencher_json(analysis: Analysis) -> str:
    benchmarks: dict[str, dict[str, dict[str, float]]] = {}
    for measure in _measures(analysis):
        ends = {"value": measure.value, "lower_value": measure.low, "upper_value": measure.high}
        metric = {name: end for name, end in ends.items() if end is not None}
        benchmarks.setdefault(measure.result, {})[measure.name[:_MOST_MEASURE]] = metric
    return json.dumps(benchmarks, indent=1, allow_nan=False) + "\n"


def github_benchmark_files(analysis: Analysis) -> dict[str, str]:
    files: dict[str, list[dict[str, object]]] = {"smaller": [], "bigger": []}
    for measure in _measures(analysis):
        is_time = measure.name.startswith("latency")
        entry: dict[str, object] = {"name": f"{measure.result} {measure.name}", "unit": "ns" if is_time else "%"}
        entry["value"] = measure.value if is_time else 100 * measure.value
        if measure.low is not None and measure.high is not None:
            entry["range"] = f"± {(measure.high - measure.low) / 2:.0f}"
        files["smaller" if is_time else "bigger"].append(entry)
    return {
        f"github-benchmark-{better}.json": json.dumps(entries, indent=1, allow_nan=False) + "\n"
        for better, entries in files.items()
        if entries  # the action refuses an empty list
    }


def otava_csv(analysis: Analysis) -> str:
    started_s = min((session.wall_anchor_ns for session in analysis.sessions), default=0) / 1e9
    time = datetime.fromtimestamp(started_s, timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")
    commit = next(filter(None, map(os.environ.get, COMMIT_VARIABLES)), "")
    values = {re.sub(r"\W+", "_", f"{measure.result} {measure.name}"): measure.value for measure in _measures(analysis)}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows(
        [["time", "commit", *values], [time, plain(commit), *(f"{value:.6g}" for value in values.values())]]
    )
    return text.getvalue()


def export_bencher(analysis: Analysis, folder: Path) -> list[Path]:
    return [write_text_file(folder / "bencher.json", bencher_json(analysis))]


def export_github_benchmark(analysis: Analysis, folder: Path) -> list[Path]:
    return [write_text_file(folder / name, text) for name, text in github_benchmark_files(analysis).items()]


def export_otava(analysis: Analysis, folder: Path) -> list[Path]:
    return [write_text_file(folder / "otava.csv", otava_csv(analysis))]
