"""Figures of lines as plotly values, for notebooks and papers: the page's own panels, names and styles, drawn in Python."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from plotly.graph_objects import Figure, Scatter
from plotly.subplots import make_subplots

from dds_trace.base.errors import OptionError
from dds_trace.base.units import format_duration, format_rate, format_size

from .book.groups import METRIC_LABELS, STATISTIC_LABELS, format_ratio
from .figures import capacity, comparison, distribution, latency
from .figures.figure import Faceted, LeftOut, panel_keys
from .html.styles import line_styles

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from .book.book import Book
    from .figures.distribution import Spread
    from .figures.figure import Figure as PageFigure
    from .figures.figure import Line, Panel
    from .html.styles import Style

_PANEL_WIDTH, _PANEL_HEIGHT = 330, 280
_POSITION_WIDTH = 24
"""Pixels of one combination on an axis of combinations."""
_MS, _MB = 1e6, 1e6


@dataclass(frozen=True, slots=True)
class Shown:
    """What the marks of a figure show.

    Attributes:
        title: of the vertical axis, with the unit.
        of: group -> its value in that unit; None where it has none.
        text: a value as a reader reads it.
        is_log: whether its axis is logarithmic.
    """

    title: str
    of: Callable[[int], float | None]
    text: Callable[[float], str]
    is_log: bool = True


@dataclass(frozen=True, slots=True)
class Asked:
    """What a reader asked for: the book, the figure's own numbers, and the metric and statistic of its times."""

    book: Book
    info: Faceted | Spread
    metric: str
    statistic: str


@dataclass(frozen=True, slots=True)
class Plot:
    """One figure of lines: its numbers, why there may be none, and what its marks show; as on the page."""

    info: Callable[[Book, str, str], Faceted | Spread]
    figure: Callable[..., PageFigure | LeftOut]
    panels: str
    shown: Callable[[Asked], Shown]


def _times(asked: Asked) -> Shown:
    times = asked.book.values.times_ns[asked.metric][asked.statistic]

    def of(group: int) -> float | None:
        ns = times[group]
        return None if ns is None or ns <= 0 else ns / _MS

    title = f"{METRIC_LABELS[asked.metric]}, {STATISTIC_LABELS[asked.statistic]} (ms)"
    return Shown(title, of, lambda ms: format_duration(ms * _MS))


def _in_relay(asked: Asked) -> Shown:
    return _times(replace(asked, metric="intermediate"))


def _received(asked: Asked) -> Shown:
    return _share("Received (%)", asked.book.values.plain["received_ratio"].__getitem__)


def _sustained(asked: Asked) -> Shown:
    return _share("Replies of the rate (%)", capacity.replies_of(asked.book))


def _spread(asked: Asked) -> Shown:
    reaches = getattr(asked.info, "reaches", {})
    name = asked.statistic if asked.statistic in reaches else "p50"
    return _share(f"± of a typical run's {STATISTIC_LABELS[name]} (%)", reaches[name].get)


def _share(title: str, of: Callable[[int], float | None]) -> Shown:
    def percent(group: int) -> float | None:
        share = of(group)
        return None if share is None else 100 * share

    return Shown(title, percent, lambda value: format_ratio(value / 100), is_log=False)


def _transferred(asked: Asked) -> Shown:
    rates = asked.book.values.plain["transfer_rate_bytes_per_s"]

    def of(group: int) -> float | None:
        rate = rates[group]
        return None if rate is None or rate <= 0 else rate / _MB

    return Shown("Transfer rate (MB/s)", of, lambda rate: f"{rate:.3g} MB/s")


PLOTS: Mapping[str, Plot] = {
    "latency_by_size": Plot(latency.latency_by_size_info, latency.latency_by_size_figure, "rate", _times),
    "latency_by_rate": Plot(latency.latency_by_rate_info, latency.latency_by_rate_figure, "size", _times),
    "vendor_comparison": Plot(
        comparison.vendor_comparison_info, comparison.vendor_comparison_figure, "way", _times
    ),
    "by_device": Plot(comparison.by_device_info, comparison.by_device_figure, "size", _times),
    "relay_time": Plot(latency.relay_time_info, latency.relay_time_figure, "rate", _in_relay),
    "received": Plot(capacity.received_info, capacity.received_figure, "way", _received),
    "run_spread": Plot(distribution.run_spread_info, distribution.run_spread_figure, "way", _spread),
    "sustainable": Plot(capacity.sustainable_info, capacity.sustainable_figure, "size", _sustained),
    "transfer_by_size": Plot(
        capacity.transfer_by_size_info, capacity.transfer_by_size_figure, "rate", _transferred
    ),
    "transfer_by_rate": Plot(
        capacity.transfer_by_rate_info, capacity.transfer_by_rate_figure, "size", _transferred
    ),
    "transfer_rate": Plot(capacity.transfer_rate_info, capacity.transfer_rate_figure, "way", _transferred),
}
"""Figure of the page that has lines or marks of groups -> how it is drawn here."""


@dataclass(frozen=True, slots=True)
class Axis:
    """A horizontal axis: its title and how a position is written. Positions stand at their values, on a log axis, or at 0, 1, 2 ..."""

    title: str
    label: Callable[[Book, float], str]
    is_log: bool = True


