"""Rows on their way from a worker process: in a file that the analysis maps into memory and removes, in place of a pipe.

Through a pipe each column is copied four times, by both processes, which took a quarter of the processor time of an analysis whose
details were known.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pyarrow as pa

from dds_trace.tracefile import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path


@dataclass(frozen=True, slots=True)
class RowFile:
    """Tables of one schema in a file of our own; it is gone once they were taken.

    Attributes:
        path: the file, of Arrow's stream format; None without a table.
    """

    path: Path | None

    @classmethod
    def of(cls, tables: Iterable[pa.Table], folder: Path) -> RowFile:
        """Put tables into a new file of a folder.

        Raises:
            OutputError: it cannot be written.
        """
        tables = iter(tables)
        first = next(tables, None)
        if first is None:
            return cls(None)
        path = folder / f"{secrets.token_hex(8)}.rows"
        try:
            with pa.OSFile(str(path), "wb") as file, pa.ipc.new_stream(file, first.schema) as stream:
                stream.write_table(first)
                for table in tables:
                    stream.write_table(table)
        except OSError as err:
            raise OutputError(f"rows cannot be kept ({err}); give a larger folder with TMPDIR") from err
        return cls(path)

    def __iter__(self) -> Iterator[pa.Table]:
        """Yield the tables, once; they stay in memory as long as somebody has them."""
        if self.path is None:
            return
        with pa.memory_map(str(self.path)) as file:
            self.path.unlink()
            for batch in pa.ipc.open_stream(file):
                yield pa.Table.from_batches([batch])
