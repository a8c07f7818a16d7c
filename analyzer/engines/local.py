"""Engines do the work of an analysis: here the cores of this machine, in `engines/cluster.py` those of a cluster."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, Protocol

from dds_trace.tracefile.threads import in_order

from ..loading.cache import TraceCache
from ..loading.campaign import load_campaign
from ..loading.shelf import TraceShelf
from .batches import BATCH_EVENTS, work_at
from .known_details import KnownDetails

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence
    from pathlib import Path

    from ..groups.batch import Batch
    from ..loading.campaign import Campaign, Progress
    from ..loading.events import EventIndex
    from ..loading.place import Place
    from .batches import BatchResult

_MOST_WORKERS = 2  # each holds a batch; the writing of rows takes another core


class Engine(Protocol):
    """Loads traces, then works at batches; it is closed at the end."""

    def load(self, place: Place, skip: Collection[Path], progress: Progress | None) -> Campaign:
        """Load every trace of a place; see `load_campaign`."""

    def work(self, batches: Sequence[Batch], index: EventIndex) -> Iterator[BatchResult]:
        """Yield the results of the batches in their order."""

    def close(self) -> None:
        """Release memory, files and connections."""


class LocalEngine:
    """This machine as an `Engine`.

    Args:
        cache: whether the user's cache keeps events and details for the next analysis.
    """

    def __init__(self, *, cache: bool) -> None:
        self._cache = TraceCache.open() if cache else None
        self._shelf = TraceShelf(self._cache)

    def load(self, place: Place, skip: Collection[Path], progress: Progress | None) -> Campaign:
        """Read every trace that is not in the cache."""
        return load_campaign(place, skip=skip, progress=progress, shelf=self._shelf)

    def work(self, batches: Sequence[Batch], index: EventIndex) -> Iterator[BatchResult]:
        """Yield the results of the batches, worked at on all cores; one batch waits in memory for its turn.

        Of a large one, whose arrays are long, what follows its pairing is made side by side: short ones wait for Python's lock.
        """
        workers = min(_MOST_WORKERS, len(os.sched_getaffinity(0)))
        known = KnownDetails(self._cache, self._shelf.keys) if self._cache else None
        with (
            ThreadPoolExecutor(workers, thread_name_prefix="analyze") as pool,
            ThreadPoolExecutor(workers, thread_name_prefix="measure") as measuring,
        ):
            jobs = (
                (
                    1,
                    partial(
                        work_at,
                        batch,
                        {key: index[key] for key in batch.event_keys() if key in index},
                        known,
                        measuring if _is_large(batch) else None,
                    ),
                )
                for batch in batches
            )
            yield from in_order(jobs, pool, workers + 1, workers + 1, helping=False)

    def close(self) -> None:
        """Remove temporary files."""
        self._shelf.close()


def _is_large(batch: Batch) -> bool:
    """Return whether one group, or one run of a group, has more events than a batch is to have."""
    return sum(sum(exchange.counts) for exchange in batch.exchanges) > BATCH_EVENTS
