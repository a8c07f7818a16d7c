"""Figures of lines as plotly values, for notebooks and papers: the page's own panels, names and styles, drawn in Python."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from plotly.graph_objects import Figure, Scatter
from plotly.subplots import make_subplots

from dds_trace.analyzer.model.parameters import PLACE_COLUMNS
from dds_trace.tracefile.errors import OptionError
from dds_trace.tracefile.units.durations import format_duration
from dds_trace.tracefile.units.rates import format_rate
from dds_trace.tracefile.units.sizes import format_size
from dds_trace.tracefile.visible import visible

from .book.groups import (
    METRIC_LABELS,
    STATISTIC_LABELS,
    data_type_label,
    device_label,
    domain_label,
    setting_labels,
)
from .figures.figure import over_two_positions, panels_info
from .html.styles import series_styles
from .text import format_ratio

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from .book.book import Book
    from .book.groups import Cell, Series
    from .figures.figure import Line, Panel
    from .html.styles import Style

    Word = Callable[[Cell, Series], str]

_PANEL_WIDTH, _PANEL_HEIGHT = 330, 280
_MS = 1e6


@dataclass(frozen=True, slots=True)
class Axis:
    """The horizontal axis of a figure: what stands on it, how a position is written, and what sets panels apart."""

    title: str
    position: Callable[[Cell], float]
    label: Callable[[float], str]
    panels: str


PLOTS: Mapping[str, Axis] = {
    "latency_by_size": Axis(
        "Message size", lambda cell: float(cell.payload_bytes), lambda at: format_size(round(at)), "rate"
    ),
    "latency_by_rate": Axis("Rate", lambda cell: cell.rate_hz, format_rate, "size"),
}
"""Figure of the page -> its axis."""

PANELS_BY: Mapping[str, Word] = {
    "size": lambda cell, _: format_size(cell.payload_bytes),
    "rate": lambda cell, _: format_rate(cell.rate_hz),
    "device": lambda _, series: device_label(series),
    "link": lambda _, series: visible(series.connectivity),
    "middleware": lambda _, series: series.vendor_label,
    "bridge": lambda _, series: domain_label(series),
}
"""What panels may be set apart by -> the word of a group."""


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
    # Neither unlike places nor the other axis of the plane ever share a line.
    others = [PANELS_BY[key] for key in ("device", "link", axis.panels) if PANELS_BY[key] is not by]

    def key(cell: Cell, series: Series) -> tuple[str, ...]:
        return (by(cell, series), data_type_label(cell.data_type), *(word(cell, series) for word in others))

    made = over_two_positions(
        panels_info(
            book.groups,
            key,
            lambda cell, series: _SEPARATOR.join(key(cell, series)),
            axis.position,
            drawn=lambda group: drawn[group] is not None,
        )
    )
    if not made:
        raise OptionError(f"{name}: nothing was measured at two positions of its axis ({axis.title.lower()})")
    return _figure(book, axis, made, metric, statistic)


def _chosen(what: str, value: str, known: Mapping[str, object]) -> str:
    if value not in known:
        raise OptionError(f"no {what} {value!r}; choose from {', '.join(known)}")
    return value


_SEPARATOR = "\0"
"""Between the words of a panel; `visible` leaves none in a word."""


def _figure(book: Book, axis: Axis, panels: tuple[Panel, ...], metric: str, statistic: str) -> Figure:
    words = [panel.title.split(_SEPARATOR) for panel in panels]
    columns = list(dict.fromkeys(first for first, *_ in words))
    rows = list(dict.fromkeys(tuple(rest) for _, *rest in words))
    varying = [len(set(column)) > 1 for column in zip(*words, strict=True)]
    titles = {
        (rows.index(tuple(own[1:])), columns.index(own[0])): ", ".join(
            word for word, varies in zip(own, varying, strict=True) if varies
        )
        or own[1]
        for own in words
    }
    figure = make_subplots(
        len(rows),
        len(columns),
        shared_yaxes=True,
        subplot_titles=[
            titles.get((row, column), "") for row in range(len(rows)) for column in range(len(columns))
        ],
        vertical_spacing=0.28 / len(rows),
    )
    choices, named = _choices(book), set[str]()
    for place, panel in zip(titles, panels, strict=True):
        row, column = (index + 1 for index in place)
        positions = sorted({at for line in panel.lines for at in line.x})
        for line in panel.lines:
            label, style = choices[line.series]
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


def _choices(book: Book) -> list[tuple[str, Style]]:
    """Return label and style of each series without its place, which its panel tells."""
    groups = book.groups
    untold = {**dict.fromkeys(PLACE_COLUMNS, ""), **dict.fromkeys(("ping_domain_id", "relay_domain_id"))}
    settings = [{**asdict(series), **untold} for series in groups.series]
    labels = setting_labels(settings, groups.vendors)
    of_label: dict[str, Style] = {}
    for label, style in zip(labels, series_styles(groups), strict=True):
        of_label.setdefault(label, style)
    return [(label, of_label[label]) for label in labels]


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
