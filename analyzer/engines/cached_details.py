"""Details and statistics of batches in the user's cache, so that the next analysis makes those of new runs alone.

They take most of the time of an analysis, and follow from what a batch holds: the descriptions of its exchanges, the content
of the traces that its events are in, the deadline, and the code. The HMAC of all that is their key, so nothing is ever used
for another batch; what this user did not seal is not used either (`analyzer/cache/store.py`).
"""

from __future__ import annotations

import io
import json
import platform
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import polars as pl

import dds_trace.tracefile
from dds_trace.base.version import __version__

from ..groups.frames import DETAIL_MAKERS, MAKERS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from collections.abc import Set as AbstractSet

    from dds_trace.tracefile.format.descriptions import Run, Session

    from ..cache.event_index import EventKey, EventPart
    from ..cache.store import TraceCache
    from ..groups.batch import Batch
    from ..groups.frames import Frames

KNOWN_FRAMES = frozenset({"statistics", "distributions", *MAKERS, *DETAIL_MAKERS})
"""Names of the frames of a batch that are kept: those of its `Statistics`, and all that follow from the batch alone."""

MOST_BYTES = 64 << 20
"""Largest file of one batch that is kept."""

UNUSABLE = (OSError, ValueError, LookupError, TypeError, pl.exceptions.PolarsError)
"""What reading a file raises that is not there, or not what was kept."""


class KnownDetails:
    """The frames that earlier analyses have made of a batch.

    Args:
        cache: the open cache.
        trace_keys: position of a trace in the campaign -> its key in the cache.
    """

    def __init__(self, cache: TraceCache, trace_keys: Mapping[int, str]) -> None:
        self._cache = cache
        self._trace_keys = trace_keys
        self._texts: dict[int, tuple[Run | Session, str]] = {}  # one session is described in many exchanges

    def frames_of(
        self, batch: Batch, parts: Mapping[EventKey, Sequence[EventPart]], make: Callable[[], Frames]
    ) -> Frames:
        """Return the frames of a batch: known ones, or new ones, which are known from then on.

        Args:
            batch: the batch, details wanted.
            parts: for each of its `event_keys` the rows of the event index.
            make: makes those of `KNOWN_FRAMES`.
        """
        key = self.key_of(batch, parts)
        found = self.find(key, batch.first_group)
        if found is not None:
            return found
        frames = make()
        self.keep(key, batch.first_group, frames)
        return frames

    def find(self, key: str, first_group: int, names: AbstractSet[str] = KNOWN_FRAMES) -> Frames | None:
        """Return the frames that `keep` was given under this key, if they are known and these.

        Args:
            key: what they are known by, of a batch its `key_of`.
            first_group: the number that the first group of their batch has now.
            names: theirs.
        """
        with suppress(*UNUSABLE):
            frames = unpack_frames(self.read(key, "details"))
            if frames.keys() != names:
                raise ValueError("other frames than are made")
            return shifted(frames, first_group)
        return None

    def keep(self, key: str, first_group: int, frames: Frames) -> None:
        """Keep frames of a batch, whose first group has this number, for `find`."""
        self.write(key, "details", pack_frames(shifted(frames, -first_group)))

    def read(self, key: str, ending: str) -> dict[str, bytes]:
        """Return what `write` was given.

        Raises:
            OSError, ValueError, LookupError, TypeError: there is none, or something else.
        """
        return _unpacked(self._cache.read(key, ending, MOST_BYTES))

    def write(self, key: str, ending: str, files: Mapping[str, bytes | memoryview]) -> Path | None:
        """Keep files under their names, if they are not too large; a full disk costs the cache, not the analysis.

        Returns:
            The file in which they are, the last one at its end; None where they are not kept.
        """
        with suppress(OSError):
            return self._cache.write(key, ending, *_packed(files), most_bytes=MOST_BYTES)
        return None

    def store(self, key: str, content: memoryview) -> str | None:
        """Keep a table as it is.

        Returns:
            Its seal, by which `holds` knows it; None where it is not kept.
        """
        with suppress(OSError):
            return self._cache.store(key, content) if len(content) <= MOST_BYTES else None
        return None

    def holds(self, key: str, seal: str) -> bool:
        """Return whether a table is there as it was kept."""
        return self._cache.holds(key, seal)

    def path(self, key: str, ending: str) -> Path:
        """Return where `write` puts files."""
        return self._cache.path(key, ending)

    def key_of_text(self, purpose: str, text: str) -> str:
        """Return the key of what follows from a text alone."""
        return self._cache.key_of_text(purpose, text)

    def key_of(self, batch: Batch, parts: Mapping[EventKey, Sequence[EventPart]]) -> str:
        """Return the key of everything that the frames depend on, the numbers of groups but for their order left out."""
        options, groups = batch.options, batch.group_of_exchange.tolist()
        held = [
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
        asked = (batch.whole, options.deadline_ns, options.deadline_metric)
        return self._cache.key_of_text("details", json.dumps([code_of_analysis(), asked, held]))

    def _text_of(self, described: Run | Session) -> str:
        known = self._texts.get(id(described))
        if known is None:
            known = self._texts[id(described)] = described, described.to_json()
        return known[1]


@cache
def code_of_analysis() -> tuple[object, ...]:
    """Return what another result of the same batch would come from: versions, and each file of our own with size and time."""
    rooms = (Path(__file__).parents[1], Path(dds_trace.tracefile.__file__).parent)
    files = sorted(file for room in rooms for file in room.rglob("*.py"))
    return (
        __version__,
        platform.python_version(),
        *(version(name) for name in ("numpy", "polars", "pyarrow")),
        *((file.name, file.stat().st_size, file.stat().st_mtime_ns) for file in files),
    )


def shifted(frames: Frames, groups: int) -> Frames:
    """Return the frames with other numbers of groups: a campaign with one more group numbers those behind it anew."""
    numbers = (pl.col("group").cast(pl.Int64) + groups).cast(pl.UInt32)
    return {name: frame.with_columns(numbers) for name, frame in frames.items()}


def pack_frames(frames: Frames) -> dict[str, bytes]:
    """Return each frame as an Arrow stream: of a small frame a file takes polars eight times as long, and seventeen to read."""
    files = {}
    for name, frame in frames.items():
        stream = io.BytesIO()
        # A copy, of the columns' places alone: polars holds a lock of the frame while it writes and waits for Python's, which a
        # thread that looks at the same frame holds while it waits for that lock.
        frame.clone().write_ipc_stream(stream, compression="lz4")
        files[name] = stream.getvalue()
    return files


def unpack_frames(files: Mapping[str, bytes]) -> Frames:
    """Return what `pack_frames` packed.

    Raises:
        PolarsError: it is something else.
    """
    return {name: pl.read_ipc_stream(io.BytesIO(file), use_pyarrow=False) for name, file in files.items()}


def _packed(files: Mapping[str, bytes | memoryview]) -> list[bytes | memoryview]:
    """Return a line of JSON with name and bytes of each file, and the files behind it."""
    head = json.dumps([(name, len(file)) for name, file in files.items()])
    return [head.encode() + b"\n", *files.values()]


def _unpacked(packed: bytes) -> dict[str, bytes]:
    """Return what `_packed` packed.

    Raises:
        ValueError, LookupError, TypeError: it is something else.
    """
    head, _, rest = packed.partition(b"\n")
    files, begin = {}, 0
    for name, size in json.loads(head):
        files[name] = rest[begin : begin + size]
        begin += size
    return files
