"""Messages that a relay could not get: it started later, or was replaced."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from .exchanges import Exchange
from .pair import MISSING, PairedMessages, Published


def present(
    exchanges: Sequence[Exchange], published: Sequence[Published], pair: Callable[[Exchange, Published], PairedMessages]
) -> list[NDArray[np.bool_]]:
    """Return for each exchange which messages count for its relay.

    For a relay that started within the run, those from the first one on that it got; for one that it replaced on its device, those
    before.
    """
    masks = [np.ones(len(messages), np.bool_) for messages in published]
    by_run: dict[int, list[int]] = defaultdict(list)
    for number, exchange in enumerate(exchanges):
        by_run[exchange.run.run_id].append(number)
    for numbers in by_run.values():
        if len(numbers) == 1:
            continue
        paired = {number: pair(exchanges[number], published[number]) for number in numbers}
        for late in numbers:
            first = _first_after_start(exchanges[late], published[late], paired[late])
            if first is None:
                continue
            masks[late][:first] = False
            for other in numbers:
                if other != late and _is_succeeded(exchanges[other], exchanges[late], paired[other], first):
                    masks[other][first:] = False
    return masks


def _first_after_start(exchange: Exchange, published: Published, paired: PairedMessages) -> int | None:
    """Return the first message that reached a relay which started within the run; None for other relays.

    The clocks need no fit: the least T3 - T1 is at least their offset.
    """
    arrived = paired.relay_in_ns != MISSING
    if exchange.relay is None or not arrived.any():
        return None
    if paired.relay_in_ns[arrived].min() < exchange.relay.monotonic_anchor_ns:  # an anchor that is not the start
        return None
    most_ahead_ns = int((paired.relay_in_ns[arrived] - published.publish_ns[arrived]).min())
    is_after = published.publish_ns >= exchange.relay.monotonic_anchor_ns - most_ahead_ns
    reached = np.flatnonzero(is_after & arrived)
    return None if is_after.all() or not len(reached) else int(reached[0])


def _is_succeeded(other: Exchange, late: Exchange, paired: PairedMessages, first: int) -> bool:
    if other.relay is None or late.relay is None or other.relay.device != late.relay.device:
        return False
    seen = (paired.relay_in_ns != MISSING) | (paired.receive_ns != MISSING)
    return not seen[first:].any() and bool(seen[:first].any())
