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

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.exports.kinds import write_text_file
from dds_trace.analyzer.model.names import distinct, group_words
from dds_trace.analyzer.model.parameters import PARAMETER_NAMES, QOS_DEFAULTS
from dds_trace.base.streams import plain
from dds_trace.base.units import finite

_OF_A_MACHINE = ("ping_device", "relay_device", "ping_domain_id", "relay_domain_id")
"""Left out of names where results differ in others: they change from job to job."""

_MOST_NAME, _MOST_MEASURE = 1024 - 9, 64
"""Characters, without the hash of `distinct`."""

COMMIT_VARIABLES = ("GITHUB_SHA", "CI_COMMIT_SHA")


class Measure(NamedTuple):
    """A measure of a result, which has every measure; `value` is None where unknown."""

    result: str
    name: str
    value: float | None
    low: float | None = None
    high: float | None = None


def _measures(analysis: Analysis) -> Iterator[Measure]:
    rows = [{**row, "rate_hz": row["rate_hz"] or "max"} for row in analysis.summary.to_dicts()]
    short = [name for name in PARAMETER_NAMES if name not in _OF_A_MACHINE]
    words = [_words(row, short) for row in rows]
    counts = Counter(words)
    words = [word if counts[word] == 1 else _words(row, PARAMETER_NAMES) for word, row in zip(words, rows, strict=True)]
    names = distinct(words, [str([row[name] for name in PARAMETER_NAMES]) for row in rows])
    intervals = {
        (row["group"], row["percentile"]): [finite(row[f"{name}_ns"]) for name in ("estimate", "low", "high")]
        for row in analysis.details.intervals.filter(metric="latency").iter_rows(named=True)
    }
    for group, (name, row) in enumerate(zip(names, rows, strict=True)):
        for percentile in ("p50", "p99"):
            yield Measure(name, f"latency_{percentile}", *intervals.get((group, percentile), [None]))
        yield Measure(name, "received_ratio", row["received_ratio"])


def _known_measures(analysis: Analysis) -> Iterator[tuple[Measure, float]]:
    return ((measure, measure.value) for measure in _measures(analysis) if measure.value is not None)


def _words(row: dict[str, Any], columns: Sequence[str]) -> str:
    """Name a result by its settings that are not the usual ones, whatever other results there are."""
    relay = {f"relay_{name}": row[name] for name in ("vendor", "backend")}
    usual = {**QOS_DEFAULTS, **relay, "domain_mode": "same" if row["bridge"] == "none" else "different"}
    return plain(group_words(row, [name for name in columns if row[name] not in (None, "", usual.get(name))]))[
        :_MOST_NAME
    ]


def bencher_json(analysis: Analysis) -> str:
    benchmarks: dict[str, dict[str, dict[str, float]]] = {}
    for measure, value in _known_measures(analysis):
        ends = {"value": value, "lower_value": measure.low, "upper_value": measure.high}
        metric = {name: end for name, end in ends.items() if end is not None}
        benchmarks.setdefault(measure.result, {})[measure.name[:_MOST_MEASURE]] = metric
    return json.dumps(benchmarks, indent=1, allow_nan=False) + "\n"


def github_benchmark_files(analysis: Analysis) -> dict[str, str]:
    files: dict[str, list[dict[str, object]]] = {"smaller": [], "bigger": []}
    for measure, value in _known_measures(analysis):
        is_time = measure.name.startswith("latency")
        entry: dict[str, object] = {"name": f"{measure.result} {measure.name}", "unit": "ns" if is_time else "%"}
        entry["value"] = value if is_time else 100 * value
        if measure.low is not None and measure.high is not None:
            entry["range"] = f"± {(measure.high - measure.low) / 2:.0f}"
        files["smaller" if is_time else "bigger"].append(entry)
    return {
        f"github-benchmark-{better}.json": json.dumps(entries, indent=1, allow_nan=False) + "\n"
        for better, entries in files.items()
        if entries  # the action refuses an empty list
    }


def _otava_columns(analysis: Analysis) -> dict[str, Measure]:
    measures = list(_measures(analysis))
    names = [f"{measure.result} {measure.name}" for measure in measures]
    columns = distinct([re.sub(r"\W+", "_", name) for name in names], names)
    return dict(sorted(zip(columns, measures, strict=True)))


def otava_csv(analysis: Analysis) -> str:
    """Return a row with a column for each measure of each result, by name; unknown is empty."""
    started_s = min((session.wall_anchor_ns for session in analysis.sessions), default=0) / 1e9
    time = datetime.fromtimestamp(started_s, timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")
    commit = next(filter(None, map(os.environ.get, COMMIT_VARIABLES)), "")
    columns = _otava_columns(analysis)
    values = ["" if measure.value is None else f"{measure.value:.6g}" for measure in columns.values()]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([["time", "commit", *columns], [time, plain(commit), *values]])
    return text.getvalue()


def otava_yaml(analysis: Analysis) -> str:
    """Return Otava's configuration for such rows in `latency.csv`: which direction of a column is better."""
    directions = {
        name: 1 if measure.name == "received_ratio" else -1 for name, measure in _otava_columns(analysis).items()
    }
    metrics = (f"      {name}: {{column: {name}, direction: {way}}}\n" for name, way in directions.items())
    return "".join([_OTAVA_CONFIG, *metrics])


_OTAVA_CONFIG = """tests:
  latency:
    type: csv
    file: latency.csv
    time_column: time
    attributes: [commit]
    csv_options: {delimiter: ","}
    metrics:
"""


def export_bencher(analysis: Analysis, folder: Path) -> list[Path]:
    return [write_text_file(folder / "bencher.json", bencher_json(analysis))]


def export_github_benchmark(analysis: Analysis, folder: Path) -> list[Path]:
    return [write_text_file(folder / name, text) for name, text in github_benchmark_files(analysis).items()]


def export_otava(analysis: Analysis, folder: Path) -> list[Path]:
    texts = {"otava.csv": otava_csv(analysis), "otava.yaml": otava_yaml(analysis)}
    return [write_text_file(folder / name, text) for name, text in texts.items()]
