"""Fuzz target `reader`: whatever bytes lie on disk, `read_trace` gives a usable trace or a `TraceError` that names the file."""

import shutil
import sqlite3
import struct
import zlib
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path

import lz4.frame
import zstandard
from event_cdr import pack_event
from fuzz_shapes import changed, must_name, shaped, shaped_seeds
from mcap.opcode import Opcode
from trace_files import Message, ping_events, ping_session, run, string_cdr, write_trace

from dds_trace.base.errors import TraceError
from dds_trace.tracefile.format.encoding import MAGIC
from dds_trace.tracefile.format.events import EventColumns, Stage
from dds_trace.tracefile.format.ring import ring_path
from dds_trace.tracefile.reading.reader import iter_event_batches, read_trace, read_trace_in_pieces
from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def chunk(content: bytes, compression: bytes, packed: bytes) -> bytes:
    fields = struct.pack("<QQQII", 0, 0, len(content), zlib.crc32(content), len(compression)) + compression
    return record(Opcode.CHUNK, fields + struct.pack("<Q", len(packed)) + packed)


def finished(data_section: bytes) -> bytes:
    header = record(Opcode.HEADER, struct.pack("<II", 0, 0))
    end = record(Opcode.DATA_END, bytes(4)) + record(Opcode.FOOTER, bytes(20))
    return MAGIC + header + data_section + end + MAGIC


def small_database(path: Path) -> bytes:
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("PRAGMA page_size = 512")
        connection.execute("CREATE TABLE topics (id INTEGER PRIMARY KEY, name, type, serialization_format)")
        connection.execute("CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, data BLOB)")
        kind = "dds_trace_msgs/msg/TraceEvent"
        connection.execute("INSERT INTO topics VALUES (1, '/dds_trace/t1', ?, 'cdr')", [kind])
        events = [(1, n, pack_event(1, n, n)) for n in range(20)]
        connection.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", events)
    return path.read_bytes()


def small_ring(folder: Path) -> bytes:
    """The ring of a recorder that has written nothing of its eight events yet."""
    sink = TraceSink(TraceDestination(folder / "live.mcap", ring_slots=16), ping_session())
    for number in range(8):
        sink.record(1, 1, number, number)
    ring = ring_path(folder / "live.mcap").read_bytes()
    sink.close()
    return ring


class Target:
    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._path = folder / "t.mcap"
        self._good = write_trace(
            folder / "seed.mcap",
            ping_session(),
            [run()],
            ping_events([Message(n, t0=n, t1=n + 1, t2=n + 2) for n in range(40)]),
            host=[{"cpu": 1}],
            chunk_bytes=1000,
        ).read_bytes()
        self._shapes = (
            self._file,
            self._cut_file,
            self._changed_file,
            self._plain_chunk,
            self._zstd_chunk,
            self._frame,
            self._session,
            self._ring,
            self._database,
            self._packed_file,
        )

    def try_input(self, data: bytes) -> None:
        """Read the file that the bytes stand for; every way of reading has to come to the same end."""
        shutil.rmtree(self._folder / "bag", ignore_errors=True)
        ring_path(self._path).unlink(missing_ok=True)
        read_every_way(shaped(self._shapes, data))

    def seeds(self) -> dict[str, bytes]:
        plain = write_trace(
            self._folder / "plain.mcap",
            ping_session(),
            [run()],
            ping_events([Message(n, t1=n) for n in range(20)]),
            compression="none",
            chunked=False,
            indexed=False,
        ).read_bytes()
        records = plain[len(MAGIC) :]
        of_shapes = {
            self._ring: small_ring(self._folder),
            self._database: small_database(self._folder / "seed.db3"),
            self._file: self._good,
            self._cut_file: (2000).to_bytes(2, "little") + self._good[2000:],
            self._changed_file: bytes(30),
            self._plain_chunk: records,
            self._zstd_chunk: records,
            self._frame: struct.pack("<I", len(records)) + zstandard.compress(records),
            self._session: ping_session().to_json().encode(),
            self._packed_file: zstandard.compress(self._good),
        }
        return {**shaped_seeds(self._shapes, of_shapes), "raw": bytes([0]) + plain}

    def _file(self, data: bytes) -> Path:
        self._path.write_bytes(data)
        return self._path

    def _cut_file(self, data: bytes) -> Path:
        """The bytes come behind the beginning of a good file, cut where the first two say."""
        return self._file(self._good[: int.from_bytes(data[:2], "little") % len(self._good)] + data[2:])

    def _changed_file(self, data: bytes) -> Path:
        return self._file(changed(self._good, data))

    def _plain_chunk(self, data: bytes) -> Path:
        return self._file(finished(chunk(data, b"", data)))

    def _zstd_chunk(self, data: bytes) -> Path:
        """The bytes are a chunk's records, packed; behind them a chunk of good ones."""
        hostile = chunk(data, b"zstd", zstandard.compress(data))
        return self._file(finished(hostile + chunk(b"", b"lz4", lz4.frame.compress(b""))))

    def _frame(self, data: bytes) -> Path:
        """The bytes are a compressed frame, which a chunk claims to hold what the first four say."""
        compression = (b"zstd", b"lz4")[len(data) % 2]
        fields = struct.pack("<QQ", 0, 0) + data[:4].ljust(8, b"\0")
        fields += struct.pack("<II", 0, len(compression)) + compression
        packed = data[4:]
        return self._file(finished(record(Opcode.CHUNK, fields + struct.pack("<Q", len(packed)) + packed)))

    def _session(self, data: bytes) -> Path:
        text = data.decode(errors="surrogateescape").encode(errors="replace").decode(errors="replace")
        channel = struct.pack("<HHI", 1, 0, 18) + b"/dds_trace/session" + struct.pack("<I", 3) + b"cdr"
        message = struct.pack("<HIQQ", 1, 0, 0, 0) + string_cdr(text)
        declared = record(Opcode.CHANNEL, channel + bytes(4))
        return self._file(finished(declared + record(Opcode.MESSAGE, message)))

    def _ring(self, data: bytes) -> Path:
        ring_path(self._path).write_bytes(data)
        return self._file(self._good[:-500])

    def _database(self, data: bytes) -> Path:
        return self._bag("bag_0.db3", data)

    def _packed_file(self, data: bytes) -> Path:
        return self._bag("bag_0.mcap.zstd", data)

    def _bag(self, name: str, data: bytes) -> Path:
        bag = self._folder / "bag"
        bag.mkdir()
        (bag / "metadata.yaml").write_text("")
        (bag / name).write_bytes(data)
        return bag


def read_every_way(path: Path) -> None:
    """Read the path as a trace, in pieces and in batches, and hold one against the other."""
    try:
        trace = read_trace(path)
    except TraceError as err:
        must_name(path, err)
        trace = None
    pieces: list[Mapping[Stage, EventColumns]] = []
    try:
        batches = list(iter_event_batches(path))
        read_trace_in_pieces(path, pieces.append)
    except TraceError:
        batches = None
    if trace is not None:
        if batches is None:
            raise AssertionError("a trace that cannot be read in batches, or in pieces")
        for stage in Stage:
            times = trace.events[stage].monotonic_ns.tolist()
            of_stage = [columns for of_batch, columns in batches if of_batch is stage]
            for what, parts in (("batches", of_stage), ("pieces", [piece[stage] for piece in pieces])):
                if EventColumns.concatenate(parts).monotonic_ns.tolist() != times:
                    raise AssertionError(f"{what} hold other events of {stage} than the trace")
