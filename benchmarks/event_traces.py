"""Large traces for benchmarks, built with numpy in seconds and independent of the recorder's sink.

The content is like a ping's: T1 and T2 alternate, times have jitter, so that it packs about as well as a real trace. The relay
of such a ping has a device of its own, whose clock is ahead and drifts.
"""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING, Any

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, ChunkIndex, DataEnd, Footer, Header, Schema, Statistics

from dds_trace.tracefile.format.descriptions import Qos, Run, Session
from dds_trace.tracefile.format.encoding import CDR_HEADER, encode_string
from dds_trace.tracefile.format.events import (
    EVENT_DEFINITION,
    EVENT_DTYPE,
    EVENT_SCHEMA_NAME,
    RUN_TOPIC,
    SESSION_TOPIC,
    Stage,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

MAGIC = b"\x89MCAP0\r\n"
CHUNK_EVENTS = 11_500  # one MiB, as most writers have it
START_NS = 1_700_000_000_000_000_000
MESSAGE_DTYPE = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("number", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
        ("cdr", f"V{len(CDR_HEADER)}"),
        *((name, EVENT_DTYPE[name]) for name in EVENT_DTYPE.names or ()),
    ]
)
STAGES = (Stage.T1, Stage.T2)
EVENT_CHANNELS = (1, 2)
RELAY_ID = 0xBEEF
PERIOD_NS = 1_000_000
RELAY_AHEAD_NS, RELAY_DRIFT_PPM = 3_000_000, 2

PACKERS: dict[str, Callable[[bytes], bytes]] = {
    "zstd": zstandard.ZstdCompressor().compress,
    "lz4": lz4.frame.compress,
    "": bytes,
}


