"""Parts of a large batch in the user's cache: where one run joins a group of millions of rows, the others are not paired anew.

Statistics of such a group all change with a new run; the rows of its other runs do not, nor what is told of each run alone. They
are kept: rows as they are encoded, in Parquet files of their own, with what rows do not say. For the statistics a column at a time
is decoded, which takes a fraction of the time and of the memory that it takes to read events, to pair them, to fit their clocks and
to encode them. Like batches (`cached_batches.py`) they are known by all that they follow from.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from dds_trace.base.errors import OutputError
from dds_trace.base.threads import in_order

from ..cache.parquet_join import RowPart
from ..model.columns import MEASURED_COLUMNS
from ..pairing.pair import OUTCOMES
from ..pairing.parquet import encode_rows, encode_stamps, tables_of
from ..pairing.roundtrips import RECEPTION_STAMPS, RoundTrips, describe
from .cached_details import UNUSABLE, pack_frames, unpack_frames

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from concurrent.futures import Executor

    import pyarrow as pa

    from ..groups.batch import Batch
    from .cached_details import KnownDetails

    _Kept = tuple[int, str | None, str | None]
    """A row of the frame `tables`."""

_COUNTS, _KNOTS, _TABLES = "counts", "clock_knots", "tables"  # frames of a part
_TABLE_SCHEMA = {"rows": pl.Int64, "seal": pl.String, "stamps_seal": pl.String}
"""Columns of the frame `tables`, a row for each table: the last one null where no stamps of the middleware are kept."""

_TABLES_AT_ONCE = 2
"""Tables that are encoded, or wait to be: the cores have them as soon as they have done what was begun before."""


@dataclass(frozen=True, slots=True, eq=False)
class KnownPart:
    """A part that is known: rows as they are in their Parquet files.

    Attributes:
        counts: one row per exchange, columns of `counts.COUNT_SCHEMA`.
        clock_knots: as in `RoundTrips`.
        rows: the rows, encoded, a file each.
        stamps: files of the columns of `roundtrips.MIDDLEWARE_STAMPS` that any event has, of the same rows; none where not both
            `RECEPTION_STAMPS` are among them.
        stamp_names: names of the columns in `stamps`.
    """

    counts: pl.DataFrame
    clock_knots: pl.DataFrame
    rows: tuple[RowPart, ...]
    stamps: tuple[Path, ...]
    stamp_names: frozenset[str]

    @classmethod
    def find(cls, key: str, known: KnownDetails, pool: Executor) -> KnownPart | None:
        """Return a part if it is known.

        Args:
            key: what it is known by.
            known: what earlier analyses have made.
            pool: checks the seals of its files.
        """
        with suppress(*UNUSABLE):
            frames = unpack_frames(known.read(key, "rows"))
            counts, clock_knots, tables = (frames.pop(name) for name in (_COUNTS, _KNOTS, _TABLES))
            rows, seals, stamps_seals = (tables[name].to_list() for name in _TABLE_SCHEMA)
            of_rows = [_key_of_table(known, key, "rows", number) for number in range(len(rows))]
            of_stamps = [_key_of_table(known, key, "stamps", number) for number in range(len(rows))]
            sealed = [*zip(of_rows, seals, strict=True), *zip(of_stamps, stamps_seals, strict=True)]
            files = [(table, seal) for table, seal in sealed if seal is not None]
            if not all(pool.map(known.holds, *zip(*files, strict=True))):
                return None
            paths = [known.path(table, "table") for table, _ in files]
            parts = [RowPart(*of, is_temporary=False) for of in zip(rows, paths[: len(rows)], strict=True)]
            stamps = paths[len(rows) :]
            names = frozenset(pl.read_parquet_schema(stamps[0])) if stamps else frozenset[str]()
            return cls(counts, clock_knots, tuple(parts), tuple(stamps), names)
        return None

    def column(self, name: str) -> pl.Series:
        """Return a column of the rows, or of the stamps, in pieces.

        Raises:
            OutputError: a file is gone.
        """
        return self._read([name])[name]

    def load(self, batch: Batch) -> RoundTrips:
        """Return all rows in memory, without `UTC_COLUMNS`; `batch` is the part.

        Raises:
            OutputError: a file is gone.
        """
        measured = self._read(["sequence", *(column.name for column in MEASURED_COLUMNS)])
        outcome = measured["outcome"].cast(pl.Enum([outcome.value for outcome in OUTCOMES]))
        published = self.counts["published"].to_numpy()
        return RoundTrips(
            measured=measured.with_columns(outcome).rechunk(),
            described=describe(batch.exchanges),
            outcome=outcome.to_physical().cast(pl.UInt8).to_numpy(),
            bounds=np.concatenate([[0], np.cumsum(published)]).astype(np.int64),
            counts=self.counts,
            stamps=tuple(self._read(sorted(self.stamp_names)).rechunk().iter_columns())
            if self.stamps
            else (),
            clock_knots=self.clock_knots,
        )

    def _read(self, names: list[str]) -> pl.DataFrame:
        is_stamp = names[0] in self.stamp_names
        files = list(self.stamps) if is_stamp else [part.content for part in self.rows]
        try:
            return pl.read_parquet(files, columns=names)
        except (OSError, pl.exceptions.PolarsError) as err:
            raise OutputError(f"{files[0]} was removed while it was needed; analyze again") from err


def keep_rows(
    key: str | None, known: KnownDetails, roundtrips: RoundTrips, pool: Executor
) -> Iterator[RowPart]:
    """Yield the rows of a part, encoded, and keep them; the part is known once all of them are.

    Args:
        key: what it is known by; None keeps nothing.
        known: takes what is kept.
        roundtrips: its rows.
        pool: encodes and keeps them, beside the caller while it waits.
    """
    # What one side alone has received judges nothing (`breakdown.py`).
    stamps = roundtrips.stamps if roundtrips.stamp_names >= RECEPTION_STAMPS else ()

    def jobs() -> Iterator[tuple[int, Callable[[], tuple[RowPart, _Kept | None]]]]:
        first = 0
        for number, table in enumerate(tables_of(roundtrips)):
            of_rows = [column[first : first + len(table)] for column in stamps]
            first += len(table)
            yield len(table), partial(_keep_table, key, known, number, table, of_rows)

    kept = []
    for rows, of_table in in_order(jobs(), pool, _TABLES_AT_ONCE, _TABLES_AT_ONCE * len(roundtrips.outcome)):
        kept.append(of_table)
        yield rows
    if key is not None and kept and None not in kept:
        table_frame = pl.DataFrame(kept, _TABLE_SCHEMA, orient="row")
        frames = {_COUNTS: roundtrips.counts, _KNOTS: roundtrips.clock_knots, _TABLES: table_frame}
        known.write(key, "rows", pack_frames(frames))


def _keep_table(
    key: str | None, known: KnownDetails, number: int, table: pa.Table, stamps: Sequence[pl.Series]
) -> tuple[RowPart, _Kept | None]:
    """Return a table of a part, encoded, and its row of the frame `tables`; None if it is not kept."""
    rows = encode_rows([table])
    assert not isinstance(rows.content, Path)
    if key is None:
        return rows, None
    seal = known.store(_key_of_table(known, key, "rows", number), memoryview(rows.content))
    of_stamps = None
    if stamps:
        encoded = encode_stamps(stamps)
        of_stamps = known.store(_key_of_table(known, key, "stamps", number), memoryview(encoded))
    is_kept = seal is not None and (of_stamps is not None or not stamps)
    return rows, (len(table), seal, of_stamps) if is_kept else None


def _key_of_table(known: KnownDetails, key: str, of: str, number: int) -> str:
    return known.key_of_text("table", f"{key} {of} {number}")
