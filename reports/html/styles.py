"""Look of a series, the same in every figure: colour and symbol show the vendor, the dash shows domain and bridge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..book.groups import VENDORS, known_first

if TYPE_CHECKING:
    from ..book.groups import Groups

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
SYMBOLS = ("circle", "square", "diamond", "triangle-up", "cross", "hexagon", "star", "triangle-down")
DASHES = ("solid", "dash", "dot", "dashdot", "longdash", "longdashdot")
SYMBOL_VARIANTS = ("", "-open", "-dot", "-open-dot")


@dataclass(frozen=True, slots=True)
class Style:
    """Names of plotly.js for symbol and dash, colours on light and dark ground."""

    light: str
    dark: str
    symbol: str
    dash: str


def vendor_places(groups: Groups) -> dict[str, int]:
    """Map each vendor to its place in the palette; known vendors keep theirs in every report."""
    return {
        name: place
        for place, name in enumerate(known_first([*VENDORS, *(s.vendor for s in groups.series)], VENDORS))
    }


def series_styles(groups: Groups) -> tuple[Style, ...]:
    """Choose a style for each series.

    The same domain is solid and every bridge has its own dash. Series of equal vendor and bridge (they differ in QoS
    or devices) differ by the filling of their symbol.
    """
    places = vendor_places(groups)
    ways = sorted({(one.domain_mode != "same", one.bridge) for one in groups.series})
    taken: dict[tuple[int, int], int] = {}
    styles = []
    for one in groups.series:
        vendor = places[one.vendor]
        way = ways.index((one.domain_mode != "same", one.bridge))
        variant = taken.get((vendor, way), 0)
        taken[vendor, way] = variant + 1
        light, dark = PALETTE[vendor % len(PALETTE)]
        symbol = SYMBOLS[vendor % len(SYMBOLS)] + SYMBOL_VARIANTS[variant % len(SYMBOL_VARIANTS)]
        styles.append(Style(light, dark, symbol, DASHES[way % len(DASHES)]))
    return tuple(styles)
