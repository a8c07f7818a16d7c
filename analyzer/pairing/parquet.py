"""The Parquet files: exact column types, units in the field metadata, complete or absent."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from dds_trace.base.files import output_errors, real_path, replacing
from dds_trace.base.version import __version__
from dds_trace.tracefile.format.json_fields import FORMAT_VERSION

from ..loading.campaign import Campaign
from ..model.columns import PARQUET_ENCODINGS, ROUNDTRIP_COLUMNS, SUMMARY_COLUMNS
from ..model.metrics import Column
from .exchanges import Exchanges
from .pair import OUTCOMES
from .roundtrips import RoundTrips
from .utc import is_synchronized, utc_text

_ROWS_PER_PAGE = 1 << 15

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
def roundtrips_writer(path: Path, provenance: Mapping[str, str] | None = None) -> Iterator[Callable[[pa.Table], None]]:
    """Write `roundtrips.parquet`, complete or not at all; yield a function that writes a table of `tables_of`."""
    # Texts are written as dictionaries; readers get the schema with texts, units and meanings.
    schema = base64.b64encode(ROUNDTRIPS_SCHEMA.serialize().to_pybytes()).decode()
    with ExitStack() as stack:
        with output_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            draft = stack.enter_context(replacing(path))
            stream = stack.enter_context(pa.OSFile(str(draft), "wb"))
            writer = pq.ParquetWriter(
                stream,
                _WRITTEN_SCHEMA,
                compression="zstd",
                compression_level=1,
                use_dictionary=[name for name in _WRITTEN_SCHEMA.names if name not in PARQUET_ENCODINGS],
                column_encoding=PARQUET_ENCODINGS,
                store_schema=False,
                write_batch_size=_ROWS_PER_PAGE,
                max_rows_per_page=_ROWS_PER_PAGE,
            )
            stack.callback(_abandon, writer)
            writer.add_key_value_metadata({"ARROW:schema": schema, **(provenance or {})})

        def write(table: pa.Table) -> None:
            with output_errors(path):
                writer.write_table(table, row_group_size=max(len(table), 1))

        yield write
        with output_errors(path):
            writer.close()
            stack.close()


def _abandon(writer: pq.ParquetWriter) -> None:
    with suppress(OSError):
        writer.close()
    writer.is_open = False  # else its finalizer tries again


def tables_of(rows: RoundTrips) -> Iterator[pa.Table]:
    """Yield the rows, a row group at a time; a text that never changes shares one array of indices."""
    described = rows.described
    texts = {column.name: _encoded(column) for column in described.iter_columns() if column.dtype == pl.String}
    others = [column for column in described.iter_columns() if column.name not in texts]
    outcomes = _texts(pl.Series([outcome.value for outcome in OUTCOMES]))
    first = 0
    for frame in rows.frames():
        rows_of_exchange = np.diff(rows.bounds.clip(first, first + len(frame)))
        first += len(frame)
        outcome = frame["outcome"].cast(pl.Int32).to_arrow()
        zeros = _array(np.zeros(len(frame), np.int32))
        columns = {
            **{column.name: column.to_arrow() for column in frame.drop("outcome").iter_columns()},
            **{column.name: _in_pages(column, rows_of_exchange) for column in others},
            "outcome": pa.DictionaryArray.from_arrays(outcome, outcomes),
        }
        for name, text in texts.items():
            numbers, words = text
            is_same = len(words) == 1 and not numbers.null_count()
            indices = zeros if is_same else _repeated(numbers, rows_of_exchange)
            columns[name] = pa.DictionaryArray.from_arrays(indices, words)
        yield pa.Table.from_arrays([columns[name] for name in _WRITTEN_SCHEMA.names], schema=_WRITTEN_SCHEMA)


def _repeated(values: pl.Series, rows_of_exchange: NDArray[np.int64]) -> pa.Array:
    if values.null_count() == len(values):
        return pa.nulls(int(rows_of_exchange.sum()), values.to_arrow().type)
    if values.null_count():
        return values.gather(np.repeat(np.arange(len(values), dtype=np.uint32), rows_of_exchange)).to_arrow()
    return _array(np.repeat(values.to_numpy(), rows_of_exchange))


def _in_pages(values: pl.Series, rows_of_exchange: NDArray[np.int64]) -> pa.Array | pa.ChunkedArray:
    rows = int(rows_of_exchange.sum())
    if rows <= _ROWS_PER_PAGE or rows != rows_of_exchange.max():
        return _repeated(values, rows_of_exchange)
    only = int(rows_of_exchange.argmax())  # one page in memory is repeated
    page = _repeated(values[only : only + 1], np.array([_ROWS_PER_PAGE]))
    return pa.chunked_array([page.slice(0, min(rows - at, _ROWS_PER_PAGE)) for at in range(0, rows, _ROWS_PER_PAGE)])


def _array(values: NDArray[np.generic]) -> pa.Array:
    # `pa.array` would import pandas where it is installed.
    return pl.Series(values).to_arrow()


def _texts(values: pl.Series) -> pa.Array:
    # `cast` and `dictionary_encode` would import `pyarrow.compute`.
    large = values.rechunk().to_arrow()
    bitmap, offsets, data = large.buffers()
    ends = np.frombuffer(offsets, np.int64)[large.offset : large.offset + len(large) + 1].astype(np.int32)
    return pa.StringArray.from_buffers(len(large), pa.py_buffer(ends), data, bitmap, large.null_count)


def _encoded(values: pl.Series) -> tuple[pl.Series, pa.Array]:
    texts = values.drop_nulls().unique(maintain_order=True)
    number = {text: index for index, text in enumerate(texts)}
    return pl.Series(list(map(number.get, values)), dtype=pl.Int32), _texts(texts)


def write_summary(summary: pl.DataFrame, path: Path, provenance: Mapping[str, str]) -> None:
    with output_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as draft:
            pq.write_table(summary_table(summary, provenance), draft, compression="zstd")


def summary_table(summary: pl.DataFrame, provenance: Mapping[str, str] | None = None) -> pa.Table:
    columns = [_texts(c) if c.dtype == pl.String else c.rechunk().to_arrow() for c in summary.iter_columns()]
    return pa.Table.from_arrays(columns, schema=_schema(SUMMARY_COLUMNS).with_metadata(dict(provenance or {})))


def summary_parquet(summary: pl.DataFrame) -> bytes:
    """Return `summary.parquet` for the page, with units and meanings in the metadata of its fields: 100 KB for 500 groups."""
    file = io.BytesIO()
    pq.write_table(summary_table(summary), file, compression="zstd", compression_level=19, write_statistics=False)
    return file.getvalue()


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
_WRITTEN_SCHEMA = pa.schema(
    pa.field(f.name, pa.dictionary(pa.int32(), pa.string()) if pa.types.is_string(f.type) else f.type)
    for f in ROUNDTRIPS_SCHEMA
)


MOST_NAMED = 1000
"""Traces and sessions that are listed: a reader loads all of it with the schema."""


def provenance(campaign: Campaign, exchanges: Exchanges) -> Mapping[str, str]:
    """Return the files' metadata (`docs/trace-format.md`); equal input gives equal bytes: no time of the analysis."""
    read = sorted(source.path for source in campaign.sources if source.status != "skipped")
    sessions = sorted(campaign.sessions.values(), key=lambda session: (session.wall_anchor_ns, session.session_id))
    clocks = [
        {
            "session_id": f"{session.session_id:016x}",
            "role": session.role,
            "device": session.device,
            "started": utc_text(session.wall_anchor_ns),
            "synchronized": is_synchronized(session),
        }
        for session in sessions[:MOST_NAMED]
    ]
    spans = [(exchange.start_ns, exchange.end_ns) for exchange in exchanges.placed]
    spans = spans or [(session.wall_anchor_ns, session.wall_anchor_ns) for session in sessions]  # only taps
    recorded = {"first": utc_text(min(first for first, _ in spans)), "last": utc_text(max(last for _, last in spans))}
    values = {
        "sources": {"folder": real_path(campaign.folder).name, "count": len(read), "names": read[:MOST_NAMED]},
        "recorded": recorded,
        "clocks": {"count": len(sessions), "sessions": clocks},
    }
    return {
        "dds_trace.version": __version__,
        "dds_trace.contract": f"docs/trace-format.md, format {FORMAT_VERSION}",
        **{f"dds_trace.{key}": json.dumps(value) for key, value in values.items()},
    }


def read_provenance(folder: Path) -> Mapping[bytes, bytes] | None:
    try:
        return dict(pq.read_schema(folder / "summary.parquet").metadata or {})
    except (OSError, UnicodeEncodeError, pa.ArrowException):  # pyarrow takes no path that is not UTF-8
        return None
