"""Time from the end of an outage to the first reply."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import median

from ..book.book import Book
from .figure import Facet, Faceted, Figure, FigureMaker, LeftOut, facet_panels, facet_plan


@dataclass(frozen=True, slots=True)
class Recovery(Faceted):
    """Groups over their settings, which name the outage; `times_ns` is group -> median of its runs that came back."""

    times_ns: Mapping[int, int]


def recovery_info(book: Book) -> Recovery:
    times: dict[int, list[int]] = {}
    for group, back_ns in (
        book.analysis.details.recoveries.filter(~book.analysis.details.recoveries["never"])
        .select("group", "back_ns")
        .iter_rows()
    ):
        times.setdefault(group, []).append(back_ns)
    medians = {group: round(median(own)) for group, own in times.items()}
    facet = Facet("rest", "link", "vendor")
    return Recovery(facet, facet_panels(book, facet, medians.__contains__), medians)


def recovery_figure(info: Recovery) -> Figure | LeftOut:
    name, title = "recovery", "Coming back"
    how_to_read = (
        "Each mark is the time from the end of an outage, of the kind and length in the setting, to the first reply, median of the runs "
        "that came back; a setup without a mark never did within the limit."
    )
    if not info.panels:
        return LeftOut(name, title, "no sweep made an outage within a run.")
    values = {str(group): time_ns for group, time_ns in info.times_ns.items()}
    plan = facet_plan(info.facet, info.panels, value="own", values_ns=values, label="Time to the first reply")
    return Figure(name, title, how_to_read, "lines", plan)


FIGURE = FigureMaker(recovery_info, recovery_figure)
