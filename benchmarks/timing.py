"""What the benchmarks time with: cores kept awake, memory kept, and one thread that unpacks chunks held in memory."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

import pyarrow as pa
import pyarrow.parquet as pq
from mcap.records import Chunk
from mcap.stream_reader import StreamReader

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

KEPT_BLOCK_BYTES = 16 << 20
_M_TRIM_THRESHOLD, _M_MMAP_MAX = -1, -4  # malloc.h


def seconds(job: Callable[[], object]) -> float:
    """How long one call takes."""
    start = time.perf_counter()
    job()
    return time.perf_counter() - start


@contextmanager
def awake_cores() -> Iterator[None]:
    """Keep every core awake to the end of the block, by a process each that gives way to any other (sched(7), SCHED_IDLE).

    They end with this process, too, whatever ends it.
    """
    spin = (
        "import os; os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))\n"
        f"while os.getppid() == {os.getpid()}:\n for _ in range(1_000_000): pass"
    )
    with ExitStack() as started:
        for core in sorted(os.sched_getaffinity(0)):
            command = ["taskset", "--cpu-list", str(core), sys.executable, "-S", "-c", spin]
            process = started.enter_context(subprocess.Popen(command))
            started.callback(process.kill)
        yield


def read_rows(path: Path) -> pa.Table:
    """Return the rows of a Parquet file as the analysis writes them: texts are dictionaries."""
    texts = [field.name for field in pq.read_schema(path) if field.type == "string"]
    # `pq.read_table` would import pandas where it is installed.
    return pq.ParquetFile(path, read_dictionary=texts).read()


def keep_freed_memory() -> None:
    """Let this process keep memory that is freed, so that a job that was done once before touches none for the first time.

    Memory that goes back to the kernel does not come back as it was: on a virtual machine the kernel tells its host every two
    seconds what is free, and touching that anew takes up to thirty times as long as zeroing it (benchmarks/performance.md).
    Even memory freed at the beginning of a round is partly gone before the round has filled it.

    Raises:
        OSError: the C library is not glibc.
    """
    libc = ctypes.CDLL(None)
    if not hasattr(libc, "mallopt"):
        raise OSError("the C library cannot be told to keep memory; these benchmarks need glibc")
    for option, value in ((_M_MMAP_MAX, 0), (_M_TRIM_THRESHOLD, 2**31 - 1)):
        if not libc.mallopt(option, value):
            raise OSError(f"mallopt({option}, {value}) is refused")


def packed_chunks(path: Path) -> list[tuple[bytes, int]]:
    """Return the packed records of the chunks and their unpacked sizes."""
    with path.open("rb") as stream:
        records = StreamReader(stream, emit_chunks=True).records
        return [(record.data, record.uncompressed_size) for record in records if isinstance(record, Chunk)]


def unpack_job(chunks: Sequence[tuple[bytes, int]], unpack: Callable[[bytes, int], bytes]) -> Callable[[], None]:
    """Unpacks all chunks, in memory already, on one thread."""
    # Glibc keeps freed blocks up to the size of the largest so far; else each chunk may be unpacked into fresh
    # memory, which can take three times as long.
    bytearray(KEPT_BLOCK_BYTES)

    def unpack_all() -> None:
        for packed, size in chunks:
            unpack(packed, size)

    return unpack_all
