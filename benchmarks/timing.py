"""What the benchmarks time with, and what they time against: one thread that unpacks chunks held in memory."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.records import Chunk
from mcap.stream_reader import StreamReader

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

PAGE_BYTES = 4096
KEPT_BLOCK_BYTES = 16 << 20


def seconds(job: Callable[[], object]) -> float:
    """How long one call takes."""
    start = time.perf_counter()
    job()
    return time.perf_counter() - start


class WarmMemory:
    """Memory that the machine has at hand when a job begins that fills it.

    On a virtual machine, memory that was freed goes back to the host within seconds, and touching it anew takes up to
    thirty times as long as zeroing it (docs/explanation/performance.md). So it is held while something else runs.

    Args:
        size: bytes that the job will fill.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self._held = _touched(size)

    def seconds(self, job: Callable[[], object]) -> float:
        """How long `job` takes; what it returns is freed before the memory is held again."""
        self._held = _touched(0)
        taken_s = seconds(job)
        self._held = _touched(self._size)
        return taken_s


def _touched(size: int) -> np.ndarray[Any, np.dtype[np.uint8]]:
    memory = np.empty(size, np.uint8)  # numpy asks for large pages, as it does for the reader
    memory[::PAGE_BYTES] = 1
    return memory


def packed_chunks(path: Path) -> list[tuple[bytes, int]]:
    """Return the packed records of the chunks and their unpacked sizes."""
    with path.open("rb") as stream:
        records = StreamReader(stream, emit_chunks=True).records
        return [(record.data, record.uncompressed_size) for record in records if isinstance(record, Chunk)]


def unpack_job(
    chunks: Sequence[tuple[bytes, int]], unpack: Callable[[bytes, int], bytes]
) -> Callable[[], None]:
    """Unpacks all chunks, in memory already, on one thread."""
    # Glibc keeps freed blocks up to the size of the largest so far; else each chunk may be unpacked into fresh
    # memory, which can take three times as long.
    bytearray(KEPT_BLOCK_BYTES)

    def unpack_all() -> None:
        for packed, size in chunks:
            unpack(packed, size)

    return unpack_all
