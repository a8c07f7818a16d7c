"""Times of a group, not of its messages: to the first message, from the end of an outage to the first reply, and to several relays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import median

from dds_trace.analyzer.model.setting import parse_setting, write_setting

from ..book.book import Book
from ..book.numbers import whole_ns
from .figure import Facet, Faceted, Figure, FigureMaker, LeftOut, facet_panels, facet_plan, is_few


@dataclass(frozen=True, slots=True)
class OwnTimes(Faceted):
    times_ns: Mapping[int, int]

    def drawn(self, label: str) -> dict[str, object]:
        return facet_plan(self.facet, self.panels, value="own", values_ns=self.times_ns, label=label)


def first_message_info(book: Book) -> OwnTimes:
    rows = book.analysis.details.wire.select("group", "match_p50_ns").iter_rows()
    times_ns = {group: time for group, value in rows if (time := whole_ns(value)) is not None}
    facet = Facet("cell" if is_few(book) else "plane", "way")
    return OwnTimes(facet, facet_panels(book, facet, times_ns.__contains__), times_ns)


def first_message_figure(info: OwnTimes) -> Figure | LeftOut:
    name, title = "first_message", "Time to the first message"
    how_to_read = (
        "Each mark is the time from the first announcement of the ping's participant to the first echo, with a relay that was already "
        "running: how long a node that starts has to wait."
    )
    if not info.panels:
        return LeftOut(name, title, "no DDS run was recorded with --wire.")
    return Figure(name, title, how_to_read, "lines", info.drawn(title))


FIRST_MESSAGE = FigureMaker(first_message_info, first_message_figure, opened=False)


def recovery_info(book: Book) -> OwnTimes:
    recoveries = book.analysis.details.recoveries
    times: dict[int, list[int]] = {}
    for group, back_ns in recoveries.filter(~recoveries["never"]).select("group", "back_ns").iter_rows():
        times.setdefault(group, []).append(back_ns)
    medians = {group: round(median(values)) for group, values in times.items()}
    facet = Facet("rest", "link", "vendor")
    return OwnTimes(facet, facet_panels(book, facet, medians.__contains__), medians)


def recovery_figure(info: OwnTimes) -> Figure | LeftOut:
    name, title = "recovery", "Coming back"
    how_to_read = (
        "Each mark is the time from the end of an outage, of the kind and length in the setting, to the first reply, median of the runs "
        "that came back; a setup without a mark never did within the limit."
    )
    if not info.panels:
        return LeftOut(name, title, "no sweep made an outage within a run.")
    return Figure(name, title, how_to_read, "lines", info.drawn("Time to the first reply"))


RECOVERY = FigureMaker(recovery_info, recovery_figure)


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


FAN_OUT = FigureMaker(fan_out_info, fan_out_figure, opened=False)
