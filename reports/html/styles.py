"""Looks of lines and bars: colour shows the vendor; symbol, dash and tint show the setup."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ..book.facets import Facets
from ..book.groups import VENDORS, in_order_of

# Okabe and Ito's colour-blind-safe hues, darkened for white paper and lightened for a dark one to a contrast of 3:1
# (WCAG 1.4.11). The vendors of `VENDORS` have fixed indices; others take the free ones by name.
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
# A hollow mark means lost messages, so no symbol here is hollow. The first belong to the vendors of `VENDORS`.
SYMBOLS = (
    *("circle", "square", "diamond", "triangle-up", "cross"),
    *("hexagon", "star", "triangle-down", "pentagon", "hourglass", "diamond-tall", "bowtie", "triangle-left"),
    *("triangle-right", "star-diamond", "hexagram", "diamond-wide", "star-triangle-up", "x"),
)
DASHES = ("solid", "dash", "dot", "dashdot", "longdash", "longdashdot")
TINTS = (1.0, 0.4, 0.65, 0.2, 0.85, 0.5, 0.3)
"""Share of the colour in the filling of a bar; its outline has all of it."""


@dataclass(frozen=True, slots=True)
class Style:
    """Colours on a light and a dark page, and plotly.js's names of symbol and dash, and the tint of bars."""

    light: str
    dark: str
    symbol: str
    dash: str
    tint: float


def choice_styles(facets: Facets) -> tuple[Style, ...]:
    """The same domain is solid, with its vendor's colour and symbol; a bridge has a dash, a tint and a symbol per
    vendor, and its vendor's colour unless a vendor has more than two setups and there are colours for all.
    """
    setups = facets.choices
    vendors = in_order_of([*VENDORS, *(setup.vendor for setup in setups)], VENDORS)
    ways = sorted({(setup.domain_mode != "same", setup.bridge) for setup in setups})
    own_colours = {vendors.index(setup.vendor) % len(PALETTE) for setup in setups}
    most = max(Counter(setup.vendor for setup in setups).values(), default=0)
    is_crowded = most > 2 and len(setups) <= len(PALETTE)
    used: set[tuple[object, ...]] = set()
    used_symbols: set[str] = set()
    used_colours: set[int] = set()
    styles: dict[int, Style] = {}
    # The plainest setup in one domain keeps the vendor's colour and symbol, so it chooses first.
    for index in sorted(range(len(setups)), key=lambda at: (setups[at].domain_mode != "same", len(setups[at].setting))):
        setup = setups[index]
        vendor, way = vendors.index(setup.vendor), ways.index((setup.domain_mode != "same", setup.bridge))
        colour = vendor % len(PALETTE)
        if is_crowded and colour in used_colours:
            free_colours = set(range(len(PALETTE))) - used_colours
            colour = min(free_colours - own_colours or free_colours)
        used_colours.add(colour)
        colours, symbols = PALETTE[colour], SYMBOLS[vendor % len(SYMBOLS)]
        line = (DASHES[way % len(DASHES)], TINTS[way % len(TINTS)])
        preferred = [symbols, *SYMBOLS[len(VENDORS) :], *SYMBOLS]
        free = [symbol for symbol in preferred if symbol not in used_symbols]
        free += [symbol for symbol in preferred if (*colours, symbol, *line) not in used]
        symbol = free[0] if free else symbols
        used_symbols.add(symbol)
        used.add((*colours, symbol, *line))
        styles[index] = Style(*colours, symbol, *line)
    return tuple(styles[index] for index in range(len(setups)))


def option_styles(indices: Sequence[int]) -> tuple[Style, ...]:
    return tuple(
        Style(
            *PALETTE[index % len(PALETTE)],
            SYMBOLS[index % len(SYMBOLS)],
            DASHES[(index // len(PALETTE) + indices[:number].count(index)) % len(DASHES)],
            TINTS[index % len(TINTS)],
        )
        for number, index in enumerate(indices)
    )


def _indices(key: str, labels: Sequence[str]) -> Sequence[int]:
    """Return an index for each label; a vendor, of any version, has the same one in every report."""
    if key != "vendor":
        return range(len(labels))
    names = [*VENDORS.values()]
    return [next((at for at, name in enumerate(names) if label.startswith(name)), len(names)) for label in labels]


def line_styles(facets: Facets) -> Mapping[str, tuple[Style, ...]]:
    return {
        key: choice_styles(facets) if key == "choice" else option_styles(_indices(key, dimension.options))
        for key, dimension in facets.dimensions.items()
    }
