"""One-way times, and the clock fits that they rest on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dds_trace.base.printable import printable

from ..book.book import Book
from ..book.groups import STATISTIC_LABELS, drift_words
from ..book.numbers import whole_ns
from .figure import FigureMaker, Plan, plane_facet, spread_plan


@dataclass(frozen=True, slots=True)
class Way:
    """One-way times of one group by statistic, in ns, and the median of their clock bound."""

    outbound_ns: Mapping[str, int | None]
    return_ns: Mapping[str, int | None]
    bound_ns: int | None


def one_way_plan(book: Book) -> Plan | None:
    rows: dict[int, dict[str, Mapping[str, Any]]] = {}
    for row in book.analysis.details.one_way.iter_rows(named=True):
        rows.setdefault(row["group"], {})[row["metric"]] = row
    ways = {
        group: Way(_times(pair["outbound"]), _times(pair["return"]), whole_ns(pair["outbound"]["bound_p50_ns"]))
        for group, pair in rows.items()
        if pair.keys() == {"outbound", "return"}
    }
    return spread_plan(book, plane_facet(book), ways.__contains__, ways=ways)


def _times(row: Mapping[str, Any]) -> dict[str, int | None]:
    return {name: whole_ns(row[f"{name}_ns"]) for name in STATISTIC_LABELS}


ONE_WAY = FigureMaker(
    name="one_way",
    title="The way out against the way back",
    how_to_read=(
        "Triangles are the way out, strokes the way back; a bar is how far the clocks of the two devices may be off, and asymmetry "
        "inside it cannot be seen."
    ),
    nothing="no message has all four time stamps (a relay's trace is missing).",
    kind="one_way",
    make=one_way_plan,
    opened=False,
)


KNOTS_IN_PAGE = 4000
"""Most clock knots in a page; of more, every n-th is drawn."""


@dataclass(frozen=True, slots=True)
class ClockPair:
    """Clocks of one device pair, `elapsed_s` since the first mark; the title has the drift of the longest segment."""

    title: str
    first_offset_ns: int
    elapsed_s: tuple[float, ...]
    offset_ns: tuple[int, ...]
    bound_ns: tuple[int, ...]
    group: tuple[int, ...]


def clock_plan(book: Book) -> Plan | None:
    fits, knots = book.analysis.details.clock_fits, book.analysis.details.clock_knots
    two = fits.filter(~fits["same_clock"])
    step = max(1, -(-knots.height // KNOTS_IN_PAGE))
    pairs = []
    keys = two.select("ping_device", "relay_device", "boot", "relay_boot").unique(maintain_order=True)
    for ping, relay, boot, relay_boot in keys.iter_rows():
        same_boot = two.filter(two["relay_boot"].eq_missing(relay_boot))
        segments = same_boot.filter(ping_device=ping, relay_device=relay, boot=boot)
        longest = segments.sort(segments["end_ns"] - segments["start_ns"]).row(-1, named=True)
        inside = knots["at_ns"].is_between(segments["start_ns"].min(), segments["end_ns"].max())
        inside &= knots["relay_boot"].eq_missing(relay_boot)
        points = knots.filter(inside).filter(ping_device=ping, relay_device=relay)
        points = points.sort("at_ns").gather_every(step)
        if not points.height:
            continue
        drift = drift_words(longest)
        first_ns, first_offset_ns = points["at_ns"][0], points["offset_ns"][0]
        pairs.append(
            ClockPair(
                f"{printable(ping)} → {printable(relay)}: drift {drift}",
                first_offset_ns,
                tuple(((points["at_ns"] - first_ns) / 1e9).round(3).to_list()),
                tuple((points["offset_ns"] - first_offset_ns).to_list()),
                tuple(points["bound_ns"].to_list()),
                tuple(points["group"].to_list()),
            )
        )
    return {"pairs": pairs, "decimated": step > 1} if pairs else None


CLOCK = FigureMaker(
    name="clock",
    title="Clock offset and drift",
    how_to_read=(
        "Each mark is how far the relay's clock was from the ping's, less the first offset, with its bound; a slope is drift, a jump a "
        "clock that was set, and one-way times are only as good as the bound."
    ),
    nothing="ping and relay ran on one device, so there is one clock, or no relay's clock was measured.",
    kind="clock",
    make=clock_plan,
    opened=False,
)
