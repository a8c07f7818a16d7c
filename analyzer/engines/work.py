"""Work at one batch, here or on a worker of a cluster: fetch its events, pair them, and compute all that rests on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..groups.frames import frames_of
from ..groups.measure import measure_batch, metric_values
from ..loading.events import merge_parts
from ..model.metrics import METRICS
from ..pairing.parquet import table_of
from ..pairing.roundtrips import pair_exchanges

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    import polars as pl
    import pyarrow as pa
    from numpy.typing import NDArray

    from ..groups.batch import Batch
    from ..groups.frames import Frames
    from ..groups.measure import Statistics
    from ..loading.events import Copies, EventKey, EventPart


@dataclass(frozen=True, slots=True, eq=False)
class BatchResult:
    """What a batch gives.

    Attributes:
        frames: by name, see `groups/frames.py`.
        counts: one row per exchange, columns of `counts.COUNT_SCHEMA`.
        statistics: of its groups; of a part of a group they are those of the part.
        copies: events that were left out because another trace holds them, by key.
        rows: number of rows.
        table: the rows, for `RowStore`; None if they are not wanted.
        values: metric -> int64 values that are not null, of a part of a group; None of whole groups.
    """

    frames: Frames
    counts: pl.DataFrame
    statistics: Statistics
    copies: Mapping[EventKey, tuple[Copies, ...]]
    rows: int
    table: pa.Table | None
    values: Mapping[str, NDArray[np.int64]] | None


def work_at(batch: Batch, parts: Mapping[EventKey, Sequence[EventPart]]) -> BatchResult:
    """Pair and measure a batch.

    Args:
        batch: the batch.
        parts: for each of its `event_keys` the rows of the event index, traces in rising order.
    """
    merged = {key: merge_parts(parts.get(key, ())) for key in batch.event_keys()}
    events = {key: columns for key, (columns, _) in merged.items()}
    roundtrips = pair_exchanges(batch.exchanges, events, details=batch.wanted.details)
    values = None
    if batch.wanted.rows and not batch.whole:
        exchanges = len(batch.exchanges)
        values = {metric: metric_values(roundtrips, metric, 0, exchanges) for metric in METRICS}
    return BatchResult(
        frames=frames_of(batch, roundtrips),
        counts=roundtrips.counts,
        statistics=measure_batch(roundtrips, batch.group_of_exchange),
        copies={key: copies for key, (_, copies) in merged.items() if copies},
        rows=roundtrips.measured.height,
        table=table_of(roundtrips) if batch.wanted.rows else None,
        values=values,
    )
