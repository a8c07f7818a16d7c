"""One message to several relays: first and last receiver, and time until all have matched, over the number of relays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.analyzer.model.setting import parse_setting, write_setting

from ..book.numbers import whole_ns
from .figure import Figure, FigureMaker, LeftOut

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..book.book import Book

COUNTS = ("relays", "hosts", "pings", "topics", "flow", "flows", "wire")


@dataclass(frozen=True, slots=True)
class Receivers:
    group: int
    count: int
    first_ns: int | None
    last_ns: int | None
    matched_ns: int | None


@dataclass(frozen=True, slots=True)
class FanOut:
    of: str
    lines: Mapping[str, tuple[Receivers, ...]]


def fan_out_info(book: Book) -> FanOut:
    rows = book.analysis.details.fan_out.sort("receivers", "senders")
    of = "receivers" if rows.is_empty() or rows["receivers"].n_unique() > 1 else "senders"
    lines: dict[str, tuple[Receivers, ...]] = {}
    for row in rows.iter_rows(named=True):
        times = (whole_ns(row[f"{name}_p50_ns"]) for name in ("first_receiver", "last_receiver", "matched"))
        group = book.groups.groups[row["group"]]
        series, cell = book.groups.series_of(group), book.groups.cell_of(group)
        setting = {key: value for key, value in parse_setting(series.setting).items() if key not in COUNTS}
        name = ", ".join(filter(None, (series.vendor_label, cell.label, write_setting(setting))))
        lines[name] = (*lines.get(name, ()), Receivers(row["group"], row[of], *times))
    return FanOut("Relays" if of == "receivers" else "Pings", lines)


def fan_out_figure(info: FanOut) -> Figure | LeftOut:
    name, title = "fan_out", "One message to several relays"
    how_to_read = (
        "Each bar reaches from the first relay that gets a message to the last one (median times); the mark is the last. On "
        "the right: the time from the start of the ping to the first answer of the last relay, which were all running."
    )
    if not info.lines:
        return LeftOut(name, title, "no message went to several relays, and no pings sent at the same time.")
    return Figure(name, title, how_to_read, "fan_out", {"of": info.of, "lines": info.lines})


FIGURE = FigureMaker(fan_out_info, fan_out_figure, opened=False)
