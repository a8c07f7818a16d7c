"""Rows of all pages of a SQLite file, also of pages that SQLite no longer reaches (https://www.sqlite.org/fileformat.html)."""

from __future__ import annotations

import os
import re
import struct
from bisect import bisect
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from enum import IntEnum
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from dds_trace.tracefile.mcapfile.blocks import most_unpacked_bytes
from dds_trace.tracefile.mcapfile.file import MAX_RECORD_BYTES
from dds_trace.tracefile.reading.source import Budget, UnreadableError

from .bounds import FEWEST
from .kinds import BLOCK_BYTES, SQLITE_MAGIC

SQLITE_HEADER = struct.Struct(">H2xB7xI")
"""After the magic: page size, bytes reserved in each page, and pages."""
_CELLS, _PAGE_CELLS = struct.Struct(">H"), struct.Struct(">HH")
_LEAF_PAGE, _LEAF_BYTES = re.compile(rb"(?=\x0d..[\x00-\x40]...[\x00-\x3c])", re.DOTALL), 8
_LOGS = {"wal": (24, 0), "journal": (4, 4)}
"""Bytes in front of and after a page in a log, the first four of them its number."""
PAGE_SIZES = [1 << bits for bits in range(9, 17)]
_SIZES = dict(enumerate((0, 1, 2, 3, 4, 6, 8, 8)))
"""Bytes of a number by the kind of its column."""


class _Page(IntEnum):
    INDEX_INTERIOR = 2
    INTERIOR = 5
    INDEX_LEAF = 10
    LEAF = 13


class _Format(IntEnum):
    FIRST_HEADER_BYTES = 100
    USUAL_PAGE_BYTES = 4096
    MOST_RESERVED_BYTES = 32
    """Of a page, by extensions of SQLite."""


_MANY_PAGES = 1000
"""A file that was cut may lack so many; so many leaves show the size of all pages."""


class Image:
    """Bytes of a file, or of a database with the pages that a log has of it: read when a slice of them is asked for."""

    def __init__(self, file: BinaryIO, log_kind: str = "") -> None:
        self._file, self.log_kind, self._size = file, log_kind, os.fstat(file.fileno()).st_size
        self._under, self._page_bytes, self._offsets = self, 0, dict[int, int]()

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, part: slice) -> bytes:
        at, stop, _ = part.indices(self._size)
        if self._under is self:
            return os.pread(self._file.fileno(), max(stop - at, 0), at)
        parts = []
        while at < stop:
            index, skipped = divmod(at, self._page_bytes)
            end = min(stop, (index + 1) * self._page_bytes)
            logged_at = self._offsets.get(index + 1)
            data = (
                self._under[at:end]
                if logged_at is None
                else os.pread(self._file.fileno(), end - at, logged_at + skipped)
            )
            parts.append(data.ljust(end - at, b"\0"))
            at = end
        return b"".join(parts)

    def with_pages(self, log: Image, page_bytes: int, pages: int, offsets: dict[int, int]) -> Image:
        """Return these bytes with pages of a log in their places, `pages` long, but no longer than both have bytes for."""
        joined = Image(log._file)
        joined._under, joined._page_bytes, joined._offsets = self, page_bytes, offsets
        most = len(self) // page_bytes + len(offsets) + _MANY_PAGES
        joined._size = min(pages, most) * page_bytes
        return joined

    def leaf_pages(self) -> Iterator[int]:
        for start in range(0, self._size, BLOCK_BYTES):
            for match in _LEAF_PAGE.finditer(self[start : start + BLOCK_BYTES + _LEAF_BYTES - 1]):
                yield start + match.start()


def rows_of_pages(image: Image, budget: Budget) -> Iterator[tuple[int, list[Any]]]:
    """Yield the rows of all leaf pages, wherever they are in the file; last those that go on in other pages."""
    _, _, header = image[:BLOCK_BYTES].partition(SQLITE_MAGIC)
    claimed, reserved, _ = SQLITE_HEADER.unpack_from(header.ljust(SQLITE_HEADER.size, b"\0"))
    number_bytes, after_bytes = _LOGS.get(image.log_kind, (0, 0))
    page_bytes = _page_bytes(image, 65536 if claimed == 1 else claimed, number_bytes + after_bytes)
    usable_bytes = page_bytes - (reserved if reserved <= _Format.MOST_RESERVED_BYTES else 0)
    pages = _Pages(image, page_bytes, usable_bytes, number_bytes, after_bytes)
    cells, leaves = list[_Cell](), dict[int, int]()
    for cell in pages.cells():
        leaves[cell.page_at] = cell.row_id
        if cell.size > len(cell.start):
            cells.append(cell)
            continue
        with suppress(ValueError, IndexError):
            values = _values(cell.start)
            budget.take()
            yield cell.row_id, values
    if cells:
        pages.find(leaves)
    for is_last_try in (False, True):
        remaining, cells = cells, []
        for cell in remaining:
            try:
                values = _values(pages.payload(cell, is_last_try=is_last_try))
            except (ValueError, IndexError):
                cells.append(cell)
                continue
            budget.take()
            yield cell.row_id, values


