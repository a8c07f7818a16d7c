"""How the relay's clock runs against the ping's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..text import visible
from .figure import Figure, LeftOut, figure_maker

if TYPE_CHECKING:
    from ..book.book import Book

NAME = "clock"
TITLE = "Clock offset and drift"
HOW_TO_READ = (
    "Each mark is how far the relay's clock was from the ping's, less the first offset, with its bound; a slope is drift, a jump a clock that "
    "was set, and one-way times are only as good as the bound."
)

KNOTS_IN_PAGE = 4000
"""Shared by all pairs of devices; of more, every n-th."""


@dataclass(frozen=True, slots=True)
class ClockPair:
    """The clocks of two devices.

    Attributes:
        title: the devices, and the drift of the longest stretch without a step.
        elapsed_s: of each mark, since the first.
        offset_ns: relay's clock minus ping's, less `first_offset_ns`.
        bound_ns: how far each may be off.
        group: of each mark.
    """

    title: str
    first_offset_ns: int
    elapsed_s: tuple[float, ...]
    offset_ns: tuple[int, ...]
    bound_ns: tuple[int, ...]
    group: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Clock:
    """All pairs of devices that have two clocks."""

    pairs: tuple[ClockPair, ...]
    decimated: bool
    one_clock: bool
    """Whether a pair is left out because ping and relay ran on one device."""


def clock_info(book: Book) -> Clock:
    """The knots of `details.clock_knots`, of devices that are two."""
    if book.analysis.details is None:
        return Clock((), decimated=False, one_clock=False)
    fits, knots = book.analysis.details.clock_fits, book.analysis.details.clock_knots
    two = fits.filter(~fits["same_clock"])
    step = max(1, -(-knots.height // KNOTS_IN_PAGE))
    pairs = []
    for ping, relay, boot in (
        two.select("ping_device", "relay_device", "boot").unique(maintain_order=True).iter_rows()
    ):
        segments = two.filter(ping_device=ping, relay_device=relay, boot=boot)
        longest = segments.sort(segments["end_ns"] - segments["start_ns"]).row(-1, named=True)
        inside = knots["at_ns"].is_between(segments["start_ns"].min(), segments["end_ns"].max())
        own = (
            knots.filter(inside).filter(ping_device=ping, relay_device=relay).sort("at_ns").gather_every(step)
        )
        if not own.height:
            continue
        drift = f"{longest['drift_ppb'] / 1000:+.3g} ± {longest['drift_bound_ppb'] / 1000:.2g} ppm"
        first_ns, first_offset_ns = own["at_ns"][0], own["offset_ns"][0]
        pairs.append(
            ClockPair(
                f"{visible(ping)} → {visible(relay)}: drift {drift}",
                first_offset_ns,
                tuple(((own["at_ns"] - first_ns) / 1e9).round(3).to_list()),
                tuple((own["offset_ns"] - first_offset_ns).to_list()),
                tuple(own["bound_ns"].to_list()),
                tuple(own["group"].to_list()),
            )
        )
    return Clock(tuple(pairs), decimated=step > 1 and bool(pairs), one_clock=bool(fits["same_clock"].any()))


def clock_figure(info: Clock) -> Figure | LeftOut:
    """Marks with bounds over time, a panel per pair."""
    if not info.pairs:
        why = (
            "ping and relay ran on one device, so there is one clock"
            if info.one_clock
            else "no relay's clock is known"
        )
        return LeftOut(NAME, TITLE, f"{why}.")
    return Figure(NAME, TITLE, HOW_TO_READ, "clock", {"pairs": info.pairs, "decimated": info.decimated})


FIGURE = figure_maker(clock_info, clock_figure)
