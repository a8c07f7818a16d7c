"""Paired rows outside of memory: cached, in a temporary file, or on their way from another machine.

Three Arrow streams: `counts`, `clock_knots`, and the rows without their metrics, a batch for each of `PairedRows.frames`. Not
compressed: packing and reading would take three times as long for a quarter of the bytes.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any

import polars as pl
import pyarrow as pa

from dds_trace.base.errors import OutputError

from ..model.metrics import METRICS, with_metrics
from ..pairing.exchanges import Exchange
from ..pairing.roundtrips import STAMP_NAMES, PairedRows, RoundTrips, bounds_of, describe, outcome_names

_FORMULAS = {metric.column.name: metric.formula.alias(metric.column.name) for metric in METRICS.values()}


def pack_rows(rows: RoundTrips, sink: pa.NativeFile) -> int:
    """Write rows as `PackedRows` reads them; return the offset of the stream of rows."""
    _write_frames(sink, iter([rows.counts]))
    _write_frames(sink, iter([rows.clock_knots]))
    offset: int = sink.tell()
    _write_frames(sink, _frames_with_stamps(rows))
    return offset


def _frames_with_stamps(rows: RoundTrips) -> Iterator[pl.DataFrame]:
    first = 0
    for frame in rows.frames():
        yield frame.drop(*_FORMULAS).hstack([stamps.slice(first, len(frame)) for stamps in rows.stamps])
        first += len(frame)


def _write_frames(sink: pa.NativeFile, frames: Iterator[pl.DataFrame]) -> None:
    first = next(frames).to_arrow()
    with pa.ipc.new_stream(sink, first.schema) as writer:
        for table in chain([first], (frame.to_arrow() for frame in frames)):
            columns = [column.combine_chunks() for column in table.columns]
            writer.write_batch(pa.RecordBatch.from_arrays(columns, schema=table.schema))


def packed(rows: RoundTrips | PackedRows, folder: Path | None) -> PackedRows:
    """Return rows in a temporary file of a folder, or in memory.

    Raises:
        OutputError: they cannot be written.
    """
    if isinstance(rows, PackedRows):
        return rows
    if folder is None:
        buffer = pa.BufferOutputStream()
        offset = pack_rows(rows, buffer)
        return PackedRows.like(rows, buffer.getvalue(), offset)
    path = folder / f"{secrets.token_hex(8)}.rows"
    try:
        with pa.OSFile(str(path), "wb") as file:
            offset = pack_rows(rows, file)
    except OSError as err:
        raise OutputError(
            f"rows cannot be written to {folder} ({err.strerror or err}); give a larger folder with TMPDIR"
        ) from err
    return replace(PackedRows.like(rows, path, offset), is_temporary=True)


@dataclass(frozen=True, eq=False)
class PackedRows(PairedRows):
    """Rows that are read on demand, column by column or batch by batch.

    Attributes:
        is_temporary: whether the file is for these rows only.
    """

    source: Path | pa.Buffer
    offset: int
    is_temporary: bool = False

    @classmethod
    def of(cls, content: memoryview, exchanges: Sequence[Exchange], source: Path, offset: int = 0) -> PackedRows:
        """Describe what `pack_rows` wrote, at this offset of the file `source`.

        Raises:
            ArrowInvalid, LookupError: the content is something else.
        """
        reader = pa.BufferReader(content)
        counts, clock_knots = (pl.DataFrame(pa.ipc.open_stream(reader).read_all()) for _ in range(2))
        bounds = bounds_of(counts)
        return cls(describe(exchanges), bounds, counts, clock_knots, source, offset + reader.tell())

    @classmethod
    def like(cls, rows: PairedRows, source: Path | pa.Buffer, offset: int) -> PackedRows:
        return cls(rows.described, rows.bounds, rows.counts, rows.clock_knots, source, offset)

    @cached_property
    def stamp_names(self) -> frozenset[str]:
        with self._opened() as stream:
            return frozenset(STAMP_NAMES).intersection(pa.ipc.open_stream(stream).schema.names)

    def column(self, name: str) -> pl.Series:
        value = _FORMULAS.get(name, pl.col(name))
        batches = self._batches(*value.meta.root_names())
        column: pl.Series = pl.concat([batch.select(value).to_series() for batch in batches]).rechunk()
        return column

    def frames(self) -> Iterator[pl.DataFrame]:
        for batch in self._batches():
            yield with_metrics(batch.drop(self.stamp_names))

    def load(self) -> RoundTrips:
        rows = pl.concat(self._batches()).rechunk()
        outcome = rows["outcome"].to_numpy()
        return RoundTrips(
            described=self.described,
            bounds=self.bounds,
            counts=self.counts,
            clock_knots=self.clock_knots,
            measured=with_metrics(rows.drop(self.stamp_names).with_columns(outcome_names(outcome))),
            outcome=outcome,
            stamps=tuple(rows[name] for name in STAMP_NAMES if name in self.stamp_names),
        )

    def remove(self) -> None:
        if isinstance(self.source, Path) and self.is_temporary:
            self.source.unlink()

    def _batches(self, *names: str) -> Iterator[pl.DataFrame]:
        with self._opened() as stream:
            reader = pa.ipc.open_stream(stream)
            if names:
                fields = [reader.schema.get_field_index(name) for name in names]
                stream.seek(self.offset)
                reader = pa.ipc.open_stream(stream, options=pa.ipc.IpcReadOptions(included_fields=fields))
            yield from map(pl.DataFrame, reader)

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        if isinstance(self.source, Path):
            try:
                stream = pa.memory_map(str(self.source))
            except FileNotFoundError as err:
                raise OutputError(f"{self.source} was removed while it was needed; analyze again") from err
        else:
            stream = pa.BufferReader(self.source)
        with stream:
            stream.seek(self.offset)
            yield stream
