"""Looks of lines and bars, the same in every figure: colour shows the vendor, symbol, dash and hatching show the choice."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..book.groups import VENDORS, known_first

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..book.facets import Facets

# Okabe and Ito's colour-blind-safe hues, darkened for white paper and lightened for a dark one so that each keeps a
# contrast of 3:1 against it (WCAG 1.4.11). Known vendors have fixed places; others take the free ones by name.
PALETTE = (
    ("#0072b2", "#56a9e8"),  # blue
    ("#c04f00", "#ff8a3d"),  # vermilion
    ("#007a5a", "#2fc79a"),  # green
    ("#a8428a", "#e58bc8"),  # purple
    ("#5f6670", "#a9b1bd"),  # grey
    ("#8a6d00", "#e0c341"),  # ochre
    ("#5b4fc4", "#a59cf5"),  # indigo
    ("#8c2f39", "#ef8b95"),  # red
)
# A hollow mark says that messages were lost, so no symbol here is hollow. The first belong to the known vendors.
SYMBOLS = (
    *("circle", "square", "diamond", "triangle-up", "cross"),
    *("hexagon", "star", "triangle-down", "pentagon", "hourglass", "diamond-tall", "bowtie", "triangle-left"),
    *("triangle-right", "star-diamond", "hexagram", "diamond-wide", "star-triangle-up", "x"),
)
DASHES = ("solid", "dash", "dot", "dashdot", "longdash", "longdashdot")
# A bar crossed out (x) was lost, so no hatching here is.
HATCHES = ("", "/", "\\", "-", "|", "+", ".")


@dataclass(frozen=True, slots=True)
class Style:
    """Names of plotly.js for symbol, dash and hatching, colours on light and dark ground."""

    light: str
    dark: str
    symbol: str
    dash: str
    hatch: str


def choice_styles(facets: Facets) -> tuple[Style, ...]:
    """Choose a style for each choice.

    The same domain is solid, plain, and has its vendor's colour and symbol; every bridge has a dash, a hatching and, for each
    vendor, a symbol of its own. A bridge has its vendor's colour, unless a vendor has more than two choices and there are
    colours for all. Choices of equal vendor and bridge (they differ in QoS or backend) have further symbols. Symbols
    repeat only where there are more choices than symbols, and then in another colour or dash.
    """
    choices = facets.choices
    vendors = known_first([*VENDORS, *(one.vendor for one in choices)], VENDORS)
    ways = sorted({(one.domain_mode != "same", one.bridge) for one in choices})
    taken: set[tuple[str, ...]] = set()
    symbols_taken: set[str] = set()
    styles: dict[int, Style] = {}
    crowded = max(Counter(one.vendor for one in choices).values(), default=0) > 2 and len(choices) <= len(
        PALETTE
    )
    colours_taken: set[int] = set()
    # Who stays in one domain keeps the vendor's symbol, so it chooses first.
    for place in sorted(range(len(choices)), key=lambda place: choices[place].domain_mode != "same"):
        one = choices[place]
        vendor, way = vendors.index(one.vendor), ways.index((one.domain_mode != "same", one.bridge))
        colour = vendor % len(PALETTE)
        if crowded and colour in colours_taken:
            homes = {vendors.index(one.vendor) % len(PALETTE) for one in choices}
            others = [place for place in range(len(PALETTE)) if place not in colours_taken | homes]
            colour = others[0] if others else min(set(range(len(PALETTE))) - colours_taken)
        colours_taken.add(colour)
        colours = PALETTE[colour]
        own = SYMBOLS[vendor % len(SYMBOLS)]
        line = (DASHES[way % len(DASHES)], HATCHES[way % len(HATCHES)])
        wanted = [own, *SYMBOLS[len(VENDORS) :], *SYMBOLS]
        free = [symbol for symbol in wanted if symbol not in symbols_taken]
        free += [symbol for symbol in wanted if (*colours, symbol, *line) not in taken]
        symbol = free[0] if free else own
        symbols_taken.add(symbol)
        taken.add((*colours, symbol, *line))
        styles[place] = Style(*colours, symbol, *line)
    return tuple(styles[place] for place in range(len(choices)))


def option_styles(count: int) -> tuple[Style, ...]:
    """Choose a style for each of some options, by their order: of sizes, rates, places."""
    return tuple(
        Style(
            *PALETTE[place % len(PALETTE)],
            SYMBOLS[place % len(SYMBOLS)],
            DASHES[place // len(PALETTE) % len(DASHES)],
            HATCHES[place % len(HATCHES)],
        )
        for place in range(count)
    )


def line_styles(facets: Facets) -> Mapping[str, tuple[Style, ...]]:
    """Choose the styles of every dimension, one for each option."""
    return {
        key: choice_styles(facets) if key == "choice" else option_styles(len(dimension.options))
        for key, dimension in facets.dimensions.items()
    }
