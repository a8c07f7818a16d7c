"""Figures of a report, in the order in which it shows them; a row each."""

from __future__ import annotations

from collections.abc import Sequence

from dds_trace.base.extension import offers

from ..book.book import Book
from ..book.groups import is_of_topics
from . import breakdown, clocks, costs, distribution, host_load, lines, own_times, timeline
from .figure import Figure, LineFigure, Plan, Scope, is_few

FIGURES: list[Figure] = [
    costs.DOTS,
    lines.LATENCY_BY_RATE,
    lines.LATENCY_BY_SIZE,
    costs.DOMAIN_DIFFERENCE,
    costs.BRIDGE_COST,
    costs.INTERFERENCE,
    own_times.FAN_OUT,
    lines.RECEIVED,
    breakdown.FIGURE,
    lines.VENDOR_COMPARISON,
    lines.BY_DEVICE,
    distribution.HEATMAP,
    lines.RELAY_TIME,
    distribution.RUN_SPREAD,
    lines.SUSTAINABLE,
    lines.TRANSFER_BY_RATE,
    lines.TRANSFER_BY_SIZE,
    lines.TRANSFER_RATE,
    *(figure for figures in offers("figures").values() for figure in figures()),
    own_times.FIRST_MESSAGE,
    clocks.ONE_WAY,
    clocks.CLOCK,
    distribution.PERCENTILE_CURVE,
    distribution.ECDF,
    own_times.RECOVERY,
    timeline.FIGURE,
    host_load.FIGURE,
]


def drawn_figures(book: Book) -> tuple[list[tuple[Figure, Plan]], list[tuple[Figure, str]]]:
    few, of_topics = is_few(book), is_of_topics(book.analysis)
    drawn: list[tuple[Figure, Plan]] = []
    left_out: list[tuple[Figure, str]] = []
    for figure in FIGURES:
        if (figure is costs.DOTS and not few) or (of_topics and figure is not clocks.CLOCK):
            continue
        plan = figure.plan(book)
        if plan is None:
            left_out.append((figure, figure.nothing))
        elif few and not (figure.few or _has_line(book, figure)) and not of_topics:
            left_out.append((figure, "so few results are in the first figure, all in one."))
        else:
            drawn.append((figure, plan))
    return drawn, left_out


LEAST_MARKS = 3


def _has_line(book: Book, figure: Figure) -> bool:
    if not isinstance(figure, LineFigure) or figure not in (lines.LATENCY_BY_RATE, lines.LATENCY_BY_SIZE):
        return False
    return any(len(line.x) >= LEAST_MARKS for panel in figure.info(book).panels for line in panel.lines)


MOST_OPENED_PANELS = 9


def opened_figures(book: Book, drawn: Sequence[Figure]) -> frozenset[str]:
    """Return the figures that the page opens: lines over what varies most, and on one device pair those `opened`."""
    options = {key: len(dimension.options) for key, dimension in book.facets.dimensions.items()}
    over = sorted((("rate", lines.LATENCY_BY_RATE), ("size", lines.LATENCY_BY_SIZE)), key=lambda key: -options[key[0]])
    makers = [lines.BY_DEVICE, *(maker for _, maker in over), lines.VENDOR_COMPARISON]
    best = next(
        (maker for maker in makers if 0 < len(maker.info(book).panels) <= MOST_OPENED_PANELS), lines.VENDOR_COMPARISON
    )
    whole = options["place"] == 1 or is_few(book)
    return frozenset(
        figure.name for figure in drawn if figure is best or (figure.opened and (whole or figure.scope is Scope.CELL))
    )
