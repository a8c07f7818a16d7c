"""Rows as parts of one Parquet file: each is encoded where its rows are made, and all are joined without a look at the rows.

A part is a Parquet file of its own. Only its footer names offsets in the file; so the file of all parts has their bytes one
behind the other, and one footer, in which the offsets are moved. It is the same file whoever encoded its parts.
"""

from __future__ import annotations

import io
import secrets
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa
import pyarrow.parquet as pq

from dds_trace.base.errors import OutputError

from .thrift import BINARY, I16, I64, LIST, STRUCT, Elements, Value, read_struct, write_struct

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from typing import BinaryIO

    from .thrift import Struct

MOST_NUMBERED = 1 << 15
"""Row groups that are given their number, which is optional and has 16 bits."""

_MAGIC = b"PAR1"
_LENGTH_BYTES = 4

# Numbers of the fields of a footer (https://github.com/apache/parquet-format/blob/master/src/main/thrift/parquet.thrift).
_ROWS, _ROW_GROUPS, _KEY_VALUES = 3, 4, 5
_COLUMNS, _GROUP_OFFSET, _ORDINAL = 1, 5, 7
_CHUNK_OFFSET, _COLUMN = 2, 3
_PAGE_OFFSETS = (9, 10, 11)  # of data, index and dictionary
_KEY, _VALUE = 1, 2


def new_part(folder: Path) -> Path:
    """Return a name in a folder of temporary files that nothing else has."""
    return folder / f"{secrets.token_hex(8)}.rows"


@contextmanager
def telling_of_room() -> Iterator[None]:
    """Turn an error of the system, while rows are put into a temporary file, into one that says what to do."""
    try:
        yield
    except OSError as err:
        raise OutputError(f"rows cannot be kept ({err}); give a larger folder with TMPDIR") from err


def read_rows(source: Path | BinaryIO | pa.NativeFile) -> pa.Table:
    """Return the rows of a Parquet file as they are written: texts are dictionaries."""
    texts = [field.name for field in pq.read_schema(source) if field.type == "string"]
    # `pq.read_table` would load pandas where it is installed, for the better part of a second.
    return pq.ParquetFile(source, read_dictionary=texts).read()


@dataclass(frozen=True, slots=True)
class RowPart:
    """Rows that are encoded.

    Attributes:
        num_rows: how many.
        content: a Parquet file: its bytes, or the file that it is the end of.
        begins_at: where it begins in that file.
        is_temporary: whether that file is for this part alone, and removed once it is joined.
    """

    num_rows: int
    content: pa.Buffer | Path
    begins_at: int = 0
    is_temporary: bool = True

    @classmethod
    def at_end_of(cls, path: Path, size: int, num_rows: int) -> RowPart:
        """Return rows that are the last bytes, so many, of a file that stays.

        Raises:
            OSError: there is no such file.
        """
        return cls(num_rows, path, path.stat().st_size - size, is_temporary=False)

    def in_folder(self, folder: Path) -> RowPart:
        """Return the same rows in a file of a folder of temporary files.

        Raises:
            OutputError: it cannot be written.
        """
        if isinstance(self.content, Path):
            return self
        path = new_part(folder)
        with telling_of_room(), path.open("wb") as file:
            file.write(self.content)
        return RowPart(self.num_rows, path)

    def load(self) -> pa.Table:
        """Return the rows, decoded; see `read_rows`."""
        with self.open() as file:
            return read_rows(pa.BufferReader(file.read()))

    def open(self) -> BinaryIO | pa.NativeFile:
        """Open it for reading, where it begins.

        Raises:
            OutputError: its file is gone.
        """
        if not isinstance(self.content, Path):
            return pa.BufferReader(self.content)
        try:
            file = self.content.open("rb")
        except FileNotFoundError as err:
            raise OutputError(f"{self.content} was removed while it was needed; analyze again") from err
        file.seek(self.begins_at)
        return file

    def remove(self) -> None:
        """Remove its file, if it has one of its own."""
        if isinstance(self.content, Path) and self.is_temporary:
            self.content.unlink()


class JoinedParts:
    """Joins parts of one schema into one Parquet file.

    Args:
        stream: takes the file; nothing was written into it yet.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._stream.write(_MAGIC)
        self._at = len(_MAGIC)
        self._footer: Struct = {}
        self._row_groups: list[Struct] = []
        self._rows = 0

    def add(self, part: RowPart) -> None:
        """Append the rows of a part; the first one says which columns there are, also without a row.

        Raises:
            OSError: it cannot be read or written.
        """
        with part.open() as file:
            footer, footer_at = _read_footer(file)
            first_at = part.begins_at + len(_MAGIC)
            moved = self._at - len(_MAGIC)
            self._footer = self._footer or footer
            for group in footer[_ROW_GROUPS].value.values:
                _move(group, moved)
                group.pop(_ORDINAL, None)
                if len(self._row_groups) < MOST_NUMBERED:
                    group[_ORDINAL] = Value(I16, len(self._row_groups))
                self._row_groups.append(group)
            self._rows += footer[_ROWS].value
            file.seek(first_at)
            self._at += self._stream.write(file.read(footer_at - first_at))

    def finish(self, metadata: Mapping[str, str]) -> None:
        """Write the footer, with this metadata.

        Raises:
            OSError: it cannot be written.
        """
        texts = [
            {_KEY: Value(BINARY, key.encode()), _VALUE: Value(BINARY, value.encode())}
            for key, value in metadata.items()
        ]
        footer = self._footer | {
            _ROWS: Value(I64, self._rows),
            _ROW_GROUPS: Value(LIST, Elements(STRUCT, self._row_groups)),
            _KEY_VALUES: Value(LIST, Elements(STRUCT, texts)),
        }
        packed = write_struct(footer)
        self._stream.write(packed + len(packed).to_bytes(_LENGTH_BYTES, "little") + _MAGIC)


def _read_footer(file: BinaryIO | pa.NativeFile) -> tuple[Struct, int]:
    """Return the footer of a Parquet file and its offset."""
    end = file.seek(-_LENGTH_BYTES - len(_MAGIC), io.SEEK_END)
    length = int.from_bytes(file.read(_LENGTH_BYTES), "little")
    file.seek(end - length)
    return read_struct(file.read(length)), end - length


def _move(group: Struct, by: int) -> None:
    """Move the offsets of a row group; 0 stands for one that is not told."""
    _move_fields(group, (_GROUP_OFFSET,), by)
    for chunk in group[_COLUMNS].value.values:
        _move_fields(chunk, (_CHUNK_OFFSET,), by)
        _move_fields(chunk[_COLUMN].value, _PAGE_OFFSETS, by)


def _move_fields(fields: Struct, numbers: tuple[int, ...], by: int) -> None:
    for number in numbers:
        if number in fields and fields[number].value:
            fields[number] = Value(I64, fields[number].value + by)
