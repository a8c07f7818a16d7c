"""Figures of lines as plotly values, for notebooks and papers, with the page's panels, names and styles."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from plotly.graph_objects import Figure, Scatter
from plotly.subplots import make_subplots

from dds_trace.base.errors import OptionError
from dds_trace.base.units import format_duration, format_rate, format_ratio, format_size
from dds_trace.reports.book.book import Book
from dds_trace.reports.book.groups import METRIC_LABELS, STATISTIC_LABELS
from dds_trace.reports.figures.distribution import RUN_SPREAD, run_reaches
from dds_trace.reports.figures.figure import Faceted, Line, LineFigure, facet_panels, panel_keys, plane_facet
from dds_trace.reports.figures.table import FIGURES
from dds_trace.reports.html.styles import Style, line_styles

_PANEL_WIDTH, _PANEL_HEIGHT = 330, 280
_POSITION_WIDTH = 110, 24
"""Pixels of one message on an axis of messages, of few and of twelve or more, whose names are turned."""
_MS, _MB = 1e6, 1e6


@dataclass(frozen=True, slots=True)
class Shown:
    title: str
    of: Callable[[int], float | None]
    text: Callable[[float], str]
    is_log: bool = True


LINE_FIGURES = {row.name: row for row in FIGURES if isinstance(row, LineFigure)}
NAMES = (*LINE_FIGURES, RUN_SPREAD.name)


def _shown(book: Book, figure: LineFigure, metric: str, statistic: str) -> Shown:
    if figure.value == "statistic":
        title = f"{METRIC_LABELS[metric]}, {STATISTIC_LABELS[statistic]} of all messages (ms)"
        times = book.values.times_ns[metric][statistic]
        return Shown(title, _positive(times, _MS), lambda ms: format_duration(ms * _MS))
    if figure.value == "transfer":
        rates = book.values.plain["transfer_rate_bytes_per_s"]
        return Shown(f"{figure.label} (MB/s)", _positive(rates, _MB), lambda rate: f"{rate:.3g} MB/s")
    column = {"received": "received_ratio"}.get(figure.value, figure.value)
    return _percent(f"{figure.label} (%)", book.values.plain[column].__getitem__)


def _positive(values: Sequence[float | None], unit: float) -> Callable[[int], float | None]:
    def of(group: int) -> float | None:
        value = values[group]
        return None if value is None or value <= 0 else value / unit

    return of


def _percent(title: str, share_of: Callable[[int], float | None]) -> Shown:
    def of(group: int) -> float | None:
        share = share_of(group)
        return None if share is None else 100 * share

    return Shown(title, of, lambda value: format_ratio(value / 100), is_log=False)


@dataclass(frozen=True, slots=True)
class Axis:
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

PANELS_BY: Mapping[str, str] = {
    "size": "size",
    "rate": "rate",
    "device": "device",
    "link": "link",
    "middleware": "vendor",
    "bridge": "way",
}


def line_figure(book: Book, name: str, panels: str | None, metric: str | None, statistic: str) -> Figure:
    """Draw a figure of lines: a column of panels for each value of `panels`, rows for other differences of groups.

    None is as on the page; an `OptionError` where a name is not one, or nothing is to draw.
    """
    _check("figure", name, NAMES)
    _check("panels", panels or "size", PANELS_BY)
    metric = metric or book.values.default_metric
    _check("metric", metric, METRIC_LABELS)
    _check("statistic", statistic, STATISTIC_LABELS)
    by = PANELS_BY[panels] if panels else ""
    lines = {"vendor": "way", "way": "vendor"}.get(by, "choice")  # what separates panels cannot separate lines
    info, shown = _drawn(book, name, (by, lines), metric, statistic)
    if not info.panels:
        raise OptionError(f"{name}: {LINE_FIGURES.get(name, RUN_SPREAD).nothing}")
    with_values = _with_values(info, shown)
    if not with_values.panels:
        raise OptionError(f"{name}: no result has a value of {shown.title}")
    return _figure(book, with_values, shown)


def _drawn(book: Book, name: str, spread: tuple[str, str], metric: str, statistic: str) -> tuple[Faceted, Shown]:
    panels, lines = spread
    if name == RUN_SPREAD.name:
        reaches = run_reaches(book)
        percentile = statistic if statistic in reaches else "p50"
        title = f"± of a typical run's {STATISTIC_LABELS[percentile]} (%)"
        facet = plane_facet(book, panels or "way", lines)
        drawn = {group for by_group in reaches.values() for group in by_group}
        runs = Faceted(facet, facet_panels(book, facet, drawn.__contains__))
        return runs, _percent(title, reaches[percentile].get)
    figure = LINE_FIGURES[name]
    metric = str(figure.settings.get("metric", metric))
    return figure.info(book, panels, lines), _shown(book, figure, metric, statistic)


def _check(what: str, value: str, values: Mapping[str, object] | Sequence[str]) -> None:
    if value not in values:
        raise OptionError(f"no {what} {value!r}; choose from {', '.join(values)}")


def _with_values(info: Faceted, shown: Shown) -> Faceted:
    panels = []
    for panel in info.panels:
        lines = []
        for line in panel.lines:
            points = [point for point in zip(line.x, line.groups, strict=True) if shown.of(point[1]) is not None]
            if points:
                x, groups = zip(*points, strict=True)
                lines.append(replace(line, x=x, groups=groups))
        if lines:
            panels.append(replace(panel, lines=tuple(lines)))
    return Faceted(info.facet, tuple(panels))


def _figure(book: Book, info: Faceted, shown: Shown) -> Figure:
    facet, facets, axis = info.facet, book.facets, AXES[info.facet.x]
    column_keys, row_keys = panel_keys(facet)
    keys: list[tuple[tuple[str, ...], tuple[str, ...]]] = []
    for panel in info.panels:
        group = panel.lines[0].groups[0]
        column_key = tuple(facets.label(key, group) for key in column_keys)
        keys.append(((*(facets.label(key, group) for key in row_keys), str(panel.part)), column_key))
    rows, columns = (list(dict.fromkeys(key[side] for key in keys)) for side in (0, 1))
    titles = {key: panel.title for key, panel in zip(keys, info.panels, strict=True)}
    figure = make_subplots(
        len(rows),
        len(columns),
        shared_yaxes=True,
        subplot_titles=[titles.get((low, side), "") for low in rows for side in columns],
        vertical_spacing=0.28 / len(rows),
    )
    options, styles = facets.dimensions[facet.lines].options, line_styles(facets)[facet.lines]
    in_legend = set[str]()
    most = 0
    for (row_key, column_key), panel in zip(keys, info.panels, strict=True):
        row, column = rows.index(row_key) + 1, columns.index(column_key) + 1
        positions = sorted({at for line in panel.lines for at in line.x})
        most = max(most, len(positions))
        at = {position: position if axis.is_log else rank for rank, position in enumerate(positions)}
        for line in panel.lines:
            label = options[line.line]
            trace = _trace(book, line, [at[position] for position in line.x], (label, styles[line.line]), shown)
            trace.mode = "lines+markers" if facet.x in ("size", "rate") else "markers"
            figure.add_trace(trace.update(showlegend=label not in in_legend), row, column)
            in_legend.add(label)
        ticks = [axis.label(book, position).replace(" at ", "<br>at ") for position in positions]
        kind = "log" if axis.is_log else "linear"
        figure.update_xaxes(type=kind, tickvals=list(at.values()), ticktext=ticks, row=row, col=column)
    figure.update_xaxes(title=axis.title, row=len(rows))
    figure.update_yaxes(type="log" if shown.is_log else "linear")
    figure.update_yaxes(title=shown.title, col=1)
    height = 160 + _PANEL_HEIGHT * len(rows)
    legend = {"orientation": "h", "y": -80 / height, "yanchor": "top"}
    wide = _PANEL_WIDTH if axis.is_log else max(_PANEL_WIDTH, _POSITION_WIDTH[most > 11] * most)
    return figure.update_layout(template="plotly_white", width=80 + wide * len(columns), height=height, legend=legend)


def _trace(book: Book, line: Line, at: list[float], look: tuple[str, Style], shown: Shown) -> Scatter:
    label, style = look
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
