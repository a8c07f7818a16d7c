"""Limits on what rosbags unpacks of an untrusted bag, which it does without any.

rosbags looks up decompressors by the name of the compression in tables that contain ours while a bag is read.
"""

from __future__ import annotations

import bz2
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any, Protocol

from ..mcapfile.blocks import LARGEST_FILE_RATIO, most_unpacked_bytes
from ..mcapfile.file import MAX_RECORD_BYTES
from .source import ZSTD_MAGIC

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path
    from typing import BinaryIO, Literal


_BZ2_WEIGHT = 4
"""bz2 needs at least three times as long for a byte as lz4."""


class _Decompressor(Protocol):
    @property
    def eof(self) -> bool: ...

    def decompress(self, data: bytes, max_length: int = -1) -> bytes: ...


class _Budget:
    """The bytes that one bag may still unpack to."""

    def __init__(self, bag: Path) -> None:
        files = [bag] if bag.is_file() else [path for path in bag.rglob("*") if path.is_file()]
        self._left_bytes = most_unpacked_bytes(sum(path.stat().st_size for path in files))

    def take(self, size_bytes: int, weight: int = 1) -> None:
        self._left_bytes -= weight * size_bytes
        if self._left_bytes < 0:
            raise ValueError(f"it unpacks to more than {LARGEST_FILE_RATIO // weight} times its size")

    def unpack(self, decompressor: _Decompressor, packed: bytes, weight: int = 1) -> bytes:
        unpacked = decompressor.decompress(packed, MAX_RECORD_BYTES + 1)
        if len(unpacked) > MAX_RECORD_BYTES:
            raise ValueError(f"a piece of it unpacks to more than {MAX_RECORD_BYTES >> 20} MiB")
        if not decompressor.eof:
            raise ValueError("a compressed piece of it is cut off")
        self.take(len(unpacked), weight)
        return unpacked


class _BoundedZstd:
    """The names of `compression.zstd`, or its backport, that rosbags uses."""

    def __init__(self, module: Any, budget: _Budget) -> None:
        self._module = module
        self._budget = budget

    def decompress(self, packed: bytes) -> bytes:
        return self._budget.unpack(self._module.ZstdDecompressor(), packed)

    @contextmanager
    def open(self, file: BinaryIO, mode: Literal["rb"]) -> Iterator[_CountedFile]:
        with self._module.open(file, mode) as unpacked:
            yield _CountedFile(unpacked, self._budget)


class _CountedFile:
    def __init__(self, file: BinaryIO, budget: _Budget) -> None:
        self._file = file
        self._budget = budget

    def read(self, size: int = -1) -> bytes:
        data = self._file.read(size)
        self._budget.take(len(data))
        return data


def _no_qos(_: object) -> list[object]:
    return []


@contextmanager
def bounded_unpacking(bag: Path) -> Iterator[Callable[[bytes], bytes]]:
    """Limit what rosbags unpacks of a bag, and yield a function that unpacks a message that was packed by itself.

    A piece has at most 64 MiB, all of them as much as a trace (`most_unpacked_bytes`). One bag at a time: the tables
    are rosbags' own.
    """
    from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]  # noqa: PLC0415 - a dependency of rosbags, and only bags need it
    from rosbags.rosbag1 import reader as ros1  # noqa: PLC0415
    from rosbags.rosbag2 import reader as ros2  # noqa: PLC0415
    from rosbags.rosbag2 import storage_mcap as mcap  # noqa: PLC0415
    from rosbags.rosbag2 import storage_sqlite3 as sqlite  # noqa: PLC0415

    budget = _Budget(bag)
    zstd = _BoundedZstd(vars(ros2)["zstd"], budget)
    replacements: tuple[tuple[dict[str, Any], dict[str, Any]], ...] = (
        (
            ros1.decompressors,
            {
                "bz2": lambda packed: budget.unpack(bz2.BZ2Decompressor(), packed, _BZ2_WEIGHT),
                "lz4": lambda packed: budget.unpack(LZ4FrameDecompressor(), packed),
            },
        ),
        (
            mcap.DECOMPRESSORS,
            {
                "lz4": lambda packed, _: budget.unpack(LZ4FrameDecompressor(), packed),
                "zstd": lambda packed, _: zstd.decompress(packed),
            },
        ),
        (vars(ros2), {"zstd": zstd}),
        # We use no QoS, and a damaged text must not cost the messages.
        (vars(mcap), {"parse_qos": _no_qos}),
        (vars(sqlite), {"parse_qos": _no_qos}),
    )
    with ExitStack() as stack:
        for table, own in replacements:
            stack.callback(table.update, {name: table[name] for name in own})
            table.update(own)
        yield lambda data: zstd.decompress(data) if data[:4] == ZSTD_MAGIC else data
