"""The table that `dds-analyze` prints of the topics of foreign recordings."""

from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

from dds_trace.tracefile.units.durations import format_ms
from dds_trace.tracefile.visible import visible

if TYPE_CHECKING:
    from dds_trace.analyzer import TopicReport


def _ms(value_ns: float | None) -> str:
    if value_ns is None:
        return "unknown"
    return "lost" if value_ns == float("inf") else format_ms(value_ns)


def print_topics(report: "TopicReport") -> None:
    """Print a row per recording and topic."""
    table = Table(
        "recording", "topic", "messages", "rate Hz", "gaps", "jitter ms", "mean B", "age p50 ms", "age from"
    )
    for row in report.topics.iter_rows(named=True):
        rate = "" if row["rate_hz"] is None else f"{row['rate_hz']:.4g}"
        cells = (
            row["recording"],
            row["topic"],
            str(row["messages"]),
            rate,
            "" if row["gaps"] is None else str(row["gaps"]),
            "" if row["jitter_ns"] is None else _ms(row["jitter_ns"]),
            f"{row['payload_mean_bytes']:.0f}",
            "" if row["age_p50_ns"] is None else _ms(row["age_p50_ns"]),
            row["age_from"] or "",
        )
        table.add_row(*(Text(visible(cell)) for cell in cells))
    Console(width=160).print(table)
