"""Messages by how often they were sent again, against their times."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..book.numbers import whole_ns
from .figure import Figure, LeftOut, Scope, figure_maker

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..book.book import Book


@dataclass(frozen=True, slots=True)
class Repeats:
    """Messages of one group that were sent again equally often.

    Attributes:
        repeats: number of repeats, of the way out and back together.
        messages: number of messages.
        p50_ns: median time of those that came back.
        max_ns: longest time of those.
    """

    repeats: int
    messages: int
    p50_ns: int | None
    max_ns: int | None


@dataclass(frozen=True, slots=True)
class SentAgain:
    """Group -> its messages by number of repeats, rising; groups with a repeated message alone.

    Attributes:
        metric: `latency`, or `rtt` where a relay's trace is missing.
    """

    groups: Mapping[int, tuple[Repeats, ...]]
    metric: str


def sent_again_info(book: Book) -> SentAgain:
    """Collect `details.wire_repeats`."""
    frame = book.analysis.details.wire_repeats
    metric = "latency" if frame["latency_p50_ns"].count() == frame["rtt_p50_ns"].count() else "rtt"
    columns = ("group", "repeats", "messages", f"{metric}_p50_ns", f"{metric}_max_ns")
    groups: dict[int, list[Repeats]] = {}
    for group, repeats, messages, p50_ns, max_ns in frame.select(columns).iter_rows():
        groups.setdefault(group, []).append(Repeats(repeats, messages, whole_ns(p50_ns), whole_ns(max_ns)))
    return SentAgain(
        {group: tuple(held) for group, held in groups.items() if any(one.repeats for one in held)}, metric
    )


def sent_again_figure(info: SentAgain) -> Figure | LeftOut:
    """Draw times over the number of repeats, for the series of the chosen cell."""
    name, title = "sent_again", "Sent again"
    how_to_read = (
        "Each mark is the median time of the messages that were sent again so often, its bar reaches to the slowest; a step "
        "from 0 to 1 is the price of one loss, and where it is a heartbeat's period, recovery waits for heartbeats."
    )
    if not info.groups:
        return LeftOut(name, title, "no message was sent again, or no run was recorded with --wire.")
    groups = {str(group): held for group, held in info.groups.items()}
    return Figure(name, title, how_to_read, "sent_again", {"groups": groups, "metric": info.metric})


FIGURE = figure_maker(sent_again_info, sent_again_figure, Scope.CELL)
