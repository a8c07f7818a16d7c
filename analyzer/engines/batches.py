"""A campaign cut into batches that fit into memory, and what one batch comes to, on whatever machine it is worked at."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ..groups.batch import Batch, Wanted
from ..groups.frames import frames_of
from ..groups.summary import count_exchanges, measure_batch, metric_values
from ..loading.events import merge_parts
from ..model.metrics import METRICS
from ..pairing.parquet import table_of
from ..pairing.roundtrips import pair_exchanges

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import polars as pl
    import pyarrow as pa
    from numpy.typing import NDArray

    from ..groups.frames import Frames
    from ..groups.summary import Statistics
    from ..loading.events import Copies, Part, StageKey
    from ..pairing.exchanges import Exchange
    from ..pairing.roundtrips import PairedExchanges

BATCH_EVENTS = 1_000_000
"""Events of a batch, unless one group alone has more: a hundred megabytes while it is worked at. Of a campaign of few
batches one is written while the next is paired; smaller ones cost more in polars' fixed times than they gain."""

WHOLE_GROUP_EVENTS = 8_000_000
"""A group with more events is worked at in parts of whole runs."""


@dataclass(frozen=True, slots=True)
class BatchPlan:
    """Which exchanges are worked at together.

    Attributes:
        first: position of the first exchange.
        after: position behind the last one.
        whole: whether these are whole groups; else it is a part of one.
        events: how many events they have.
    """

    first: int
    after: int
    whole: bool
    events: int


@dataclass(frozen=True, slots=True, eq=False)
class Work:
    """All that it takes to work at one batch.

    Attributes:
        exchanges: without events.
        group_of_exchange: uint32, rising.
        all_exchanges: exchanges of the whole campaign.
        whole: whether these are whole groups.
        with_rows: whether the rows are wanted, and of a part of a group the values of its metrics.
        wanted: what is asked for beside rows and summary.
    """

    exchanges: tuple[Exchange, ...]
    group_of_exchange: NDArray[np.uint32]
    all_exchanges: int
    whole: bool
    with_rows: bool = True
    wanted: Wanted = field(default_factory=Wanted)

    def event_keys(self) -> list[StageKey]:
        """What the events of its exchanges go by, each once."""
        return list(dict.fromkeys(key for exchange in self.exchanges for key in exchange.event_keys()))


@dataclass(frozen=True, slots=True, eq=False)
class Worked:
    """What one batch comes to.

    Attributes:
        paired: its exchanges.
        frames: by name, see `analyzer/groups/frames.py`.
        of_exchange: frame of `summarize.count_exchanges`.
        statistics: of its groups; of a part of a group they are those of the part.
        copies: events that were left out because another trace holds them, by key.
        rows: how many rows there are.
        table: the rows, for `output.RoundTripsWriter`; None if they are not wanted.
        values: metric -> int64 values that are not null, of a part of a group; None of whole groups.
    """

    paired: PairedExchanges
    frames: Frames
    of_exchange: pl.DataFrame
    statistics: Statistics
    copies: Mapping[StageKey, tuple[Copies, ...]]
    rows: int
    table: pa.Table | None
    values: Mapping[str, NDArray[np.int64]] | None


def plan_batches(exchanges: Sequence[Exchange], group_of_exchange: NDArray[np.uint32]) -> list[BatchPlan]:
    """Batches of whole groups, in their order; a group too large for one comes in parts of whole runs.

    Args:
        exchanges: by group, then by run.
        group_of_exchange: uint32, rising.
    """
    plans: list[BatchPlan] = []
    edges = [0, *(np.flatnonzero(np.diff(group_of_exchange)) + 1).tolist(), len(exchanges)]
    for first, after in pairwise(edges):
        events = _events(exchanges[first:after])
        if events > WHOLE_GROUP_EVENTS and _runs(exchanges[first:after]) > 1:
            plans += _parts_of_group(exchanges, first, after)
        elif plans and plans[-1].whole and plans[-1].events + events <= BATCH_EVENTS:
            plans[-1] = BatchPlan(plans[-1].first, after, whole=True, events=plans[-1].events + events)
        else:
            plans.append(BatchPlan(first, after, whole=True, events=events))
    return plans


def _parts_of_group(exchanges: Sequence[Exchange], first: int, after: int) -> list[BatchPlan]:
    parts: list[BatchPlan] = []
    for position in range(first, after):
        events = _events(exchanges[position : position + 1])
        same_run = position > first and exchanges[position].run is exchanges[position - 1].run
        if parts and (same_run or parts[-1].events + events <= BATCH_EVENTS):
            parts[-1] = BatchPlan(
                parts[-1].first, position + 1, whole=False, events=parts[-1].events + events
            )
        else:
            parts.append(BatchPlan(position, position + 1, whole=False, events=events))
    return parts


def _events(exchanges: Sequence[Exchange]) -> int:
    return sum(sum(exchange.counts) for exchange in exchanges)


def _runs(exchanges: Sequence[Exchange]) -> int:
    return len({exchange.run.run_id for exchange in exchanges})


def work_at(work: Work, parts: Mapping[StageKey, Sequence[Part]]) -> Worked:
    """Fetch the events of a batch, pair them, and compute all that depends on nothing else.

    Args:
        work: the batch.
        parts: for each of the keys of its exchanges the traces that hold events of it.
    """
    merged = {key: merge_parts(parts.get(key, ())) for key in work.event_keys()}
    events = {key: columns for key, (columns, _) in merged.items()}
    roundtrips = pair_exchanges(
        [exchange.with_events(events) for exchange in work.exchanges], one_way=work.wanted.details
    )
    batch = Batch(roundtrips, work.group_of_exchange, work.all_exchanges, work.whole, work.wanted)
    values = None
    if work.with_rows and not work.whole:
        values = {metric: metric_values(roundtrips, metric, 0, len(work.exchanges)) for metric in METRICS}
    return Worked(
        paired=roundtrips.counted(),
        frames=frames_of(batch),
        of_exchange=count_exchanges(roundtrips),
        statistics=measure_batch(roundtrips, work.group_of_exchange),
        copies={key: copies for key, (_, copies) in merged.items() if copies},
        rows=roundtrips.measured.height,
        table=table_of(roundtrips) if work.with_rows else None,
        values=values,
    )
