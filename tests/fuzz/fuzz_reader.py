"""Coverage-guided fuzzing of the reader with atheris (`pip install atheris`); not collected by pytest.

    just fuzz 600                                                          # seconds; in memory, leaves nothing
    python tests/fuzz/fuzz_reader.py CORPUS_FOLDER -max_total_time=600     # in TMPDIR; libFuzzer's options

Whatever bytes lie on disk, `read_trace` gives a usable trace or a `TraceError` that names the file; it never crashes,
hangs (more than ten seconds for one input) or takes memory without bound (1 GB). The first byte of an input says what
the others are, because no mutation finds its way through a CRC and a compressed frame by chance. Finds become tests
in `tests/tracefile/reading/test_reader_finds.py`.
"""

from __future__ import annotations

import shutil
import sqlite3
import struct
import sys
import tempfile
import zlib
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import atheris
import lz4.frame
import zstandard

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

with atheris.instrument_imports(include=["dds_trace.tracefile"]):
    from event_cdr import pack_event
    from mcap.opcode import Opcode
    from trace_files import Message, ping_events, ping_session, run, string_cdr, write_trace

    from dds_trace.tracefile import (
        EventColumns,
        Stage,
        TraceDestination,
        TraceError,
        TraceSink,
        iter_event_batches,
        read_trace,
    )
    from dds_trace.tracefile.format.framing import MAGIC
    from dds_trace.tracefile.format.ring import ring_path

if TYPE_CHECKING:
    from collections.abc import Callable

LIMITS = ["-timeout=10", "-rss_limit_mb=1024", "-max_len=16384"]
FOLDER = Path(tempfile.mkdtemp(prefix="fuzz-reader-"))
SEEDS = write_trace(
    FOLDER / "seed.mcap",
    ping_session(),
    [run()],
    ping_events([Message(n, t0=n, t1=n + 1, t2=n + 2) for n in range(40)]),
    host=[{"cpu": 1}],
    chunk_bytes=1000,
).read_bytes()


def record(opcode: int, content: bytes) -> bytes:
    """One record."""
    return struct.pack("<BQ", opcode, len(content)) + content


def chunk(content: bytes, compression: bytes, packed: bytes) -> bytes:
    """A chunk whose CRC is right."""
    fields = struct.pack("<QQQII", 0, 0, len(content), zlib.crc32(content), len(compression)) + compression
    return record(Opcode.CHUNK, fields + struct.pack("<Q", len(packed)) + packed)


def finished(data_section: bytes) -> bytes:
    """A file around a data section, without summary."""
    header = record(Opcode.HEADER, struct.pack("<II", 0, 0))
    end = record(Opcode.DATA_END, bytes(4)) + record(Opcode.FOOTER, bytes(20))
    return MAGIC + header + data_section + end + MAGIC


def as_file(data: bytes) -> Path:
    """The bytes are the whole file."""
    path = FOLDER / "t.mcap"
    path.write_bytes(data)
    return path


def as_cut_file(data: bytes) -> Path:
    """The bytes come behind the beginning of a good file, cut where the first two say."""
    return as_file(SEEDS[: int.from_bytes(data[:2], "little") % len(SEEDS)] + data[2:])


