"""Fuzz target `bag1`: ROS 1 bags put together from pieces of records, read to their end or refused with one line, in linear work."""

import struct
from pathlib import Path

from bags import ROS1, chunk, record, text, write_bag1
from fuzz_shapes import changed, must_name, shaped, shaped_seeds
from rosbags.rosbag1 import Writer

from dds_trace.base.errors import TraceError
from dds_trace.extensions.bags import bag1
from dds_trace.extensions.bags.read import read_messages
from dds_trace.extensions.bags.recorded import Condition

MOST_TRIES = 4
"""Tries of a record for each byte; a byte is met when it is searched, when it begins a record, and when one ends before it."""


ABOUT = b"\x14\0\0\0type=std_msgs/String"
MESSAGE = record(b"\1\0\0\0x", op=b"\2", conn=bytes(4), time=bytes(8))
PIECES = (
    *(struct.pack("<I", value) for value in (0, 4, 8, 13, 16, 44, 60, 255, 2**16, 2**31)),
    *(b"op=\2", b"op=\5", b"op=\7", b"conn=abcd", b"time=abcdefgh", b"compression=none", b"size=\20\0\0\0", b"a="),
    *(MESSAGE, MESSAGE[:-5], chunk(MESSAGE), chunk(MESSAGE)[:-9], chunk(chunk(MESSAGE))),
    record(ABOUT, op=b"\7", conn=bytes(4), topic=b"/t"),
    record(bytes(90), op=b"\5", compression=b"lz4", size=b"\0\1\0\0"),
    record(bytes(90), op=b"\5", compression=b"bz2", size=b"\0\1\0\0"),
)


class Target:
    def __init__(self, folder: Path) -> None:
        self._path = folder / "x.bag"
        messages = {"/t": [text("hello", ROS1), text("there", ROS1)]}
        self._good = {
            packed: write_bag1(folder / f"{packed}.bag", messages, packed).read_bytes()
            for packed in (None, Writer.CompressionFormat.LZ4, Writer.CompressionFormat.BZ2)
        }
        self._shapes = (
            self._pieces,
            self._in_chunk,
            self._in_chunks,
            self._changed,
            self._changed_lz4,
            self._changed_bz2,
        )

    def try_input(self, data: bytes) -> None:
        """Read the bag that the bytes stand for."""
        content, tries = shaped(self._shapes, data), 0
        self._path.write_bytes(content)
        record_at = bag1._Bag1Walk._record_at

        def counted(walk, source, at):
            nonlocal tries
            tries += 1
            return record_at(walk, source, at)

        bag1._Bag1Walk._record_at = counted  # type: ignore[method-assign]
        try:
            for _ in read_messages(self._path, Condition()):
                pass
        except TraceError as err:
            must_name(self._path, err)
        finally:
            bag1._Bag1Walk._record_at = record_at  # type: ignore[method-assign]
        assert tries <= MOST_TRIES * len(content) + 100, (tries, len(content))

    def seeds(self) -> dict[str, bytes]:
        return shaped_seeds(self._shapes, {shape: bytes(range(len(PIECES))) for shape in self._shapes})

    def _pieces(self, data: bytes) -> bytes:
        return bag1.BAG1_MAGIC + b"".join(PIECES[byte % len(PIECES)] for byte in data)

    def _in_chunk(self, data: bytes) -> bytes:
        return bag1.BAG1_MAGIC + chunk(self._pieces(data)[len(bag1.BAG1_MAGIC) :])

    def _in_chunks(self, data: bytes) -> bytes:
        """The first byte is a depth."""
        inner = self._pieces(data[1:])[len(bag1.BAG1_MAGIC) :]
        for _ in range(data[0] if data else 0):
            inner = chunk(inner)
        return bag1.BAG1_MAGIC + inner

    def _changed(self, data: bytes) -> bytes:
        return changed(self._good[None], data)

    def _changed_lz4(self, data: bytes) -> bytes:
        return changed(self._good[Writer.CompressionFormat.LZ4], data)

    def _changed_bz2(self, data: bytes) -> bytes:
        return changed(self._good[Writer.CompressionFormat.BZ2], data)
