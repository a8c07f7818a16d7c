"""Results as OpenMetrics text 1.0, for those who keep dashboards: summaries in seconds, and counts, with the parameters as labels."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.exports.kinds import write_text_file
from dds_trace.analyzer.model.metrics import METRICS, TOPIC_METRICS
from dds_trace.analyzer.model.parameters import PARAMETER_NAMES
from dds_trace.analyzer.statistics.percentiles import PERCENTILES
from dds_trace.base.streams import plain

Rows = Sequence[Mapping[str, object]]

_PREFIX = "dds_trace"
_COUNTS = {
    "published": "messages that were sent",
    "received": "messages that were received",
    "lost_outbound": "messages lost on the way to the receiver",
    "lost_in_relay": "messages that the relay received and did not send back",
    "lost_return": "messages lost on the way back",
    "lost_unknown": "messages lost where nobody recorded",
    "duplicates": "messages received more than once",
    "reordered": "messages received after a later one",
}
_GAUGES = {
    "transfer_rate_bytes_per_s": ("transfer_rate_bytes_per_second", "bytes_per_second", "payload that was moved"),
    "jitter_ns": ("interval_jitter_seconds", "seconds", "robust deviation of the intervals between arrivals"),
    "bound_ns": ("clock_error_bound_seconds", "seconds", "largest error of one-way times and ages by the clocks"),
}
_TOPIC_LABELS = ("topic", "message_type", "ping_device", "relay_device", "clock")


def openmetrics_text(analysis: Analysis) -> str:
    groups, topics = analysis.summary.to_dicts(), analysis.topics.to_dicts()
    lines = [line for metric in METRICS.values() for line in _times(metric.name, metric.label, groups, PARAMETER_NAMES)]
    lines += [line for name, label in TOPIC_METRICS.items() for line in _times(name, label, topics, _TOPIC_LABELS)]
    for name, meaning in _COUNTS.items():
        lines += _family(f"{_PREFIX}_{name}_messages", "counter", "", meaning)
        for rows, labels in ((groups, PARAMETER_NAMES), (topics, _TOPIC_LABELS)):
            lines += [
                f"{_PREFIX}_{name}_messages_total{_labels(row, labels)} {row[name]}" for row in rows if name in row
            ]
    for column, (name, unit, meaning) in _GAUGES.items():
        lines += _family(f"{_PREFIX}_{name}", "gauge", unit, meaning)
        for rows, labels in ((groups, PARAMETER_NAMES), (topics, _TOPIC_LABELS)):
            lines += [
                f"{_PREFIX}_{name}{_labels(row, labels)} {_number(row[column], 1e9 if column.endswith('_ns') else 1)}"
                for row in rows
                if row.get(column) is not None
            ]
    return "\n".join([*lines, "# EOF"]) + "\n"


def _family(name: str, kind: str, unit: str, meaning: str) -> list[str]:
    return [f"# TYPE {name} {kind}", *([f"# UNIT {name} {unit}"] if unit else []), f"# HELP {name} {meaning}"]


def _times(metric: str, label: str, rows: Rows, labels: Sequence[str]) -> Iterator[str]:
    name = f"{_PREFIX}_{metric}_seconds"
    yield from _family(name, "summary", "seconds", f"{label} of the messages that were received")
    for row in rows:
        for percentile in PERCENTILES:
            value = row.get(f"{metric}_{percentile.name}_ns")
            if value is not None:
                quantile = {"quantile": f"{percentile.quantile:g}"}
                yield f"{name}{_labels(row, labels, quantile)} {_number(value, 1e9)}"


def _labels(row: Mapping[str, object], names: Sequence[str], more: Mapping[str, str] | None = None) -> str:
    values = {name: _word(row[name]) for name in names if row[name] not in (None, "")}
    texts = (f'{name}="{value}"' for name, value in {**values, **(more or {})}.items())
    return "{" + ",".join(texts) + "}"


def _word(value: object) -> str:
    text = f"{value:.15g}" if isinstance(value, float) else plain(str(value))
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")


def _number(value: object, divisor: float) -> str:
    assert isinstance(value, (int, float))
    number = value / divisor
    return repr(number) if math.isfinite(number) else "+Inf"


def export(analysis: Analysis, folder: Path) -> list[Path]:
    return [write_text_file(folder / "openmetrics.txt", openmetrics_text(analysis))]