def as_changed_file(data: bytes) -> Path:
    """Pairs of a place and a byte, put into a good file."""
    changed = bytearray(SEEDS)
    for place, byte in struct.iter_unpack("<HB", data[: len(data) // 3 * 3]):
        changed[place % len(changed)] = byte
    return as_file(bytes(changed))


def as_plain_chunk(data: bytes) -> Path:
    """The bytes are a chunk's records."""
    return as_file(finished(chunk(data, b"", data)))


def as_zstd_chunk(data: bytes) -> Path:
    """The bytes are a chunk's records, packed; behind them a chunk of good ones."""
    return as_file(
        finished(chunk(data, b"zstd", zstandard.compress(data)) + chunk(b"", b"lz4", lz4.frame.compress(b"")))
    )


def as_frame(data: bytes) -> Path:
    """The bytes are a compressed frame, which a chunk claims to hold what the first four say."""
    compression = (b"zstd", b"lz4")[len(data) % 2]
    fields = (
        struct.pack("<QQ", 0, 0)
        + data[:4].ljust(8, b"\0")
        + struct.pack("<II", 0, len(compression))
        + compression
    )
    return as_file(finished(record(Opcode.CHUNK, fields + struct.pack("<Q", len(data[4:])) + data[4:])))


def as_session(data: bytes) -> Path:
    """The bytes are the text of a session."""
    text = data.decode(errors="surrogateescape").encode(errors="replace").decode(errors="replace")
    channel = struct.pack("<HHI", 1, 0, 18) + b"/dds_trace/session" + struct.pack("<I", 3) + b"cdr" + bytes(4)
    message = struct.pack("<HIQQ", 1, 0, 0, 0) + string_cdr(text)
    return as_file(finished(record(Opcode.CHANNEL, channel) + record(Opcode.MESSAGE, message)))


def as_ring(data: bytes) -> Path:
    """The bytes are a ring beside a good file that was cut off."""
    (FOLDER / "t.mcap.ring").write_bytes(data)
    return as_file(SEEDS[:-500])


def as_database(data: bytes) -> Path:
    """The bytes are the database of a bag."""
    bag = FOLDER / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_text("")
    (bag / "bag_0.db3").write_bytes(data)
    return bag


def as_packed_file(data: bytes) -> Path:
    """The bytes are a packed storage file of a bag."""
    bag = FOLDER / "bag"
    bag.mkdir()
    (bag / "bag_0.mcap.zstd").write_bytes(data)
    return bag


SHAPES: list[Callable[[bytes], Path]] = [
    as_file,
    as_cut_file,
    as_changed_file,
    as_plain_chunk,
    as_zstd_chunk,
    as_frame,
    as_session,
    as_ring,
    as_database,
    as_packed_file,
]


def read_every_way(path: Path) -> None:
    """All that a user can do with the path; every way has to come to the same end."""
    try:
        trace = read_trace(path)
    except TraceError as err:
        if str(path) not in str(err):
            raise AssertionError(f"the error does not name the file: {err}") from err
        trace = None
    try:
        batches = list(iter_event_batches(path))
    except TraceError:
        batches = None
    if trace is not None:
        if batches is None:
            raise AssertionError("a trace that cannot be read in batches")
        for stage in Stage:
            joined = EventColumns.concatenate([columns for of_stage, columns in batches if of_stage is stage])
            if joined.monotonic_ns.tolist() != trace.events[stage].monotonic_ns.tolist():
                raise AssertionError(f"batches hold other events of {stage} than the trace")


def test_one_input(data: bytes) -> None:
    """What libFuzzer calls."""
    if not data:
        return
    shutil.rmtree(FOLDER / "bag", ignore_errors=True)
    (FOLDER / "t.mcap.ring").unlink(missing_ok=True)
    read_every_way(SHAPES[data[0] % len(SHAPES)](data[1:]))


def write_seeds(corpus: Path) -> None:
    """One good input of each shape that has any."""
    corpus.mkdir(parents=True, exist_ok=True)
    plain = write_trace(
        FOLDER / "plain.mcap",
        ping_session(),
        [run()],
        ping_events([Message(n, t1=n) for n in range(20)]),
        compression="none",
        chunked=False,
        indexed=False,
    ).read_bytes()
    records = plain[len(MAGIC) :]
    database = FOLDER / "seed.db3"
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute("PRAGMA page_size = 512")
        connection.execute("CREATE TABLE topics (id INTEGER PRIMARY KEY, name, type, serialization_format)")
        connection.execute("CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, data BLOB)")
        kind = "dds_trace_msgs/msg/TraceEvent"
        connection.execute("INSERT INTO topics VALUES (1, '/dds_trace/t1', ?, 'cdr')", [kind])
        events = [(1, n, pack_event(1, n, n)) for n in range(20)]
        connection.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", events)
    sink = TraceSink(TraceDestination(FOLDER / "live.mcap", ring_slots=16), ping_session())
    for number in range(8):
        sink.record(1, 1, number, number)
    ring = ring_path(FOLDER / "live.mcap").read_bytes()
    sink.close()
    seeds = {
        as_ring: ring,
        as_database: database.read_bytes(),
        as_file: SEEDS,
        as_cut_file: (2000).to_bytes(2, "little") + SEEDS[2000:],
        as_changed_file: bytes(30),
        as_plain_chunk: records,
        as_zstd_chunk: records,
        as_frame: struct.pack("<I", len(records)) + zstandard.compress(records),
        as_session: ping_session().to_json().encode(),
        as_packed_file: zstandard.compress(SEEDS),
    }
    for shape, data in seeds.items():
        (corpus / f"seed-{shape.__name__}").write_bytes(bytes([SHAPES.index(shape)]) + data)
    (corpus / "seed-raw").write_bytes(bytes([0]) + plain)


if __name__ == "__main__":
    folders = [Path(argument) for argument in sys.argv[1:] if not argument.startswith("-")]
    if folders and not folders[0].is_file():  # a file is a find to be tried again
        write_seeds(folders[0])
    atheris.Setup([sys.argv[0], *LIMITS, *sys.argv[1:]], test_one_input)
    atheris.Fuzz()
