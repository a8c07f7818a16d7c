"""A database as its log leaves it, read page by page without a copy: SQLite is never handed a log of somebody else.

A rollback journal contains pages as they were before a transaction that did not finish, and may end with the name of a
further file, which nobody looks up here. A write-ahead log contains pages of transactions; only finished ones count
(https://www.sqlite.org/fileformat.html, 3 and 4).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from enum import IntEnum
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dds_trace.base.files import open_regular

from .kinds import BLOCK_BYTES
from .recorded import Condition
from .sqlite_pages import PAGE_SIZES, Image

_JOURNAL = struct.Struct(">8sIIIII")
"""Magic, records, start value of the checksums, pages of the database, bytes of a sector, bytes of a page."""
_JOURNAL_MAGIC = bytes.fromhex("d9d505f920a163d7")
_WAL = struct.Struct(">IIIIIIII")
"""Magic, version, bytes of a page, checkpoints, two salts, two sums."""


class _Format(IntEnum):
    JOURNAL_TO_ITS_END = 0xFFFFFFFF
    NUMBER_BYTES = 4
    CHECKSUM_BYTES = 4
    CHECKSUM_STEP = 200
    LOCK_PAGE_AT = 1 << 30
    WAL_MAGIC = 0x377F0682
    WAL_VERSION = 3007000
    FRAME_HEAD_BYTES = 24


_WORD = np.iinfo(np.uint32).max
_SECTOR_SIZES = {1 << bits for bits in range(5, 17)}
_MOST_LOG_BYTES = 1 << 30
"""A log of more bytes, and of more than its database, is not read."""


class LoggedPages(NamedTuple):
    """Bytes of a page, pages of the database, and the offset in the log of each page that the log has."""

    page_bytes: int
    pages: int
    offsets: dict[int, int]


@contextmanager
def open_database(path: Path, condition: Condition) -> Iterator[tuple[Image | None, list[Image]]]:
    """Yield the database joined with its logs, if it has any, and all files with pages: first those that no page was written to too early."""
    with ExitStack() as stack:
        database = joined = Image(stack.enter_context(open_regular(path)))
        logs = dict[str, Image]()
        for kind, read in (("journal", _read_journal), ("wal", _read_wal)):
            log_path = path.with_name(f"{path.name}-{kind}")
            if not log_path.is_file() or not log_path.stat().st_size:
                continue
            log = Image(stack.enter_context(open_regular(log_path)), log_kind=kind)
            most_bytes = max(_MOST_LOG_BYTES, len(database))
            if len(log) > most_bytes:
                sizes = f"it has {len(log) >> 20} MiB; of a log for so small a database at most {most_bytes >> 20} MiB are read"
                condition.damages.append(f"its log {log_path.name} is left out: {sizes}")
                continue
            logged = read(log)
            if logged is not None:
                joined = joined.with_pages(log, *logged)
                about = {
                    "wal": f"the messages in {log_path.name} are included",
                    "journal": f"its last transaction was not finished, and is undone as {log_path.name} says",
                }
                condition.notes.append(about[kind])
            if logged is not None or kind == "wal":
                logs[kind] = log
        has_pages = joined is not database
        images = [database, logs["wal"], joined] if "wal" in logs else [*logs.values(), joined, database]
        yield joined if has_pages else None, images if has_pages else [database, *logs.values()]


def _read_journal(log: Image) -> LoggedPages | None:
    """Return what a journal puts back, up to the first record that is not whole; None for a journal of a finished transaction."""
    first, offsets, at = None, dict[int, int](), 0
    while len(head := log[at : at + _JOURNAL.size]) == _JOURNAL.size:
        magic, records, start, pages, sector_bytes, page_bytes = _JOURNAL.unpack(head)
        if magic != _JOURNAL_MAGIC or page_bytes not in PAGE_SIZES or sector_bytes not in _SECTOR_SIZES:
            break
        first = first or LoggedPages(page_bytes, pages, offsets)
        at += sector_bytes
        record_bytes = _Format.NUMBER_BYTES + page_bytes + _Format.CHECKSUM_BYTES
        whole = (len(log) - at) // record_bytes
        for _ in range(whole if records == _Format.JOURNAL_TO_ITS_END else min(records, whole)):
            record = log[at : at + record_bytes]
            number = int.from_bytes(record[: _Format.NUMBER_BYTES], "big")
            sums = start + sum(
                record[
                    _Format.NUMBER_BYTES
                    + page_bytes
                    - _Format.CHECKSUM_STEP : _Format.NUMBER_BYTES : -_Format.CHECKSUM_STEP
                ]
            )
            is_end = number in {0, _Format.LOCK_PAGE_AT // page_bytes + 1}
            if is_end or sums & _WORD != int.from_bytes(record[-_Format.CHECKSUM_BYTES :], "big"):
                return first
            if number <= first.pages:
                offsets[number] = at + _Format.NUMBER_BYTES
            at += record_bytes
        at = -(-at // sector_bytes) * sector_bytes
    return first


def _read_wal(log: Image) -> LoggedPages | None:
    """Return the pages of the finished transactions before the first frame that is not whole; None if there is none."""
    head = log[: _WAL.size].ljust(_WAL.size, b"\0")
    magic, version, page_bytes, _, *salts_and_sums = _WAL.unpack(head)
    page_bytes = 65536 if page_bytes == 1 else page_bytes
    if magic & ~1 != _Format.WAL_MAGIC or version != _Format.WAL_VERSION or page_bytes not in PAGE_SIZES:
        return None
    order, salts, stored = ">" if magic & 1 else "<", tuple(salts_and_sums[:2]), tuple(salts_and_sums[2:])
    words = np.frombuffer(head[:24], f"{order}u4").astype(np.uint32)
    if next(_next_sums((0, 0), words[None])) != stored:
        return None
    frame_bytes, at, pages = _Format.FRAME_HEAD_BYTES + page_bytes, _WAL.size, 0
    offsets, pending = dict[int, int](), dict[int, int]()
    while frames := min(len(log) - at, max(BLOCK_BYTES, frame_bytes)) // frame_bytes:
        data = np.frombuffer(log[at : at + frames * frame_bytes], np.uint8).reshape(frames, frame_bytes)
        words = np.hstack((data[:, :8], data[:, _Format.FRAME_HEAD_BYTES :])).view(f"{order}u4").astype(np.uint32)
        heads = np.ascontiguousarray(data[:, : _Format.FRAME_HEAD_BYTES]).view(">u4").tolist()
        for (number, count, *head_words), frame_sums in zip(heads, _next_sums(stored, words), strict=True):
            if (*salts, *frame_sums) != tuple(head_words) or not number:
                return LoggedPages(page_bytes, pages, offsets) if offsets else None
            stored, pending[number] = frame_sums, at + _Format.FRAME_HEAD_BYTES
            at += frame_bytes
            if count:
                pages = count
                offsets |= pending
                pending.clear()
    return LoggedPages(page_bytes, pages, offsets) if offsets else None


def _next_sums(sums: tuple[int, int], frames: NDArray[np.uint32]) -> Iterator[tuple[int, int]]:
    """Yield the two sums after each frame: the word n places before its end adds them F(n) and F(n + 1) times (Fibonacci)."""
    numbers = [0, 1]
    for _ in range(frames.shape[1]):
        numbers.append((numbers[-1] + numbers[-2]) & _WORD)
    weights = np.array(numbers[-2::-1], np.uint32)
    added = frames @ np.column_stack((weights[1:], weights[:-1]))
    before, at, after = numbers[-3:]
    first, second = sums
    for more in added.tolist():
        first, second = (
            (before * first + at * second + more[0]) & _WORD,
            (at * first + after * second + more[1]) & _WORD,
        )
        yield first, second
