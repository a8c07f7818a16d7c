"""Split a campaign into batches that fit in memory."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ..groups.batch import WHOLE_GROUP_EVENTS, AnalysisOptions, Batch, Grouping
from ..pairing.exchanges import Exchange

BATCH_EVENTS = 1_000_000
"""Events of a batch, unless one group has more: a hundred megabytes. Smaller ones lose to polars' fixed times.
"""

BATCH_GROUPS = 250
"""Most groups of a batch: each costs a millisecond, and thousands would be the work of one core."""

REUSED_BLOCK_BYTES = 31 << 20
"""Largest freed block of memory that is reused; glibc allows 32 MB."""


def keep_freed_memory() -> None:
    """Let this process reuse the memory of small batches where its C library is glibc.

    Freed blocks above a threshold go back to the kernel, which clears every page of the next one. Glibc raises the
    threshold to the largest block ever freed (mallopt(3), M_MMAP_THRESHOLD).
    """
    np.empty(REUSED_BLOCK_BYTES, np.uint8)


def plan_batches(grouping: Grouping, options: AnalysisOptions) -> list[Batch]:
    """Return batches of whole groups, in their order; a group too large for one comes in parts of whole runs."""
    exchanges, groups = grouping.exchanges, grouping.group_of_exchange
    if not exchanges:  # only taps recorded: frames without rows have their columns
        return [Batch((), groups, 0, whole=True, options=options)]
    events_before = np.cumsum([0, *(sum(exchange.counts) for exchange in exchanges)]).tolist()
    spans: list[tuple[int, int, bool]] = []  # first exchange, exchange after the last, whether of whole groups
    groups_in_batch = 0
    offsets = [0, *(np.flatnonzero(np.diff(groups)) + 1).tolist(), len(exchanges)]
    for first, after in pairwise(offsets):
        runs = {exchange.run.run_id for exchange in exchanges[first:after]}
        if events_before[after] - events_before[first] > WHOLE_GROUP_EVENTS and len(runs) > 1:
            parts = _parts_of_group(exchanges[first:after])
            spans += ((first + start, first + stop, False) for start, stop in parts)
            continue
        start, _, is_whole = spans[-1] if spans else (0, 0, False)
        if is_whole and events_before[after] - events_before[start] <= BATCH_EVENTS and groups_in_batch < BATCH_GROUPS:
            spans[-1] = (start, after, True)
            groups_in_batch += 1
        else:
            spans.append((first, after, True))
            groups_in_batch = 1
    return [
        Batch(exchanges[first:after], groups[first:after], len(exchanges), whole, options)
        for first, after, whole in spans
    ]


def _parts_of_group(exchanges: Sequence[Exchange]) -> list[tuple[int, int]]:
    count = len(exchanges)
    starts = [i for i in range(1, count) if exchanges[i].run is not exchanges[i - 1].run]
    parts: list[tuple[int, int]] = []
    events_of_part = 0
    for start, stop in pairwise([0, *starts, count]):
        events = sum(sum(exchange.counts) for exchange in exchanges[start:stop])
        if parts and events_of_part + events <= BATCH_EVENTS:
            parts[-1] = (parts[-1][0], stop)
            events_of_part += events
        else:
            parts.append((start, stop))
            events_of_part = events
    return parts


def is_large(batch: Batch) -> bool:
    """Return whether a batch exceeds `BATCH_EVENTS`: it is one group, or one run."""
    return batch.events > BATCH_EVENTS


def groups_in_parts(batches: Sequence[Batch]) -> list[int]:
    return sorted({int(group) for batch in batches if not batch.whole for group in batch.group_of_exchange})
