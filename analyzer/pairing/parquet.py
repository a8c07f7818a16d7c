"""The Parquet files: exact column types, units in the field metadata, whole or not there at all."""

from __future__ import annotations

import base64
from contextlib import ExitStack, contextmanager, nullcontext
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq

from dds_trace.base.errors import OutputError
from dds_trace.base.files import replacing

from ..cache.parquet_join import JoinedParts, RowPart, new_part, telling_of_room
from ..model.columns import ROUNDTRIP_COLUMNS, SUMMARY_COLUMNS
from .pair import OUTCOMES

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from ..model.metrics import Column
    from .roundtrips import RoundTrips

_ROWS_PER_GROUP = 1 << 20
_ROWS_PER_PAGE = 1 << 15
"""Each page begins a compressor, and is looked at in one step; who reads a group of rows unpacks the pages that it is in."""

_ARROW_TYPES = {
    pl.UInt16: pa.uint16(),
    pl.UInt32: pa.uint32(),
    pl.UInt64: pa.uint64(),
    pl.Int32: pa.int32(),
    pl.Int64: pa.int64(),
    pl.Float64: pa.float64(),
    pl.Boolean: pa.bool_(),
    pl.String: pa.string(),
    pl.Datetime("ns", "UTC"): pa.timestamp("ns", tz="UTC"),
}


