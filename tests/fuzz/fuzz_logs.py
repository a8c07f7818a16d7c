"""Fuzz target `logs`: a database with any journal or `-wal` is read, or refused with one line that names it; no file changes."""

import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import numpy as np
from fuzz_shapes import changed, must_name, shaped, shaped_seeds

from dds_trace.base.errors import TraceError
from dds_trace.extensions.bags.read import read_messages
from dds_trace.extensions.bags.recorded import Condition
from dds_trace.extensions.bags.sqlite_log import _next_sums
from dds_trace.extensions.bags.sqlite_rows import SQLITE_TABLES

PAGE_BYTES, WAL_HEAD_BYTES, FRAME_HEAD_BYTES = 512, 32, 24
MESSAGE = "INSERT INTO messages (topic_id, timestamp, data) VALUES (1, 5, zeroblob(?))"


def unfinished(folder: Path, kind: str) -> tuple[bytes, bytes]:
    """Return a database in the middle of a transaction, and its log."""
    path = folder / f"{kind}.db3"
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute(f"PRAGMA page_size={PAGE_BYTES}")
        database.execute("PRAGMA synchronous=OFF")
        database.executescript(SQLITE_TABLES)
        database.execute("INSERT INTO topics VALUES (1, '/t', 'a/msg/B', 'cdr', '', '')")
        database.execute(f"PRAGMA journal_mode={'WAL' if kind == 'wal' else 'DELETE'}")
        database.execute("PRAGMA cache_size=1")
        database.executemany(MESSAGE, [(40,)] * 12)
        database.execute("BEGIN")
        database.executemany(MESSAGE, [(40,), (900,)])
        content, log = path.read_bytes(), path.with_name(f"{path.name}-{kind}").read_bytes()
        database.execute("ROLLBACK")
    return content, log


def summed(log: bytes) -> bytes:
    """Return a `-wal` with the salts and sums that make each of its frames whole."""
    result = bytearray(log)
    frame_bytes, sums = FRAME_HEAD_BYTES + PAGE_BYTES, struct.unpack_from(">II", log, WAL_HEAD_BYTES - 8)
    for at in range(WAL_HEAD_BYTES, len(log) - frame_bytes + 1, frame_bytes):
        result[at + 8 : at + 16] = log[16:24]
        words = bytes(result[at : at + 8] + result[at + FRAME_HEAD_BYTES : at + frame_bytes])
        sums = next(_next_sums(sums, np.frombuffer(words, "<u4")[None].astype(np.uint32)))
        result[at + 16 : at + FRAME_HEAD_BYTES] = struct.pack(">II", *sums)
    return bytes(result)


class Target:
    def __init__(self, folder: Path) -> None:
        self._good = {kind: unfinished(folder, kind) for kind in ("wal", "journal")}
        self._path = folder / "bag.db3"
        self._shapes = (
            self._wal,
            self._changed_wal,
            self._summed_wal,
            self._journal,
            self._changed_journal,
            self._both,
        )

    def try_input(self, data: bytes) -> None:
        """Read the database that the bytes stand for, and find its files as they were."""
        files = shaped(self._shapes, data)
        for kind in ("", "-wal", "-journal"):
            self._path.with_name(self._path.name + kind).unlink(missing_ok=True)
        for kind, content in files.items():
            self._path.with_name(self._path.name + kind).write_bytes(content)
        try:
            for _ in read_messages(self._path, Condition()):
                pass
        except TraceError as err:
            must_name(self._path, err)
        assert files == {file.name[len("bag.db3") :]: file.read_bytes() for file in self._path.parent.glob("bag.*")}

    def seeds(self) -> dict[str, bytes]:
        (_, wal), (_, journal) = self._good["wal"], self._good["journal"]
        return shaped_seeds(
            self._shapes, {shape: bytes(3) for shape in self._shapes} | {self._wal: wal, self._journal: journal}
        )

    def _wal(self, data: bytes) -> dict[str, bytes]:
        return {"": self._good["wal"][0], "-wal": data}

    def _changed_wal(self, data: bytes) -> dict[str, bytes]:
        return self._wal(changed(self._good["wal"][1], data))

    def _summed_wal(self, data: bytes) -> dict[str, bytes]:
        return self._wal(summed(changed(self._good["wal"][1], data)))

    def _journal(self, data: bytes) -> dict[str, bytes]:
        return {"": self._good["journal"][0], "-journal": data}

    def _changed_journal(self, data: bytes) -> dict[str, bytes]:
        return self._journal(changed(self._good["journal"][1], data))

    def _both(self, data: bytes) -> dict[str, bytes]:
        """Change the database and its two logs, which are of two databases."""
        content, log = self._good["journal"]
        return {"": changed(content, data[::2]), "-journal": log, "-wal": summed(self._good["wal"][1])}
