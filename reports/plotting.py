"""Figures of lines as plotly values, for notebooks and papers: the page's own panels, names and styles, drawn in Python."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from plotly.graph_objects import Figure, Scatter
from plotly.subplots import make_subplots

from dds_trace.tracefile.errors import OptionError
from dds_trace.tracefile.units.durations import format_duration
from dds_trace.tracefile.units.rates import format_rate
from dds_trace.tracefile.units.sizes import format_size

from .book.groups import METRIC_LABELS, STATISTIC_LABELS
from .figures.figure import Facet, Faceted, faceted_lines, panel_keys
from .html.styles import line_styles
from .text import format_ratio

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from .book.book import Book
    from .figures.figure import Line, Panel
    from .html.styles import Style

_PANEL_WIDTH, _PANEL_HEIGHT = 330, 280
_MS = 1e6


@dataclass(frozen=True, slots=True)
class Axis:
    """The horizontal axis of a figure: its dimension, how a position is written, and what sets panels apart."""

    title: str
    x: str
    label: Callable[[float], str]
    panels: str


PLOTS: Mapping[str, Axis] = {
    "latency_by_size": Axis("Message size", "size", lambda at: format_size(round(at)), "rate"),
    "latency_by_rate": Axis("Rate", "rate", format_rate, "size"),
}
"""Figure of the page -> its axis."""

PANELS_BY: Mapping[str, str] = {
    "size": "size",
    "rate": "rate",
    "device": "device",
    "link": "link",
    "middleware": "vendor",
    "bridge": "way",
}
"""What panels may be set apart by -> its dimension of `book.facets`."""


def line_figure(book: Book, name: str, panels: str | None, metric: str | None, statistic: str) -> Figure:
    """Draw a figure of lines: a column of panels for each value of `panels`, rows for what else tells groups apart.

    Args:
        book: of the analysis.
        name: one of `PLOTS`.
        panels: one of `PANELS_BY`; None as on the page.
        metric: column `<metric>_<statistic>_ns` of the summary; None for the page's.
        statistic: of `STATISTIC_LABELS`.

    Raises:
        OptionError: there is no such figure, dimension, metric or statistic, or nothing to draw.
    """
    axis = PLOTS[_chosen("figure", name, PLOTS)]
    by = PANELS_BY[_chosen("panels", panels or axis.panels, PANELS_BY)]
    metric = _chosen("metric", metric or book.values.default_metric, METRIC_LABELS)
    _chosen("statistic", statistic, STATISTIC_LABELS)
    drawn = book.values.times_ns[metric][statistic]
    # What sets panels apart cannot tell lines apart, too.
    lines = {"vendor": "way", "way": "vendor"}.get(by, "choice")
    info = faceted_lines(book, Facet(axis.x, by, lines), lambda group: drawn[group] is not None)
    if not info.panels:
        raise OptionError(f"{name}: nothing was measured at two positions of its axis ({axis.title.lower()})")
    return _figure(book, axis, info, metric, statistic)


def _chosen(what: str, value: str, known: Mapping[str, object]) -> str:
    if value not in known:
        raise OptionError(f"no {what} {value!r}; choose from {', '.join(known)}")
    return value


def _parts(panels: tuple[Panel, ...]) -> list[str]:
    """Return which part of its lines each panel has, as in `(1 of 2)`: such panels stand below one another."""
    return [
        panel.title.rpartition(" (")[2] if panel.title.endswith(")") and " of " in panel.title else ""
        for panel in panels
    ]


def _figure(book: Book, axis: Axis, info: Faceted, metric: str, statistic: str) -> Figure:
    facet, facets = info.facet, book.facets
    first = [panel.lines[0].groups[0] for panel in info.panels]
    beside, below = (
        [
            (*(facets.label(key, group) for key in keys), part)
            for group, part in zip(first, parts, strict=True)
        ]
        for keys, parts in zip(panel_keys(facet), ([""] * len(first), _parts(info.panels)), strict=True)
    )
    columns, rows = list(dict.fromkeys(beside)), list(dict.fromkeys(below))
    places = [(rows.index(low), columns.index(side)) for low, side in zip(below, beside, strict=True)]
    titles = {place: panel.title for place, panel in zip(places, info.panels, strict=True)}
    figure = make_subplots(
        len(rows),
        len(columns),
        shared_yaxes=True,
        subplot_titles=[
            titles.get((row, column), "") for row in range(len(rows)) for column in range(len(columns))
        ],
        vertical_spacing=0.28 / len(rows),
    )
    options, named = facets.dimensions[facet.lines].options, set[str]()
    styles = line_styles(facets)[facet.lines]
    for place, panel in zip(places, info.panels, strict=True):
        row, column = (index + 1 for index in place)
        positions = sorted({at for line in panel.lines for at in line.x})
        for line in panel.lines:
            label, style = options[line.line], styles[line.line]
            trace = _trace(book, line, (label, style), metric, statistic)
            figure.add_trace(trace.update(showlegend=label not in named), row, column)
            named.add(label)
        ticks = [axis.label(at) for at in positions]
        figure.update_xaxes(type="log", tickvals=positions, ticktext=ticks, row=row, col=column)
    figure.update_xaxes(title=axis.title, row=len(rows))
    figure.update_yaxes(type="log")
    figure.update_yaxes(title=f"{METRIC_LABELS[metric]}, {STATISTIC_LABELS[statistic]} (ms)", col=1)
    height = 160 + _PANEL_HEIGHT * len(rows)
    legend = {"orientation": "h", "y": -80 / height, "yanchor": "top"}
    return figure.update_layout(
        template="plotly_white", width=80 + _PANEL_WIDTH * len(columns), height=height, legend=legend
    )


def _trace(book: Book, line: Line, choice: tuple[str, Style], metric: str, statistic: str) -> Scatter:
    """Draw one line; a group that lost messages has a faded mark, and says so."""
    label, style = choice
    times = [float(book.values.times_ns[metric][statistic][group] or 0) for group in line.groups]
    shares = [book.values.plain["received_ratio"][group] for group in line.groups]
    received = ["" if share is None or share >= 1 else f"{format_ratio(share)} received" for share in shares]
    return Scatter(
        x=list(line.x),
        y=[time / _MS for time in times],
        mode="lines+markers",
        name=label,
        legendgroup=label,
        line={"color": style.light, "dash": style.dash},
        marker={
            "size": 8,
            "color": style.light,
            "symbol": style.symbol,
            "opacity": [0.35 if lost else 1.0 for lost in received],
        },
        hovertext=[
            "<br>".join(filter(None, (label, format_duration(time), lost)))
            for time, lost in zip(times, received, strict=True)
        ],
        hoverinfo="text",
    )
