"""Results of batches in the user's cache, so that the next analysis processes only new runs.

The key is the HMAC of descriptions of the exchanges, content of the traces with their events, deadline, and code.

    KEY of               ending    content
    a batch              details   statistics and the frames of `GROUP_DETAIL_MAKERS`
    runs, points         details   the frames of `RUN_MAKERS`; points: how many a run has in the timeline
    runs                 rows      paired rows (`packed_rows.py`)
"""

from __future__ import annotations

import io
import json
import platform
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path

import polars as pl
import pyarrow as pa

import dds_trace.tracefile
from dds_trace.base.version import __version__
from dds_trace.tracefile.format.descriptions import Run, Session

from ..cache.event_index import EventKey, EventPart
from ..cache.store import SEAL_BYTES, TraceCache
from ..groups.batch import Batch
from ..groups.frames import Frames
from ..pairing.roundtrips import RoundTrips
from .packed_rows import PackedRows, pack_rows

MOST_BYTES = 64 << 20

_UNUSABLE = (OSError, ValueError, LookupError, TypeError, pl.exceptions.PolarsError, pa.ArrowException)
"""Errors of reading a file that is missing or has other content."""


class ResultCache:
    """Reads and writes results of analyses; `trace_keys` by index of the trace."""

    def __init__(self, cache: TraceCache, trace_keys: Mapping[int, str]) -> None:
        self._cache = cache
        self._trace_keys = trace_keys
        self._texts: dict[int, tuple[Run | Session, str]] = {}  # one session is part of many exchanges

    def key_of(self, batch: Batch, parts: Mapping[EventKey, Sequence[EventPart]]) -> str:
        """Return the key of everything that results depend on; of groups only the order counts."""
        options, groups = batch.options, batch.group_of_exchange.tolist()
        exchanges = [
            (
                group - groups[0],
                self._text_of(exchange.run),
                self._text_of(exchange.ping),
                exchange.relay_id,
                self._text_of(exchange.relay) if exchange.relay is not None else None,
                (exchange.start_ns, exchange.end_ns, exchange.counts, exchange.relays, exchange.flows),
                exchange.replied_ns,
                [
                    [(part.count, self._trace_keys[part.trace]) for part in parts.get(key, ())]
                    for key in exchange.event_keys()
                ],
            )
            for group, exchange in zip(groups, batch.exchanges, strict=True)
        ]
        settings = (batch.whole, options.deadline_ns, options.deadline_metric)
        return self._cache.key_of_text("details", json.dumps([code_of_analysis(), settings, exchanges]))

    def read_frames(self, key: str, names: AbstractSet[str], first_group: int) -> Frames | None:
        """Return the frames of this key; None if the cache has none, or others than `names`.

        `first_group` is the number that the first group of their batch has now.
        """
        with suppress(*_UNUSABLE):
            frames = unpack_frames(self._cache.read(self._hashed(key), "details"))
            if frames.keys() == names:
                return _renumbered(frames, first_group)
        return None

    def write_frames(self, key: str, frames: Frames, first_group: int) -> None:
        """Write frames unless they are too large; a full disk costs only the cache."""
        packed = pack_frames(_renumbered(frames, -first_group))
        with suppress(OSError):
            if len(packed) <= MOST_BYTES:
                with self._cache.writing(self._hashed(key), "details") as stream:
                    stream.write(packed)

    def read_rows(self, key: str, batch: Batch) -> PackedRows | None:
        """Return the rows of a batch, None if they are not cached."""
        with suppress(*_UNUSABLE):
            content = self._cache.read(self._hashed(key), "rows")
            path = self._cache.path(self._hashed(key), "rows")
            return PackedRows.of(content, batch.exchanges, path, SEAL_BYTES)
        return None

    def write_rows(self, key: str, rows: RoundTrips) -> PackedRows | None:
        """Write the rows of a batch and return them as cached; None if they cannot be written."""
        with suppress(OSError):
            with self._cache.writing(self._hashed(key), "rows") as stream:
                offset = pack_rows(rows, pa.PythonFile(stream, "w"))
            path = self._cache.path(self._hashed(key), "rows")
            return PackedRows.like(rows, path, SEAL_BYTES + offset)
        return None

    def _hashed(self, key: str) -> str:
        return self._cache.key_of_text("result", key)

    def _text_of(self, described: Run | Session) -> str:
        if id(described) not in self._texts:
            self._texts[id(described)] = described, described.to_json()
        return self._texts[id(described)][1]


@cache
def code_of_analysis() -> tuple[object, ...]:
    rooms = (Path(__file__).parents[1], Path(dds_trace.tracefile.__file__).parent)
    files = sorted(file for room in rooms for file in room.rglob("*.py"))
    return (
        __version__,
        platform.python_version(),
        *(version(name) for name in ("numpy", "polars", "pyarrow")),
        *((file.name, file.stat().st_size, file.stat().st_mtime_ns) for file in files),
    )


def _renumbered(frames: Frames, shift: int) -> Frames:
    """Shift the numbers of groups: a new group changes those after it."""
    groups = (pl.col("group").cast(pl.Int64) + shift).cast(pl.UInt32)
    return {name: frame.with_columns(groups) for name, frame in frames.items()}


def pack_frames(frames: Frames) -> bytes:
    """Return frames as a line of JSON with name and size of each, then each as an Arrow stream.

    A stream, because polars is many times as fast with it as with a small Arrow file.
    """
    files = {}
    for name, frame in frames.items():
        stream = io.BytesIO()
        # Cloned, because polars locks a frame while it waits for Python's lock: a deadlock with another reader of it.
        frame.clone().write_ipc_stream(stream, compression="lz4")
        files[name] = stream.getvalue()
    head = json.dumps([(name, len(file)) for name, file in files.items()])
    return b"\n".join([head.encode(), b"".join(files.values())])


def unpack_frames(packed: bytes | memoryview) -> Frames:
    """Return what `pack_frames` packed.

    Raises:
        ValueError, LookupError, TypeError, PolarsError: it is something else.
    """
    head, _, rest = bytes(packed).partition(b"\n")
    frames, start = {}, 0
    for name, size in json.loads(head):
        frames[name] = pl.read_ipc_stream(io.BytesIO(rest[start : start + size]), use_pyarrow=False)
        start += size
    return frames
