"""The Parquet files: exact column types, units in the field metadata, whole or not there at all."""

from __future__ import annotations

import base64
import os
from contextlib import contextmanager
from typing import TYPE_CHECKING

import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq

from analyzer.columns import ROUNDTRIP_COLUMNS, SUMMARY_COLUMNS, Column
from analyzer.pair import OUTCOMES
from tracefile import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from analyzer.roundtrips import RoundTrips

_ROWS_PER_GROUP = 1 << 20

_ARROW_TYPES = {
    pl.UInt16: pa.uint16(),
    pl.UInt32: pa.uint32(),
    pl.UInt64: pa.uint64(),
    pl.Int32: pa.int32(),
    pl.Int64: pa.int64(),
    pl.Float64: pa.float64(),
    pl.Boolean: pa.bool_(),
    pl.String: pa.string(),
}


def write_frames(roundtrips: RoundTrips, summary: pl.DataFrame, folder: Path) -> dict[str, Path]:
    """Write `roundtrips.parquet` and `summary.parquet` into `folder`, replacing those of an earlier analysis.

    A reader sees the old file or the new one, never half of it. Every field's metadata holds `meaning` and,
    where it has one, `unit`.

    Returns:
        Kind (`roundtrips`, `summary`) -> file.

    Raises:
        OutputError: the folder or a file cannot be written.
    """
    written = {kind: folder / f"{kind}.parquet" for kind in ("roundtrips", "summary")}
    with _replacing(written["roundtrips"]) as unfinished:
        _write_roundtrips(roundtrips, unfinished)
    with _replacing(written["summary"]) as unfinished:
        pq.write_table(summary.to_arrow().cast(_schema(SUMMARY_COLUMNS)), unfinished, compression="zstd")
    return written


def _write_roundtrips(roundtrips: RoundTrips, path: Path) -> None:
    """Write the frame a million rows at a time.

    Texts are known by exchange and go into Parquet's dictionaries as they are, so no row's text is looked at.
    Times rise by steps or stay within a range, which delta encoding keeps in a quarter of the bytes and of the
    time that plain values under zstd take.
    """
    schema = _schema(ROUNDTRIP_COLUMNS)
    texts = {
        name: roundtrips.described[name].to_arrow().cast(pa.string()).dictionary_encode()
        for name in roundtrips.described.columns
        if roundtrips.described[name].dtype == pl.String
    }
    outcomes = pa.array([outcome.value for outcome in OUTCOMES])
    exchange_of_row = roundtrips.exchange_of_row()

    def column(name: str, start: int, stop: int) -> pa.Array:
        if name in texts:
            return texts[name].take(pa.array(exchange_of_row[start:stop]))
        if name == "outcome":
            return pa.DictionaryArray.from_arrays(
                pa.array(roundtrips.outcome[start:stop]).cast(pa.int32()), outcomes
            )
        return roundtrips.frame[name][start:stop].to_arrow()

    deltas = [c.name for c in ROUNDTRIP_COLUMNS if c.unit == "ns" or c.name == "sequence"]
    as_written = pa.schema(
        pa.field(f.name, pa.dictionary(pa.int32(), pa.string()) if pa.types.is_string(f.type) else f.type)
        for f in schema
    )
    with pq.ParquetWriter(
        path,
        as_written,
        compression="zstd",
        compression_level=1,
        use_dictionary=[name for name in schema.names if name not in deltas],
        column_encoding=dict.fromkeys(deltas, "DELTA_BINARY_PACKED"),
        store_schema=False,
    ) as writer:
        for start in range(0, roundtrips.frame.height, _ROWS_PER_GROUP):
            stop = min(start + _ROWS_PER_GROUP, roundtrips.frame.height)
            arrays = [column(name, start, stop) for name in schema.names]
            writer.write_table(pa.Table.from_arrays(arrays, schema=as_written))
        # A dictionary is how a text is stored; readers are told that it is a text, and its unit and meaning.
        serialized = base64.b64encode(schema.serialize().to_pybytes()).decode()
        writer.add_key_value_metadata({"ARROW:schema": serialized})


def _schema(columns: tuple[Column, ...]) -> pa.Schema:
    return pa.schema(
        pa.field(
            column.name,
            _ARROW_TYPES[column.dtype],
            metadata={"meaning": column.meaning} | ({"unit": column.unit} if column.unit else {}),
        )
        for column in columns
    )


@contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """A file beside `path` that takes its place once it is complete."""
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield unfinished
            unfinished.replace(path)
        finally:
            unfinished.unlink(missing_ok=True)
    except OSError as err:
        raise OutputError(
            f"{path} cannot be written ({err.strerror or err}); give another folder with --out"
        ) from err
