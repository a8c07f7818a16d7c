"""Tables of the topics of other tools' recordings."""

import sys
from typing import TYPE_CHECKING, Any

from rich.table import Table
from rich.text import Text

from dds_trace.base.printable import printable
from dds_trace.base.streams import plain_console
from dds_trace.base.units import format_duration, format_rate, format_size

if TYPE_CHECKING:
    from dds_trace.analyzer.recordings.topics import TopicReport

WIDTH = 80
HOW_TO_READ = (
    "Size: mean. Long: intervals longer than two typical ones, as batches and several publishers have, too. Jitter: standard deviation of the "
    "intervals. Age: median from the header's stamp, or from publishing, to the recording; between two machines it includes the "
    "difference of their clocks."
)
_COLUMNS = (("Messages", 8), ("Rate", 8), ("Long", 5), ("Jitter", 7), ("Size", 7), ("Age", 15))


def print_topics(report: "TopicReport") -> None:
    """Print a table for each recording, a row for each topic."""
    console = plain_console(width=None if sys.stdout.isatty() else WIDTH)
    for (recording,), rows in report.topics.group_by("recording", maintain_order=True):
        console.print(Text(printable(recording), style="bold"), soft_wrap=True)
        table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False, header_style="dim")
        table.add_column("Topic", overflow="fold")
        for name, width in _COLUMNS:
            table.add_column(name, justify="right", width=width, overflow="fold")
        for row in rows.iter_rows(named=True):
            table.add_row(*map(Text, _cells(row)))
        console.print(table)
        console.print()
    if not report.topics.is_empty():
        console.print(Text(HOW_TO_READ, style="dim"))


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    from dds_trace.analyzer.recordings.topics import OTHER_CLOCK_NS

    age = "" if row["age_p50_ns"] is None else f"{format_duration(row['age_p50_ns'])} ({row['age_from']})"
    if age and abs(row["age_p50_ns"]) > OTHER_CLOCK_NS:
        age = "other clock"
    return (
        printable(row["topic"]),
        f"{row['messages']:,}",
        "" if row["rate_hz"] is None else format_rate(row["rate_hz"]),
        "" if row["gaps"] is None else f"{row['gaps']:,}",
        "" if row["jitter_ns"] is None else format_duration(row["jitter_ns"]),
        format_size(round(row["payload_mean_bytes"])),
        age,
    )
