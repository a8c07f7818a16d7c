"""Figures of marks and lines: latency, time in the relay, received messages and transfer rate over size, rate and device pair."""

from __future__ import annotations

from collections.abc import Callable

from ..book.book import Book
from .figure import LineFigure

KEPT_UP = 0.99
"""Replies per second as a share of the requested rate that counts as kept up."""
_TRANSFER_RATE = "Transfer rate"


def _has(column: str) -> Callable[[Book], Callable[[int], bool]]:
    return lambda book: lambda group: book.values.plain[column][group] is not None


def _below(column: str, share: float) -> Callable[[Book], Callable[[int], bool]]:
    return lambda book: lambda group: (book.values.plain[column][group] or 0) < share


LATENCY_BY_RATE = LineFigure(
    name="latency_by_rate",
    title="Latency against frequency",
    how_to_read=(
        "A flat line does not depend on the rate; a line that rises to the right is running out of capacity, one that falls "
        "is waking up from sleep."
    ),
    nothing="no message size was measured at two rates.",
    x="rate",
    panels="size",
    value="statistic",
    drawn=lambda book: book.values.timed,
    least=2,
    follows=True,
)

LATENCY_BY_SIZE = LineFigure(
    name="latency_by_size",
    title="Latency against size",
    how_to_read=(
        "Latency should rise gently with size; a sudden step marks a limit on the path, such as a socket buffer, a shared-memory segment "
        "or the link itself."
    ),
    nothing="no data type was measured with two message sizes at one rate.",
    x="size",
    panels="rate",
    value="statistic",
    drawn=lambda book: book.values.timed,
    least=2,
    follows=True,
)

RELAY_TIME = LineFigure(
    name="relay_time",
    title="Time in the relay against size",
    how_to_read=(
        "The time between a message's arrival at the relay and its way back (the paper's intermediate-process time) is not part of "
        "the latency; where it grows with size, the relay copies or serializes."
    ),
    nothing="no data type has a time in the relay at two message sizes.",
    x="size",
    panels="rate",
    value="statistic",
    drawn=lambda book: lambda group: book.values.times_ns["intermediate"]["p50"][group] is not None,
    least=2,
    settings={"metric": "intermediate"},
)

VENDOR_COMPARISON = LineFigure(
    name="vendor_comparison",
    title="Latency side by side, all results",
    how_to_read=(
        "Marks above one another sent the same messages: the lowest took the least time; every result of the campaign is in this figure, and "
        "times are of the received messages."
    ),
    nothing="no message was received.",
    x="plane",
    panels="way",
    value="statistic",
    drawn=lambda book: book.values.timed,
    follows=True,
)

BY_DEVICE = LineFigure(
    name="by_device",
    title="Latency by devices and link",
    how_to_read=(
        "Marks of one colour sent the same messages on other devices or another link; where their order changes, what is fastest on one "
        "device is not fastest on the other."
    ),
    nothing="everything was measured on the same devices and link.",
    x="place",
    panels="size",
    value="statistic",
    drawn=lambda book: book.values.timed,
    least=2,
    follows=True,
)

RECEIVED = LineFigure(
    name="received",
    title="Packets received",
    how_to_read=(
        "Everything should be on the 100 % line; a mark below it lost the rest of its messages, and its latency is of the received "
        "ones only."
    ),
    nothing="every message was received, or none was published.",
    x="plane",
    panels="way",
    value="received",
    label="Received",
    drawn=_has("received_ratio"),
    shows=_below("received_ratio", 1),
)

SUSTAINABLE = LineFigure(
    name="sustainable",
    title="Sustainable rate",
    how_to_read=(
        "Each mark is the replies per second in percent of the requested rate (achieved rate times share received); the rate at which a "
        "line leaves 100 % is more than that setup can sustain."
    ),
    nothing="every rate was kept up, or no message size was measured at two rates.",
    x="rate",
    panels="size",
    value="sustained",
    label="Replies of the rate",
    drawn=_has("sustained"),
    shows=_below("sustained", KEPT_UP),
    least=2,
    settings={"x_title": "Requested rate (Hz)"},
)

TRANSFER_RATE = LineFigure(
    name="transfer_rate",
    title="Transfer rate against offered load",
    how_to_read=(
        "Marks on the dashed diagonal carried all that was offered (size times rate); where marks leave it to the right, more was offered "
        "than could be carried."
    ),
    nothing="no result has the two messages that a transfer rate needs.",
    x="load",
    panels="way",
    value="transfer",
    label=_TRANSFER_RATE,
    drawn=_has("transfer_rate_bytes_per_s"),
)

TRANSFER_BY_SIZE = LineFigure(
    name="transfer_by_size",
    title="Transfer rate against size",
    how_to_read=(
        "A line that rises in proportion carries any size; where it bends, the bytes per second that can be carried limit "
        "the size."
    ),
    nothing="no data type has a transfer rate at two message sizes and one rate.",
    x="size",
    panels="rate",
    value="transfer",
    label=_TRANSFER_RATE,
    drawn=_has("transfer_rate_bytes_per_s"),
    least=2,
)

TRANSFER_BY_RATE = LineFigure(
    name="transfer_by_rate",
    title="Transfer rate against frequency",
    how_to_read=(
        "A line that rises in proportion carries any rate; where it bends, more messages per second bring no more bytes."
    ),
    nothing="no message size has a transfer rate at two rates.",
    x="rate",
    panels="size",
    value="transfer",
    label=_TRANSFER_RATE,
    drawn=_has("transfer_rate_bytes_per_s"),
    least=2,
)
