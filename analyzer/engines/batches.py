"""Cut a campaign into batches that fit into memory."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ..groups.batch import Batch

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from ..groups.batch import Wanted
    from ..groups.grouping import Grouping
    from ..pairing.exchanges import Exchange

BATCH_EVENTS = 1_000_000
"""Events of a batch, unless one group alone has more: a hundred megabytes while it is worked at. Of a campaign of few
batches one is written while the next is paired; smaller ones cost more in polars' fixed times than they gain."""

WHOLE_GROUP_EVENTS = 8_000_000
"""A group with more events is worked at in parts of whole runs."""


def plan_batches(grouping: Grouping, wanted: Wanted) -> list[Batch]:
    """Return batches of whole groups, in their order; a group too large for one comes in parts of whole runs."""
    exchanges, groups = grouping.exchanges, grouping.group_of_exchange
    events_before = np.cumsum([0, *(sum(exchange.counts) for exchange in exchanges)]).tolist()

    def events(first: int, after: int) -> int:
        return int(events_before[after] - events_before[first])

    spans: list[
        tuple[int, int, bool]
    ] = []  # first exchange, the one behind the last, whether of whole groups
    edges = [0, *(np.flatnonzero(np.diff(groups)) + 1).tolist(), len(exchanges)]
    for first, after in pairwise(edges):
        if (
            events(first, after) > WHOLE_GROUP_EVENTS
            and len({e.run.run_id for e in exchanges[first:after]}) > 1
        ):
            spans += ((*part, False) for part in _parts_of_group(exchanges, first, after, events))
        elif spans and spans[-1][2] and events(spans[-1][0], after) <= BATCH_EVENTS:
            spans[-1] = (spans[-1][0], after, True)
        else:
            spans.append((first, after, True))
    return [
        Batch(exchanges[first:after], groups[first:after], len(exchanges), whole, wanted)
        for first, after, whole in spans
    ]


def _parts_of_group(
    exchanges: Sequence[Exchange], first: int, after: int, events: Callable[[int, int], int]
) -> list[tuple[int, int]]:
    """Cut exchanges `first` to `after` (not included) into parts of whole runs."""
    parts: list[tuple[int, int]] = []
    for position in range(first, after):
        same_run = position > first and exchanges[position].run is exchanges[position - 1].run
        if parts and (same_run or events(parts[-1][0], position + 1) <= BATCH_EVENTS):
            parts[-1] = (parts[-1][0], position + 1)
        else:
            parts.append((position, position + 1))
    return parts


def groups_in_parts(batches: Sequence[Batch]) -> list[int]:
    """Return the groups that no batch holds whole, rising."""
    return sorted({int(group) for batch in batches if not batch.whole for group in batch.group_of_exchange})