def write_event_trace(
    path: Path,
    events: int,
    compression: str,
    *,
    runs: int = 10,
    seed: int = 7,
    relay: bool = False,
    first_run: int = 0,
    groups: int = 1,
    period_ns: int = PERIOD_NS,
    first_ns: int = 0,
) -> Path:
    """Write a closed, indexed ping trace of `events` events, half T1 and half T2, spread evenly over `runs` runs.

    Args:
        path: the file, overwritten.
        events: how many.
        compression: `zstd`, `lz4` or empty.
        runs: run ids that appear, one after the other.
        seed: of the random times, and the number of the session.
        relay: what the relay of these runs recorded instead, T3 and T4.
        first_run: number of the first run; runs of files that are analyzed together must differ.
        groups: payload sizes that the runs are described with, in turn.
        period_ns: time from one message to the next, at least a millisecond.
        first_ns: when the first message was due, monotonic clock of the ping, whole periods.
    """
    stages = (Stage.T3, Stage.T4) if relay else STAGES
    random = np.random.default_rng(seed)
    indexes: list[ChunkIndex] = []
    with path.open("wb") as stream:
        stream.write(MAGIC + _record(Header("ros2", "dds-trace benchmark")))
        declared = _declarations(stages)
        numbers = range(first_run, first_run if relay else first_run + runs)
        texts = _texts(numbers, seed, groups, period_ns, relay=relay)
        text = _chunk(stream.tell(), declared + texts, compression)
        stream.write(text[0])
        indexes.append(text[1])
        for start in range(0, events, CHUNK_EVENTS):
            count = min(CHUNK_EVENTS, events - start)
            messages = _messages(start, count, max(1, events // runs), random, period_ns, first_ns)
            messages["run_id"] += np.uint64(first_run)
            if relay:
                _become_relayed(messages, period_ns)
            data, chunk_index = _chunk(stream.tell(), messages.tobytes(), compression, messages)
            stream.write(data)
            indexes.append(chunk_index)
        stream.write(_record(DataEnd(0)))
        start = stream.tell()
        channel_counts = {1: events - events // 2, 2: events // 2, 3: 1, 4: len(numbers)}
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(channel_counts),
            channel_message_counts=channel_counts,
            chunk_count=len(indexes),
            message_count=sum(channel_counts.values()),
            message_end_time=max(index.message_end_time for index in indexes),
            message_start_time=START_NS,
            metadata_count=0,
            schema_count=2,
        )
        summary = declared + _record(statistics) + b"".join(_record(index) for index in indexes)
        footer = _record(Footer(summary_start=start, summary_offset_start=0, summary_crc=0))[:-4]
        stream.write(summary + footer + struct.pack("<I", zlib.crc32(summary + footer)) + MAGIC)
    return path


def _messages(
    start: int, count: int, events_per_run: int, random: np.random.Generator, period_ns: int, first_ns: int
) -> np.ndarray[Any, Any]:
    number = np.arange(start, start + count)
    is_reply = number % 2 == 1
    due_ns = first_ns + number // 2 * period_ns + 500_000 * is_reply
    messages = np.zeros(count, MESSAGE_DTYPE)
    messages["opcode"] = 5
    messages["length"] = MESSAGE_DTYPE.itemsize - 9
    messages["channel"] = 1 + number % 2
    messages["number"] = number // 2
    messages["cdr"] = np.void(CDR_HEADER)
    messages["run_id"] = 0x5DEECE66D1234567 + number // events_per_run
    messages["sequence"] = number % events_per_run // 2
    jitter = random.integers(0, 200_000, count)
    messages["monotonic_ns"] = due_ns + jitter
    messages["scheduled_ns"] = np.where(is_reply, 0, due_ns)
    messages["source_ns"] = np.where(is_reply, START_NS + due_ns + jitter - random.integers(0, 99_000, count), 0)
    messages["received_ns"] = np.where(is_reply, messages["source_ns"] + random.integers(0, 50_000, count), 0)
    messages["payload_bytes"] = 33_000
    messages["relay_id"] = np.where(is_reply, RELAY_ID, 0)
    messages["log_time"] = messages["publish_time"] = START_NS + messages["monotonic_ns"]
    return messages


def _become_relayed(messages: np.ndarray[Any, Any], period_ns: int) -> None:
    """Make T3 and T4 of T1 and T2, between them: these lie at 0 to 0.2 ms and at 0.5 to 0.7 ms of their period."""
    time_ns = messages["monotonic_ns"]
    passed_ns = time_ns % period_ns
    inside_ns = time_ns - passed_ns + 210_000 + passed_ns % 500_000 // 4 + 100_000 * (passed_ns >= 500_000)
    messages["monotonic_ns"] = inside_ns + RELAY_AHEAD_NS + inside_ns * RELAY_DRIFT_PPM // 1_000_000
    messages["relay_id"] = RELAY_ID
    messages["scheduled_ns"] = 0


def _chunk(
    offset: int, content: bytes, compression: str, messages: np.ndarray[Any, Any] | None = None
) -> tuple[bytes, ChunkIndex]:
    packed = PACKERS[compression](content)
    first = last = START_NS
    by_channel: dict[int, Any] = {}
    if messages is not None:
        by_channel = {channel: np.flatnonzero(messages["channel"] == channel) for channel in EVENT_CHANNELS}
        first, last = int(messages["log_time"].min()), int(messages["log_time"].max())
    name = compression.encode()
    body = struct.pack("<QQQII", first, last, len(content), zlib.crc32(content), len(name)) + name
    body += struct.pack("<Q", len(packed)) + packed
    chunk = struct.pack("<BQ", 6, len(body)) + body
    parts = [chunk]
    offsets = {}
    at = offset + len(chunk)
    for channel, index in by_channel.items():
        entries = np.empty((len(index), 2), "<u8")
        entries[:, 0] = messages["log_time"][index] if messages is not None else 0
        entries[:, 1] = index * MESSAGE_DTYPE.itemsize
        offsets[channel] = at
        parts.append(struct.pack("<BQHI", 7, 6 + entries.nbytes, channel, entries.nbytes) + entries.tobytes())
        at += len(parts[-1])
    index = ChunkIndex(
        chunk_length=len(chunk),
        chunk_start_offset=offset,
        compression=compression,
        compressed_size=len(packed),
        message_end_time=last,
        message_index_length=at - offset - len(chunk),
        message_index_offsets=offsets,
        message_start_time=first,
        uncompressed_size=len(content),
    )
    return b"".join(parts), index


def _declarations(stages: tuple[Stage, Stage]) -> bytes:
    topics = [stage.topic for stage in stages] + [SESSION_TOPIC, RUN_TOPIC]
    schemas = [
        Schema(id=1, name=EVENT_SCHEMA_NAME, encoding="ros2msg", data=EVENT_DEFINITION.encode()),
        Schema(id=2, name="std_msgs/msg/String", encoding="ros2msg", data=b"string data\n"),
    ]
    channels = [
        Channel(
            id=number,
            topic=topic,
            message_encoding="cdr",
            metadata={},
            schema_id=1 if number <= len(EVENT_CHANNELS) else 2,
        )
        for number, topic in enumerate(topics, start=1)
    ]
    return b"".join(_record(record) for record in [*schemas, *channels])


def _texts(runs: range, seed: int, groups: int, period_ns: int, *, relay: bool) -> bytes:
    session = Session(
        session_id=seed,
        role="relay" if relay else "ping",
        device="bench-relay" if relay else "bench-ping",
        backend="ros2",
        vendor="fastdds",
        rmw=None,
        domain_id=5,
        relay_id=RELAY_ID if relay else None,
        connectivity="loopback",
        wall_anchor_ns=START_NS,
        monotonic_anchor_ns=0,
        state="closed",
    )
    described = [
        Run(
            0x5DEECE66D1234567 + number,
            "binary",
            33_000 + number % groups,
            1e9 / period_ns,
            1,
            0,
            qos=Qos(),
            extra={"session_id": f"{seed:016x}"},
        )
        for number in runs
    ]
    return b"".join(
        [_text(3, 0, session.to_json()), *(_text(4, number, run.to_json()) for number, run in enumerate(described))]
    )


def _text(channel: int, number: int, text: str) -> bytes:
    body = struct.pack("<HIQQ", channel, number, START_NS, START_NS) + encode_string(text)
    return struct.pack("<BQ", 5, len(body)) + body


def _record(record: Any) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())
