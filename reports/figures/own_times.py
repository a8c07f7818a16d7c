"""Times of a group, not of its messages: to the first message, from the end of an outage to the first reply, and to several relays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import median

from dds_trace.analyzer.model.setting import parse_setting, write_setting

from ..book.book import Book
from ..book.numbers import whole_ns
from .figure import Facet, FigureMaker, Plan, plane_facet, spread_plan


def _own_times_plan(book: Book, facet: Facet, times_ns: Mapping[int, int], label: str) -> Plan | None:
    return spread_plan(book, facet, times_ns.__contains__, value="own", values_ns=times_ns, label=label)


def first_message_plan(book: Book) -> Plan | None:
    rows = book.analysis.details.wire.select("group", "match_p50_ns").iter_rows()
    times_ns = {group: time for group, value in rows if (time := whole_ns(value)) is not None}
    return _own_times_plan(book, plane_facet(book, "way", "choice"), times_ns, FIRST_MESSAGE.title)


FIRST_MESSAGE = FigureMaker(
    name="first_message",
    title="Time to the first message",
    how_to_read=(
        "Each mark is the time from the first announcement of the ping's participant to the first echo, with a relay that was already "
        "running: how long a node that starts has to wait."
    ),
    nothing="no DDS run was recorded with --wire.",
    make=first_message_plan,
    opened=False,
)


def recovery_plan(book: Book) -> Plan | None:
    recoveries = book.analysis.details.recoveries
    times: dict[int, list[int]] = {}
    for group, back_ns in recoveries.filter(~recoveries["never"]).select("group", "back_ns").iter_rows():
        times.setdefault(group, []).append(back_ns)
    medians = {group: round(median(values)) for group, values in times.items()}
    return _own_times_plan(book, Facet("rest", "link", "vendor"), medians, "Time to the first reply")


RECOVERY = FigureMaker(
    name="recovery",
    title="Coming back",
    how_to_read=(
        "Each mark is the time from the end of an outage, of the kind and length in the setting, to the first reply, median of the runs "
        "that came back; a setup without a mark never did within the limit."
    ),
    nothing="no sweep made an outage within a run.",
    make=recovery_plan,
)


COUNTS = ("relays", "hosts", "pings", "topics", "flow", "flows", "wire")


@dataclass(frozen=True, slots=True)
class Receivers:
    group: int
    count: int
    first_ns: int | None
    last_ns: int | None
    matched_ns: int | None


def fan_out_plan(book: Book) -> Plan | None:
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
    return {"of": "Relays" if of == "receivers" else "Pings", "lines": lines} if lines else None


FAN_OUT = FigureMaker(
    name="fan_out",
    title="One message to several relays",
    how_to_read=(
        "Each bar reaches from the first relay that gets a message to the last one (median times); the mark is the last; on "
        "the right: the time from the start of the ping to the first answer of the last relay, which were all running."
    ),
    nothing="no message went to several relays, and no pings sent at the same time.",
    kind="fan_out",
    make=fan_out_plan,
    opened=False,
)
