"""The kinds of files that recordings of other programs have: one row each."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

from dds_trace.tracefile.format.encoding import MAGIC

BAG1_MAGIC = b"#ROSBAG V2.0\n"
SQLITE_MAGIC = b"SQLite format 3\0"

BLOCK_BYTES = 1 << 20
"""Read, searched or packed at a time: more is not faster."""

MOST_TEXT_BYTES = 16 << 20
"""Longest definition or list of topics: a thousand topics with the QoS of ten publishers each have 6 MB."""


@dataclass(frozen=True, slots=True)
class RecordingKind:
    """A kind of file; `read` and `recover` are `module:function` below this package.

    Attributes:
        name: with its article.
        suffix: of its files.
        magic: the first bytes of its files.
        read: a function of a path and a `Condition` that yields a `MessageBatch` at a time.
        recover: a function of a path and a `NewFile` to write that returns the damages and the number of doubtful messages.
        endings: of further files, packed or unfinished.
        storage: its name in a `metadata.yaml`.
    """

    name: str
    suffix: str
    magic: bytes
    read: str
    recover: str
    endings: tuple[str, ...] = ()
    storage: str = "mcap"


RECORDING_KINDS = (
    RecordingKind("MCAP", ".mcap", MAGIC, "read:mcap_batches", "recover:recover_mcap", (".mcap.zstd",)),
    RecordingKind(
        "a ROS 1 bag", ".bag", BAG1_MAGIC, "bag1:bag1_batches", "recover:recover_bag1", endings=(".bag.active",)
    ),
    RecordingKind(
        "a SQLite database",
        ".db3",
        SQLITE_MAGIC,
        "sqlite_rows:sqlite_batches",
        "recover:recover_sqlite",
        endings=(".db3.zstd",),
        storage="sqlite3",
    ),
)

*_FIRST, _LAST = (kind.suffix for kind in RECORDING_KINDS)
SUFFIX_WORDS = f"{', '.join(_FIRST)} or {_LAST}"


def function_at(home: str) -> Any:
    module, _, name = home.partition(":")
    return getattr(import_module(f"{__package__}.{module}"), name)
