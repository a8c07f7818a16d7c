"""Tables that `dds-analyze` prints beside the reports: a recommendation, and the topics of foreign recordings."""

from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

from dds_trace.tracefile.units.durations import format_ms
from dds_trace.tracefile.visible import visible

if TYPE_CHECKING:
    from dds_trace.analyzer import Recommendation, TopicReport


def _ms(value_ns: float | None) -> str:
    if value_ns is None:
        return "unknown"
    return "lost" if value_ns == float("inf") else format_ms(value_ns)


def print_recommendation(recommendation: "Recommendation") -> None:
    """Print the ranking of settings for a job, and whether it is conclusive."""
    job = recommendation.job
    table = Table("setting", "does it", "latency ms", "interval ms", "margin ms", "remark")
    for candidate in recommendation.candidates:
        words = " ".join(f"{name}={value}" for name, value in candidate.setting.items() if value is not None)
        cells = (
            words,
            candidate.fit.value,
            _ms(candidate.latency_ns),
            f"{_ms(candidate.lower_ns)} to {_ms(candidate.upper_ns)}",
            _ms(candidate.margin_ns),
            candidate.reason,
        )
        table.add_row(*(Text(visible(cell)) for cell in cells))
    console = Console(width=160)
    what = f"{job.data_type} {job.payload_bytes} B at {job.rate_hz:g} Hz within {job.deadline_ns / 1e6:g} ms"
    console.print(Text(f"{visible(what)}, {job.reliability:.4%} of messages"))
    console.print(table)
    if not recommendation.candidates:
        console.print("The traces say nothing of such messages.")
    elif not recommendation.is_conclusive:
        console.print("Inconclusive: these traces do not tell one best setting.")


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
