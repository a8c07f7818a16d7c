"""Batches that are known whole: their rows, too, are in the user's cache, so that nothing of them is read or paired anew.

Rows follow from the same as details (`cached_details.py`), what is drawn also from the campaign's number of exchanges. They are
kept as a worker process encodes them, a part of the file of all rows.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from ..cache.parquet_join import RowPart
from ..groups.frames import CAMPAIGN_MAKERS
from ..groups.summary import Statistics
from ..groups.timeline import points_of_exchange
from .batches import BatchResult, WorkedBatch, work_at
from .cached_details import UNUSABLE, pack_frames, shifted, unpack_frames

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..cache.event_index import EventKey, EventPart
    from ..groups.batch import Batch
    from .cached_details import KnownDetails

_ROWS, _NUMBER, _COUNTS = "rows", "number", "counts"
_NAMES = frozenset({_ROWS, _NUMBER, _COUNTS, *CAMPAIGN_MAKERS})


def encoded_batch(
    batch: Batch,
    parts: Mapping[EventKey, Sequence[EventPart]],
    known: KnownDetails | None,
    folder: Path | None,
) -> WorkedBatch:
    """Return what becomes of a batch, its rows encoded: known, or worked at and known from then on.

    Args:
        batch: the batch.
        parts: for each of its `event_keys` the rows of the event index.
        known: what earlier analyses have made.
        folder: takes rows that the cache does not; None leaves new ones in memory.

    Raises:
        OutputError: the rows could not be kept.
    """
    if known is None or not (batch.whole and batch.options.rows and batch.options.details):
        return work_at(batch, parts, known).encoded(folder)
    of_details = known.key_of(batch, parts)
    key = known.key_of_text("rows", f"{of_details} {points_of_exchange(batch.all_exchanges)}")
    found = _find(batch, known, key, of_details)
    if found is not None:
        return found
    worked = work_at(batch, parts, known).encoded()
    kept = _keep(batch, worked, known, key)
    if folder is None:
        return worked
    return worked._replace(rows=kept) if kept is not None else worked.encoded(folder)


def _find(batch: Batch, known: KnownDetails, key: str, of_details: str) -> WorkedBatch | None:
    """Return a batch that is known whole, its rows where they are in the cache."""
    with suppress(*UNUSABLE):
        files = known.read(key, "rows")
        if files.keys() != _NAMES:
            raise ValueError("other files than are kept")
        number, size = int(files.pop(_NUMBER)), len(files.pop(_ROWS))
        frames = unpack_frames(files)
        counts = frames.pop(_COUNTS)
        of_batch = known.find(of_details, batch.first_group)
        if of_batch is None:
            return None
        rows = RowPart.at_end_of(known.path(key, "rows"), size, number)
        statistics = Statistics(of_batch.pop("statistics"), of_batch.pop("distributions"))
        of_campaign = shifted(frames, batch.first_group)
        return WorkedBatch(rows, BatchResult(of_campaign | of_batch, counts, statistics, {}, None))
    return None


def _keep(batch: Batch, worked: WorkedBatch, known: KnownDetails, key: str) -> RowPart | None:
    """Keep the rows of a batch, unless events in them are also in another trace, which depends on the order of the traces.

    Returns:
        The rows, where they are in the cache; None if they are not.
    """
    result, rows = worked.result(), worked.rows
    if result.copies or not isinstance(rows, RowPart) or isinstance(rows.content, Path):
        return None
    drawn = {name: result.frames[name] for name in CAMPAIGN_MAKERS}
    files = pack_frames(shifted(drawn, -batch.first_group) | {_COUNTS: result.counts})
    encoded = memoryview(rows.content)
    path = known.write(key, "rows", {**files, _NUMBER: b"%d" % rows.num_rows, _ROWS: encoded})
    return RowPart.at_end_of(path, len(encoded), rows.num_rows) if path is not None else None