AXES: Mapping[str, Axis] = {
    "size": Axis("Message size", lambda _, at: format_size(round(at))),
    "rate": Axis("Rate", lambda _, at: format_rate(at)),
    "load": Axis("Offered load (MB/s)", lambda _, at: f"{at / _MB:.3g}"),
    "plane": Axis("Data, size and rate", lambda book, at: book.groups.cells[round(at)].label, is_log=False),
    "cell": Axis("Data, size and rate", lambda book, at: book.groups.cells[round(at)].label, is_log=False),
    "place": Axis(
        "Devices and link", lambda book, at: book.facets.dimensions["place"].options[round(at)], is_log=False
    ),
}
"""Dimension along an axis (`figures.figure.Facet.x`) -> the axis."""

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
        metric: column `<metric>_<statistic>_ns` of the summary, where the figure shows times; None for the page's.
        statistic: of `STATISTIC_LABELS`, where the figure shows times or their spread.

    Raises:
        OptionError: there is no such figure, dimension, metric or statistic, or nothing to draw.
    """
    plot = PLOTS[_chosen("figure", name, PLOTS)]
    by = plot.panels if panels is None else PANELS_BY[_chosen("panels", panels, PANELS_BY)]
    metric = _chosen("metric", metric or book.values.default_metric, METRIC_LABELS)
    _chosen("statistic", statistic, STATISTIC_LABELS)
    # What sets panels apart cannot tell lines apart, too.
    lines = "choice" if panels is None else {"vendor": "way", "way": "vendor"}.get(by, "choice")
    info = plot.info(book, by, lines)
    left_out = plot.figure(info)
    if isinstance(left_out, LeftOut):
        raise OptionError(f"{name}: {left_out.reason}")
    shown = plot.shown(Asked(book, info, metric, statistic))
    drawn = _with_values(info, shown)
    if not drawn.panels:
        raise OptionError(f"{name}: no group has a value of {shown.title}")
    return _figure(book, drawn, shown)


def _chosen(what: str, value: str, known: Mapping[str, object]) -> str:
    if value not in known:
        raise OptionError(f"no {what} {value!r}; choose from {', '.join(known)}")
    return value


def _with_values(info: Faceted | Spread, shown: Shown) -> Faceted:
    """Return the panels without the groups that have no value, and without lines and panels that have none left."""
    panels = []
    for panel in info.panels:
        kept = [
            replace(line, x=tuple(at for at, _ in points), groups=tuple(group for _, group in points))
            for line in panel.lines
            if (
                points := [
                    (at, group)
                    for at, group in zip(line.x, line.groups, strict=True)
                    if shown.of(group) is not None
                ]
            )
        ]
        if kept:
            panels.append(replace(panel, lines=tuple(kept)))
    return Faceted(info.facet, tuple(panels))


def _parts(panels: tuple[Panel, ...]) -> list[str]:
    """Return which part of its lines each panel has, as in `(1 of 2)`: such panels stand below one another."""
    return [
        panel.title.rpartition(" (")[2] if panel.title.endswith(")") and " of " in panel.title else ""
        for panel in panels
    ]


def _figure(book: Book, info: Faceted, shown: Shown) -> Figure:
    facet, facets, axis = info.facet, book.facets, AXES[info.facet.x]
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
    most = 0
    for place, panel in zip(places, info.panels, strict=True):
        row, column = (index + 1 for index in place)
        positions = sorted({at for line in panel.lines for at in line.x})
        most = max(most, len(positions))
        at = {position: position if axis.is_log else rank for rank, position in enumerate(positions)}
        for line in panel.lines:
            label, style = options[line.line], styles[line.line]
            trace = _trace(book, line, [at[position] for position in line.x], (label, style), shown)
            trace.mode = "lines+markers" if facet.x in ("size", "rate") else "markers"
            figure.add_trace(trace.update(showlegend=label not in named), row, column)
            named.add(label)
        ticks = [axis.label(book, position) for position in positions]
        kind = "log" if axis.is_log else "linear"
        figure.update_xaxes(type=kind, tickvals=list(at.values()), ticktext=ticks, row=row, col=column)
    figure.update_xaxes(title=axis.title, row=len(rows))
    figure.update_yaxes(type="log" if shown.is_log else "linear")
    figure.update_yaxes(title=shown.title, col=1)
    height = 160 + _PANEL_HEIGHT * len(rows)
    legend = {"orientation": "h", "y": -80 / height, "yanchor": "top"}
    wide = _PANEL_WIDTH if axis.is_log else max(_PANEL_WIDTH, _POSITION_WIDTH * most)
    return figure.update_layout(
        template="plotly_white", width=80 + wide * len(columns), height=height, legend=legend
    )


def _trace(book: Book, line: Line, at: list[float], choice: tuple[str, Style], shown: Shown) -> Scatter:
    """Draw one line; a group that lost messages has a faded mark, and says so."""
    label, style = choice
    values = [float(shown.of(group) or 0) for group in line.groups]
    shares = [book.values.plain["received_ratio"][group] for group in line.groups]
    received = ["" if share is None or share >= 1 else f"{format_ratio(share)} received" for share in shares]
    return Scatter(
        x=at,
        y=values,
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
            "<br>".join(filter(None, (label, shown.text(value), lost)))
            for value, lost in zip(values, received, strict=True)
        ],
        hoverinfo="text",
    )