@contextmanager
def roundtrips_writer(
    path: Path, provenance: Mapping[str, str] | None = None
) -> Iterator[Callable[[pa.Table | RowPart], None]]:
    """Write `roundtrips.parquet` batch by batch; the file takes its place once it is complete.

    A reader sees the old file or the new one, never half of it. Every field's metadata holds `meaning` and,
    where it has one, `unit`.

    Args:
        path: the file; its folder is made.
        provenance: metadata of the file.

    Yields:
        A function that writes a table of `tables_of`, or the part that `encode_rows` made of some; the part's file is removed.

    Raises:
        OutputError: the folder or the file cannot be written.
    """
    with ExitStack() as stack:
        with _telling(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            stream = stack.enter_context(stack.enter_context(replacing(path)).open("wb"))
            joined = JoinedParts(stream)
            joined.add(encode_rows([]))

        def write(rows: pa.Table | RowPart) -> None:
            with _telling(path):
                part = rows if isinstance(rows, RowPart) else encode_rows([rows])
                joined.add(part)
            part.remove()

        yield write
        # A dictionary is how a text is stored; readers are told that it is a text, and its unit and meaning.
        serialized = base64.b64encode(ROUNDTRIPS_SCHEMA.serialize().to_pybytes()).decode()
        with _telling(path):
            joined.finish({"ARROW:schema": serialized, **(provenance or {})})
            stack.close()


def encode_rows(tables: Iterable[pa.Table], folder: Path | None = None) -> RowPart:
    """Encode tables of `tables_of` as a part of `roundtrips.parquet`.

    Times rise by steps or stay within a range, which delta encoding keeps in a quarter of the bytes and of the time that plain
    values under zstd take.

    Args:
        tables: the rows.
        folder: takes the part as a file; None keeps it in memory.

    Raises:
        OutputError: it cannot be written.
    """
    file = new_part(folder) if folder else None
    deltas = [c.name for c in ROUNDTRIP_COLUMNS if c.unit in ("ns", "UTC") or c.name == "sequence"]
    rows = 0
    with (
        telling_of_room() if file else nullcontext(),
        pa.OSFile(str(file), "wb") if file else pa.BufferOutputStream() as stream,
    ):
        with pq.ParquetWriter(
            stream,
            _AS_WRITTEN,
            compression="zstd",
            compression_level=1,
            use_dictionary=[name for name in _AS_WRITTEN.names if name not in deltas],
            column_encoding=dict.fromkeys(deltas, "DELTA_BINARY_PACKED"),
            store_schema=False,
            write_batch_size=_ROWS_PER_PAGE,
            max_rows_per_page=_ROWS_PER_PAGE,
        ) as writer:
            for table in tables:
                rows += len(table)
                writer.write_table(table, row_group_size=_ROWS_PER_GROUP)
        return RowPart(rows, file or stream.getvalue())


def encode_stamps(stamps: Sequence[pl.Series]) -> pa.Buffer:
    """Encode columns of times that stand beside rows, ns, as a Parquet file."""
    table = pl.DataFrame(stamps).to_arrow()
    stream = pa.BufferOutputStream()
    deltas = dict.fromkeys(table.column_names, "DELTA_BINARY_PACKED")
    options = {
        "compression": "zstd",
        "compression_level": 1,
        "use_dictionary": False,
        "column_encoding": deltas,
    }
    pq.write_table(table, stream, store_schema=False, **options)
    return stream.getvalue()


def tables_of(roundtrips: RoundTrips) -> Iterator[pa.Table]:
    """Yield the rows as they are written, as many at a time as a row group has.

    Texts, which are known by exchange, are dictionaries; those that are the same throughout share one array of positions in
    their dictionary. Other columns that are known by exchange are repeated for the rows of a table alone.
    """
    described, bounds = roundtrips.described, roundtrips.bounds
    texts = {
        column.name: column.to_arrow().cast(pa.string()).dictionary_encode()
        for column in described.iter_columns()
        if column.dtype == pl.String
    }
    others = [column for column in described.iter_columns() if column.name not in texts]
    outcomes = pl.Series([outcome.value for outcome in OUTCOMES]).to_arrow().cast(pa.string())
    numbers = roundtrips.measured.drop("outcome")
    for first in range(0, int(bounds[-1]), _ROWS_PER_GROUP):
        rows = slice(first, first + _ROWS_PER_GROUP)
        of_exchange = np.diff(bounds.clip(rows.start, rows.stop))  # how many of these rows each exchange has
        outcome = _array(roundtrips.outcome[rows].astype(np.int32))
        zeros = _array(np.zeros(len(outcome), np.int32))
        columns = {
            **{column.name: column.to_arrow() for column in numbers[rows].iter_columns()},
            **{column.name: _repeated(column, of_exchange) for column in others},
            "outcome": pa.DictionaryArray.from_arrays(outcome, outcomes),
        }
        for name, text in texts.items():
            is_same = len(text.dictionary) == 1 and not text.null_count
            positions = zeros if is_same else _repeated(pl.Series(text.indices), of_exchange)
            columns[name] = pa.DictionaryArray.from_arrays(positions, text.dictionary)
        yield pa.Table.from_arrays([columns[name] for name in _AS_WRITTEN.names], schema=_AS_WRITTEN)


def _repeated(values: pl.Series, of_exchange: NDArray[np.int64]) -> pa.Array:
    """Return the value of each row, from that of each exchange and its number of rows."""
    if values.null_count() == len(values):
        return pa.nulls(int(of_exchange.sum()), values.to_arrow().type)
    if values.null_count():
        return values.gather(np.repeat(np.arange(len(values), dtype=np.uint32), of_exchange)).to_arrow()
    return _array(np.repeat(values.to_numpy(), of_exchange))


def _array(values: NDArray[np.generic]) -> pa.Array:
    """Return values as an Arrow array; `pa.array` would load pandas where it is installed, to look whether they are its own."""
    return pl.Series(values).to_arrow()


def write_summary(summary: pl.DataFrame, path: Path, provenance: Mapping[str, str]) -> None:
    """Write `summary.parquet` with this metadata, as `roundtrips_writer` writes.

    Raises:
        OutputError: the folder or the file cannot be written.
    """
    with _telling(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as draft:
            pq.write_table(summary_table(summary, provenance), draft, compression="zstd")


def summary_table(summary: pl.DataFrame, provenance: Mapping[str, str] | None = None) -> pa.Table:
    """Return `summary` with the exact types of its columns, meaning and unit in each field's metadata.

    Args:
        summary: frame of `Analysis.summary`.
        provenance: metadata of the table.
    """
    return summary.to_arrow().cast(_schema(SUMMARY_COLUMNS).with_metadata(dict(provenance or {})))


def _schema(columns: tuple[Column, ...]) -> pa.Schema:
    return pa.schema(
        pa.field(
            column.name,
            _ARROW_TYPES[column.dtype],
            metadata={"meaning": column.meaning} | ({"unit": column.unit} if column.unit else {}),
        )
        for column in columns
    )


ROUNDTRIPS_SCHEMA = _schema(ROUNDTRIP_COLUMNS)
_AS_WRITTEN = pa.schema(
    pa.field(f.name, pa.dictionary(pa.int32(), pa.string()) if pa.types.is_string(f.type) else f.type)
    for f in ROUNDTRIPS_SCHEMA
)


@contextmanager
def _telling(path: Path) -> Iterator[None]:
    """Turn an error of the system into one that says which file, and what to do."""
    try:
        yield
    except OSError as err:
        raise OutputError(
            f"{path} cannot be written ({err.strerror or err}); give another folder with --out"
        ) from err