class Tables:
    """Rows of the tables of a database, by the pages that lead to them from the first one; none of these is read twice.

    `ValueError`, `IndexError` or `struct.error` where a page is none.
    """

    def __init__(self, image: Image) -> None:
        header = image[: len(SQLITE_MAGIC) + SQLITE_HEADER.size]
        claimed, reserved, _ = SQLITE_HEADER.unpack_from(header, len(SQLITE_MAGIC))
        self._page_bytes = 65536 if claimed == 1 else claimed
        if not header.startswith(SQLITE_MAGIC) or self._page_bytes not in PAGE_SIZES:
            raise ValueError("it does not start as a database does")
        self._image, self._usable_bytes = image, self._page_bytes - reserved
        self._pages = _Pages(image, self._page_bytes, self._usable_bytes, 0, 0)
        self._reached = bytearray(len(image) // self._page_bytes + 1)
        self._roots = {
            values[1]: values[3]
            for _, values in self._rows_below(1)
            if values[0] == "table" and isinstance(values[3], int)
        }

    def __contains__(self, name: str) -> bool:
        return name in self._roots

    def rows(self, name: str) -> Iterator[tuple[int, list[Any]]]:
        return self._rows_below(self._roots[name])

    def _rows_below(self, root: int) -> Iterator[tuple[int, list[Any]]]:
        numbers = [root]
        while numbers:
            number = numbers.pop()
            page, head = self._page(number), _Format.FIRST_HEADER_BYTES if number == 1 else 0
            (cells,) = _CELLS.unpack_from(page, head + 3)
            if page[head] == _Page.INTERIOR:
                offsets = struct.unpack_from(f">{cells}H", page, head + 12)
                children = [int.from_bytes(page[offset : offset + 4], "big") for offset in (*offsets, head + 8)]
                numbers += reversed(children)
            elif page[head] == _Page.LEAF:
                for offset in struct.unpack_from(f">{cells}H", page, head + 8):
                    cell = self._pages.cell(page, offset, 0)
                    yield cell.row_id, _values(self._payload(cell))
            else:
                raise ValueError(f"page {number} is not a page of a table")

    def _payload(self, cell: _Cell) -> bytes:
        parts, number, size = [cell.start], cell.number, cell.size - len(cell.start)
        while size > 0:
            page = self._page(number)
            number = int.from_bytes(page[:4], "big")
            parts.append(page[4 : min(4 + size, self._usable_bytes)])
            size -= len(parts[-1])
        return b"".join(parts)

    def _page(self, number: int) -> bytes:
        page = self._image[(number - 1) * self._page_bytes : number * self._page_bytes] if number > 0 else b""
        if len(page) < self._page_bytes or self._reached[number]:
            raise ValueError(f"page {number} is {'reached twice' if page else 'missing'}")
        self._reached[number] = True
        return page


def _page_bytes(data: Image, claimed: int, in_log: int) -> int:
    """Return the claimed size, unless another one fits the leaf pages, each with `in_log` bytes around it."""
    starts, largest = list[int](), list[int]()
    for at in data.leaf_pages():
        cells, content_at = _PAGE_CELLS.unpack(data[at + 3 : at + 7])
        offsets = data[at + 8 : at + 8 + 2 * cells] if 8 + 2 * cells <= content_at else b""
        numbers = struct.unpack(f">{len(offsets) // 2}H", offsets[: len(offsets) // 2 * 2])
        if numbers and min(numbers) == content_at:
            starts.append(at)
            largest.append(max(numbers))
        if len(starts) == _MANY_PAGES:
            break
    apart = np.diff(starts)
    fitting = [
        size
        for size in PAGE_SIZES
        if len(apart) and ((apart % (size + in_log) == 0) & (np.array(largest[1:]) < size)).mean() > 1 / 2
    ]
    if claimed in fitting or (not fitting and claimed in PAGE_SIZES):
        return claimed
    return max(fitting, default=_Format.USUAL_PAGE_BYTES)


class _Cell(NamedTuple):
    """A row of `size` bytes: its start on a leaf page, and the number of the page on which it goes on."""

    row_id: int
    size: int
    start: bytes
    number: int
    page_at: int


class _Pages:
    """Pages that may be displaced; those on which rows go on have consecutive numbers, and begin with the next one's.

    In a log each page follows its own number. `_moved` has offsets of pages, and how far they were moved in bytes.
    """

    def __init__(self, data: Image, page_bytes: int, usable_bytes: int, number_bytes: int, after_bytes: int) -> None:
        self._data, self._page_bytes, self._usable_bytes = data, page_bytes, usable_bytes
        self._number_bytes = number_bytes
        self._stride = self._number_bytes + page_bytes + after_bytes
        self._left_bytes, self._most = most_unpacked_bytes(len(data)), len(data) // page_bytes + _MANY_PAGES
        self._offsets: dict[int, list[int]] = {}
        self._ends: set[int] = set()
        self._end_numbers: dict[int, int] = {}
        self._moved: list[tuple[int, int]] = []
        self._moves: list[int] = []

    def cells(self) -> Iterator[_Cell]:
        for at in self._data.leaf_pages():
            page = self._data[at : at + self._page_bytes]
            (cells,) = _CELLS.unpack_from(page, 3)
            if len(page) < self._page_bytes or cells > self._page_bytes // 4:
                continue
            offsets = struct.unpack_from(f">{cells}H", page, 8)
            if at % self._page_bytes and not all(8 + 2 * cells <= offset < self._page_bytes for offset in offsets):
                continue
            for offset in offsets:
                with suppress(ValueError, IndexError):
                    yield self.cell(page, offset, at)

    def cell(self, page: bytes, offset: int, page_at: int) -> _Cell:
        size, offset = _varint(page, offset)
        row_id, offset = _varint(page, offset)
        if size > MAX_RECORD_BYTES:
            raise ValueError("no row is so long")
        self._left_bytes -= size
        if self._left_bytes < 0:
            raise UnreadableError("its rows share their pages")
        usable = self._usable_bytes
        least = (usable - 12) * 32 // 255 - 23
        local = least + (size - least) % (usable - 4)
        local = size if size <= usable - 35 else local if local <= usable - 35 else least
        start, number = page[offset : offset + local], int.from_bytes(page[offset + local : offset + local + 4], "big")
        kinds, at = _kinds(start)
        if at + sum(map(_size_bytes, kinds)) != size:
            raise ValueError("the columns of a row are as long as the row")
        return _Cell(row_id, size, start, number, page_at)

    def find(self, leaves: dict[int, int]) -> None:
        alignments = np.zeros(self._stride, bool)
        alignments[[at % self._stride for at in leaves]] = True
        children = dict[int, int]()
        for start in range(0, len(self._data), BLOCK_BYTES):
            part = self._data[start : start + BLOCK_BYTES + self._stride + 3]
            size = min(BLOCK_BYTES, len(self._data) - start)
            content = np.zeros(size + self._stride + 3, np.uint32)
            content[: len(part)] = np.frombuffer(part, np.uint8)
            leading = content[:-3] << 24 | content[1:-2] << 16 | content[2:-1] << 8 | content[3:]
            numbers, next_numbers = leading[:size], leading[self._stride :]
            pages_at = np.arange(start, start + size) + self._number_bytes
            is_aligned = np.resize(np.roll(alignments, -int(pages_at[0])), size)
            is_aligned &= pages_at <= len(self._data) - self._page_bytes
            is_page = (
                (numbers > 0) & (numbers <= self._most) & (is_aligned | ((next_numbers == numbers + 1) & (numbers > 1)))
            )
            for number, at in zip(numbers[is_page].tolist(), pages_at[is_page].tolist(), strict=True):
                self._offsets.setdefault(number - (not self._number_bytes), []).insert(0, at)
            if not self._number_bytes:
                self._ends.update(pages_at[is_aligned & (numbers == 0)].tolist())
                for at in pages_at[is_aligned & (numbers >> 16 == _Page.INTERIOR << 8)].tolist():
                    children |= self._children(self._data[at : at + self._page_bytes])
        if not self._number_bytes:
            self._count_moves(
                [(children[last], at) for at, last in leaves.items() if 0 < children.get(last, 0) <= self._most]
            )

    def _children(self, page: bytes) -> dict[int, int]:
        children = dict[int, int]()
        with suppress(IndexError, struct.error):
            for offset in struct.unpack_from(f">{_CELLS.unpack_from(page, 3)[0]}H", page, 12):
                children[_varint(page, offset + 4)[0]] = int.from_bytes(page[offset : offset + 4], "big")
        return children

    def _count_moves(self, leaves: list[tuple[int, int]]) -> None:
        pages = sorted(
            (at, at - (number - 1) * self._page_bytes)
            for number, at in [*leaves, *((number, at) for number, offsets in self._offsets.items() for at in offsets)]
        )
        moves = Counter(moved for _, moved in pages)
        self._moves = [moved for moved, _ in moves.most_common(FEWEST)]
        self._moved = [(at, moved) for at, moved in pages if moves[moved] > 1]
        preceding = {at: self._following(at - self._page_bytes) for at in self._ends}
        self._end_numbers = {
            at: number for at, number in preceding.items() if 1 < number <= self._most and number not in self._offsets
        }
        self._ends -= self._end_numbers.keys()

    def payload(self, cell: _Cell, *, is_last_try: bool) -> bytes:
        parts, used, number, size = [cell.start], set[int](), cell.number, cell.size - len(cell.start)
        moved_bytes = self._moved_near(cell.page_at)
        while size > 0:
            at = self._page(number, size, moved_bytes, is_last_try=is_last_try)
            if not number or self._following(at) < 0:
                raise ValueError("a page is missing")
            parts.append(self._data[at + 4 : at + 4 + min(size, self._usable_bytes - 4)])
            size -= len(parts[-1])
            used.add(at)
            moved_bytes = at - (number - 1) * self._page_bytes
            number = self._following(at)
        if number:
            raise ValueError("more pages follow than the row has")
        self._ends -= used
        return b"".join(parts)

    def _moved_near(self, page_at: int) -> int:
        index = bisect(self._moved, (page_at + 1,))
        near = [
            page for page in self._moved[max(index - 1, 0) : index + 1] if (page[0] - page_at) % self._page_bytes == 0
        ]
        return min(near, key=lambda page: abs(page[0] - page_at), default=(0, page_at % self._page_bytes))[1]

    def _page(self, number: int, size: int, moved_bytes: int, *, is_last_try: bool) -> int:
        further = -(-size // (self._usable_bytes - 4)) - 1
        after = [number + step if further >= step else 0 for step in (1, 2)]

        def fit(at: int) -> int:
            if self._following(at) != after[0] or self._end_numbers.get(at, number) != number:
                return 0
            following = self._following(at + self._stride)
            return 1 + (following == after[1] if further else following <= self._most or following >> 24 in {*_Page})

        moves = () if self._number_bytes else (moved_bytes, moved_bytes - self._page_bytes, *self._moves)
        candidates = [(number - 1) * self._page_bytes + moved for moved in moves] + self._offsets.get(number, [])
        if is_last_try and not further and len(self._ends) == 1:
            candidates += self._ends
        return max(candidates, key=fit, default=-1)

    def _following(self, at: int) -> int:
        """Return the number with which a page begins; -1 outside of the file."""
        is_page = 0 <= at <= len(self._data) - self._page_bytes
        return int.from_bytes(self._data[at : at + 4], "big") if is_page else -1


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for _ in range(8):
        value = value << 7 | data[at] & 0x7F
        at += 1
        if data[at - 1] < 0x80:
            return value, at
    return value << 8 | data[at], at + 1


def _size_bytes(kind: int) -> int:
    return _SIZES.get(kind, max(kind - 12, 0) // 2)


def _kinds(payload: bytes) -> tuple[list[int], int]:
    head_end, at = _varint(payload, 0)
    kinds = []
    while at < head_end:
        kind, at = _varint(payload, at)
        kinds.append(kind)
    return kinds, at


def _values(payload: bytes) -> list[Any]:
    kinds, at = _kinds(payload)
    values: list[Any] = []
    for kind in kinds:
        data = payload[at : at + _size_bytes(kind)]
        at += len(data)
        if 0 < kind <= 6:
            values.append(int.from_bytes(data, "big", signed=True))
        elif kind < 12:
            values.append(kind - 8 if kind in {8, 9} else None)
        else:
            values.append(data if kind % 2 == 0 else data.decode())
    return values
