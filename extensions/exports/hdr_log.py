"""Latencies as a log of HdrHistograms (log format 1.3, histograms in encoding V2), an interval for each result and metric.

http://hdrhistogram.org; values are ns with three significant digits, from the histograms of the analysis (`statistics/histogram.py`).
"""

from __future__ import annotations

import base64
import re
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.exports.kinds import write_text_file
from dds_trace.analyzer.model.metrics import TOPIC_METRICS
from dds_trace.analyzer.model.names import distinct, name_groups
from dds_trace.analyzer.model.parameters import PARAMETER_NAMES
from dds_trace.analyzer.statistics.percentiles import histogram_of
from dds_trace.base.version import __version__

_DIGITS = 3
_HALF_BITS = 10
"""A bucket's linear half has 1024 steps: three digits."""

_HEADER, _PACKED = 0x1C849303 | 0x10, 0x1C849304 | 0x10
_LEAST_HIGHEST_NS = 3_600_000_000_000


def hdr_log(analysis: Analysis) -> str:
    """Return the log; a tag names result and metric, times are of the pings' clocks."""
    start_s = min((session.wall_anchor_ns for session in analysis.sessions), default=0) / 1e9
    lines = [
        f"#[Logged with dds-trace {__version__}]",
        "#[Histogram log format version 1.3]",
        f"#[StartTime: {start_s:.3f} (seconds since epoch)]",
        '"StartTimestamp","Interval_Length","Interval_Max","Interval_Compressed_Histogram"',
    ]
    histograms = list(_histograms(analysis))
    names = [name for name, *_ in histograms]
    for tag, (_, duration_s, value_ns, count) in zip(
        distinct([re.sub(r"[^\w./:%+-]+", "_", name) for name in names], names), histograms, strict=True
    ):
        counted = value_ns >= 0
        if counted.any():
            packed = encode_histogram(np.rint(value_ns[counted]).astype(np.int64), count[counted].astype(np.int64))
            text = base64.b64encode(packed).decode()
            lines.append(f"Tag={tag},0.000,{duration_s:.3f},{value_ns.max() / 1e6:.6f},{text}")
    return "\n".join(lines) + "\n"


def _histograms(analysis: Analysis) -> Iterator[tuple[str, float, NDArray[np.float64], NDArray[np.uint64]]]:
    groups = analysis.summary.select(PARAMETER_NAMES)
    names = distinct(name_groups(groups), [str(row) for row in groups.rows()]) if len(groups) else []
    lasted = dict(analysis.run_times.group_by("group").agg((pl.col("last_ns") - pl.col("origin_ns")).sum()).iter_rows())
    for (group, metric), part in analysis.distributions.partition_by(
        "group", "metric", as_dict=True, maintain_order=True
    ).items():
        yield (
            f"{names[group]} {metric}",
            lasted.get(group, 0) / 1e9,
            part["value_ns"].to_numpy(),
            part["count"].to_numpy(),
        )
    key = ["data_type", "ping_device", "relay_device"]
    for (topic, sender, receiver), part in analysis.topic_messages.partition_by(
        key, as_dict=True, maintain_order=True
    ).items():
        arrived = part["relay_in_ns"].drop_nulls().to_numpy()
        lasted_s = float(np.ptp(arrived)) / 1e9 if len(arrived) else 0.0
        for metric in TOPIC_METRICS:
            histogram = histogram_of(np.sort(part[f"{metric}_ns"].drop_nulls().to_numpy()))
            yield f"{topic} {sender} to {receiver} {metric}", lasted_s, histogram.value_ns, histogram.count


def encode_histogram(value_ns: NDArray[np.int64], count: NDArray[np.int64]) -> bytes:
    _, exponent = np.frexp((value_ns | ((2 << _HALF_BITS) - 1)).astype(np.float64))
    bucket = exponent.astype(np.int64) - (_HALF_BITS + 1)
    index = (bucket << _HALF_BITS) + (value_ns >> bucket)
    counts = np.bincount(index, weights=count).astype(np.int64)
    highest_ns = max(_LEAST_HIGHEST_NS, 2 * int(value_ns.max()))
    payload = b"".join(_packed_counts(counts))
    head = struct.pack(">iiiiqqd", _HEADER, len(payload), 0, _DIGITS, 1, highest_ns, 1.0)
    packed = zlib.compress(head + payload)
    return struct.pack(">ii", _PACKED, len(packed)) + packed


def _packed_counts(counts: NDArray[np.int64]) -> Iterator[bytes]:
    """Yield counts as ZigZag LEB128, runs of zeros as their negative length."""
    used = np.flatnonzero(counts)
    for zeros, at in zip(np.diff(used, prepend=-1) - 1, used, strict=True):
        if zeros:
            yield _leb128(-int(zeros) if zeros > 1 else 0)
        yield _leb128(int(counts[at]))


def _leb128(value: int) -> bytes:
    encoded = (value << 1) ^ (value >> 63)
    text = bytearray()
    while encoded >= 0x80 and len(text) < 8:
        text.append(encoded & 0x7F | 0x80)
        encoded >>= 7
    text.append(encoded)
    return bytes(text)


def export(analysis: Analysis, folder: Path) -> list[Path]:
    return [write_text_file(folder / "latency.hlog", hdr_log(analysis))]
