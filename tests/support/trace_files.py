"""Traces for tests, drawn by hand as timelines and written with the public `mcap` writer (not with our sink).

    write_pair(tmp_path, [Message(0, t0=0, t1=5, t3=100, t4=130, t2=250), Message(1, t0=1000, t1=1004)])

gives `ping.mcap` and `relay.mcap` of one run: message 0 came back, message 1 was lost. For anything else:
`write_trace` with events of each stage made by `event`.
"""

import json
import os
import shutil
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from event_cdr import pack_event
from mcap.writer import CompressionType, IndexType, Writer

from dds_trace.tracefile.format.descriptions import Run, Session
from dds_trace.tracefile.format.encoding import STRING_DEFINITION, STRING_SCHEMA_NAME
from dds_trace.tracefile.format.events import (
    EVENT_DEFINITION,
    EVENT_SCHEMA_NAME,
    HOST_TOPIC,
    RUN_TOPIC,
    SESSION_TOPIC,
    WIRE_TOPIC,
    Stage,
)

SAMPLES = Path(__file__).parents[2] / "sample_traces"
SAMPLE_NAMES = ["different_domains", "losses", "same_domain"]

PING_SESSION_ID = 0x00000000000000A1
RELAY_SESSION_ID = 0x00000000000000B2
RUN_ID = 0x1122334455667788
RELAY_ID = 0x0000BEEF
WALL_ANCHOR_NS = 1_700_000_000_000_000_000
"""Wall clock at the instant 0 of the monotonic clock, on both devices, so that timelines may start at 0."""

Event = tuple[int, int, int, int, int, int, int, int]
"""The eight fields in the order of `EVENT_DTYPE`."""

EVENT = (EVENT_SCHEMA_NAME, EVENT_DEFINITION)
STRING = (STRING_SCHEMA_NAME, STRING_DEFINITION)
COMPRESSIONS = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}


def ping_session(**changes: Any) -> Session:
    """A closed ping session on ROS 2 / Fast DDS in domain 5, with `changes` to its fields."""
    session = Session(
        session_id=PING_SESSION_ID,
        role="ping",
        device="alpha",
        backend="ros2",
        vendor="fastdds",
        rmw="rmw_fastrtps_cpp",
        domain_id=5,
        relay_id=None,
        connectivity="loopback",
        wall_anchor_ns=WALL_ANCHOR_NS,
        monotonic_anchor_ns=0,
        state="closed",
    )
    return replace(session, **changes)


def relay_session(**changes: Any) -> Session:
    """A closed relay session (`RELAY_ID`) on ROS 2 / Fast DDS in domain 10, with `changes` to its fields."""
    return replace(
        ping_session(),
        **{
            "session_id": RELAY_SESSION_ID,
            "role": "relay",
            "device": "beta",
            "domain_id": 10,
            "relay_id": RELAY_ID,
            **changes,
        },
    )


def run(**changes: Any) -> Run:
    """A finished run: binary 33 KB at 10 Hz, 10 messages, no warm-up, relay in domain 10; with `changes`."""
    described = Run(
        run_id=RUN_ID,
        data_type="binary",
        payload_bytes=33_000,
        rate_hz=10.0,
        planned_messages=10,
        warmup_messages=0,
        relay_domain_id=10,
        published=10,
        state="finished",
        extra={"session_id": f"{PING_SESSION_ID:016x}"},
    )
    return replace(described, **changes)


def event(
    sequence: int,
    monotonic_ns: int,
    *,
    run_id: int = RUN_ID,
    scheduled_ns: int = 0,
    source_ns: int = 0,
    received_ns: int = 0,
    payload_bytes: int = 33_000,
    relay_id: int = 0,
) -> Event:
    return (run_id, sequence, monotonic_ns, scheduled_ns, source_ns, received_ns, payload_bytes, relay_id)


@dataclass(frozen=True)
class Message:
    """One ping message's timeline in ns; T0, T1 and T2 on ping's clock, T3 and T4 on relay's, None = did not happen."""

    sequence: int
    t0: int = 0
    t1: int | None = None
    t3: int | None = None
    t4: int | None = None
    t2: int | None = None

    def lost(self) -> "Message":
        return replace(self, t2=None, t3=None, t4=None)


TWELVE = [Message(s, t0=1000 * s, t1=1000 * s + 5, t3=900, t4=930, t2=1000 * s + 205) for s in range(12)]
"""The messages of a recording where only their number counts."""


def evenly(
    ways_ns: Iterable[int], *, start_ns: int = 0, period_ns: int = 100_000_000, relay_ns: int = 0
) -> list[Message]:
    """One message a period, sent on time; each takes its way there and back, and its time in the relay."""
    return [
        Message(s, t0=t, t1=t, t3=t + way, t4=t + way + relay_ns, t2=t + 2 * way + relay_ns)
        for s, way in enumerate(ways_ns)
        for t in [start_ns + s * period_ns]
    ]


def sound(count: int = 1000, period_ns: int = 100_000_000) -> list[Message]:
    """One message a period that takes about 1 us, by two clocks that are apart."""
    return [
        Message(s, t0=t, t1=t + 50, t3=t, t4=t + 20, t2=t + 1000 + s % 7) for s in range(count) for t in [s * period_ns]
    ]


def ping_events(messages: Iterable[Message], **fields: int) -> dict[Stage, list[Event]]:
    """What the ping records of `messages`; `fields` (run_id, relay_id, payload_bytes) go into every event."""
    held = list(messages)
    sent = {name: value for name, value in fields.items() if name != "relay_id"}
    back = {"relay_id": RELAY_ID, **fields}
    return {
        Stage.T1: [event(m.sequence, m.t1, scheduled_ns=m.t0, **sent) for m in held if m.t1 is not None],
        Stage.T2: [event(m.sequence, m.t2, **back) for m in held if m.t2 is not None],
    }


def relay_events(messages: Iterable[Message], **fields: int) -> dict[Stage, list[Event]]:
    held = list(messages)
    stamp = {"relay_id": RELAY_ID, **fields}
    return {
        Stage.T3: [event(m.sequence, m.t3, **stamp) for m in held if m.t3 is not None],
        Stage.T4: [event(m.sequence, m.t4, **stamp) for m in held if m.t4 is not None],
    }


def write_pair(
    folder: Path,
    messages: Sequence[Message],
    *,
    ping: Session | Sequence[Session] | None = None,
    relay: Session | None = None,
    runs: Sequence[Run] | None = None,
    host: Sequence[Mapping[str, Any]] = (),
) -> tuple[Path, Path]:
    """Write `ping.mcap`, with its host samples, and `relay.mcap` of one run and give their paths."""
    held = [run(planned_messages=len(messages), published=len(messages))] if runs is None else runs
    fields = {"run_id": held[0].run_id, "payload_bytes": held[0].payload_bytes}
    return (
        write_trace(folder / "ping.mcap", ping or ping_session(), held, ping_events(messages, **fields), host=host),
        write_trace(folder / "relay.mcap", relay or relay_session(), (), relay_events(messages, **fields)),
    )


def merged_events(parts: Iterable[Mapping[Stage, Sequence[Event]]]) -> dict[Stage, list[Event]]:
    merged: dict[Stage, list[Event]] = {}
    for part in parts:
        for stage, events in part.items():
            merged.setdefault(stage, []).extend(events)
    return merged


def write_runs(
    folder: Path,
    recorded: Sequence[tuple[Run, Sequence[Message]]],
    *,
    ping: Session | None = None,
    relay: Session | None = None,
) -> None:
    fields = [{"run_id": run.run_id, "payload_bytes": run.payload_bytes} for run, _ in recorded]
    runs, messages = [run for run, _ in recorded], [messages for _, messages in recorded]
    sent, relayed = (
        merged_events(make(one, **of_run) for one, of_run in zip(messages, fields, strict=True))
        for make in (ping_events, relay_events)
    )
    write_trace(folder / "ping.mcap", ping or ping_session(), runs, sent)
    write_trace(folder / "relay.mcap", relay or relay_session(), (), relayed)


def write_trace(
    path: Path,
    session: Session | Sequence[Session] = (),
    runs: Sequence[Run] = (),
    events: Mapping[Stage, Sequence[Event]] | None = None,
    *,
    host: Sequence[Mapping[str, Any]] = (),
    wire: Sequence[Mapping[str, Any]] = (),
    **stored: Any,
) -> Path:
    """Write one trace: sessions, runs, host samples, then the events of all stages in order of their time.

    Args:
        path: the `.mcap` file; folders above it are made.
        session: one session, or several; the first one's clock anchor makes the `log_time` of events.
        runs: run descriptions, in order.
        events: events of each stage, made by `event`, `ping_events`, `relay_events`. Each stage keeps its order.
        host: JSON objects for `/dds_trace/host`, one a second from time 0 of the monotonic clock.
        wire: JSON objects for `/dds_trace/wire`, at time 0.
        stored: options of `write_messages`.
    """
    sessions = [session] if isinstance(session, Session) else list(session)
    anchor = sessions[0] if sessions else ping_session()
    start_ns = anchor.wall_anchor_ns
    texts = [
        *((SESSION_TOPIC, start_ns, described.to_json()) for described in sessions),
        *((RUN_TOPIC, start_ns, planned.to_json()) for planned in runs),
        *((HOST_TOPIC, anchor.wall_ns(second * 10**9), json.dumps(sample)) for second, sample in enumerate(host)),
        *((WIRE_TOPIC, start_ns, json.dumps(text)) for text in wire),
    ]
    messages = [RawMessage(topic, string_cdr(text), log_time, STRING) for topic, log_time, text in texts]
    for stage, fields in _in_time_order(events or {}):
        messages.append(RawMessage(stage.topic, pack_event(*fields), anchor.wall_ns(fields[2])))
    return write_messages(path, messages, **stored)


@dataclass(frozen=True)
class RawMessage:
    """One message as it is stored; `kind` is its schema's name and text."""

    topic: str
    data: bytes
    log_time_ns: int = WALL_ANCHOR_NS
    kind: tuple[str, str] = EVENT
    encoding: str = "cdr"


def write_messages(
    path: Path,
    messages: Iterable[RawMessage],
    *,
    compression: str = "zstd",
    chunked: bool = True,
    chunk_bytes: int = 1 << 20,
    indexed: bool = True,
    statistics: bool = True,
    crcs: bool = True,
    truncate_at: int | None = None,
) -> Path:
    """Write any messages, one after the other.

    Args:
        path: the `.mcap` file; folders above it are made.
        messages: in the order of the file.
        compression: `zstd`, `lz4` or `none`.
        chunked: False writes bare messages.
        chunk_bytes: size at which a chunk is closed.
        indexed: False leaves out chunk index, message index and the repeated schemas and channels.
        statistics: False leaves out the statistics record.
        crcs: False leaves out the CRCs of chunks and summary.
        truncate_at: keep only so many bytes (negative: cut so many off the end).
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as stream:
        writer = Writer(
            stream,
            chunk_size=chunk_bytes,
            compression=COMPRESSIONS[compression],
            index_types=IndexType.ALL if indexed else IndexType.NONE,
            repeat_channels=indexed,
            repeat_schemas=indexed,
            use_chunking=chunked,
            use_statistics=statistics,
            use_summary_offsets=indexed,
            enable_crcs=crcs,
        )
        writer.start(profile="ros2", library="dds-trace tests")
        schemas: dict[tuple[str, str], int] = {}
        channels: dict[str, int] = {}
        written: Counter[str] = Counter()
        for message in messages:
            if message.kind not in schemas:
                name, definition = message.kind
                schemas[message.kind] = writer.register_schema(name, "ros2msg", definition.encode())
            if message.topic not in channels:
                schema_id = schemas[message.kind]
                channels[message.topic] = writer.register_channel(message.topic, message.encoding, schema_id)
            writer.add_message(
                channels[message.topic],
                log_time=max(message.log_time_ns, 0),
                publish_time=max(message.log_time_ns, 0),
                data=message.data,
                sequence=written[message.topic],
            )
            written[message.topic] += 1
        writer.finish()
    if truncate_at is not None:
        os.truncate(path, truncate_at if truncate_at >= 0 else path.stat().st_size + truncate_at)
    return path


def string_cdr(text: str) -> bytes:
    data = text.encode() + b"\0"
    return b"\x00\x01\x00\x00" + len(data).to_bytes(4, "little") + data


def _in_time_order(events: Mapping[Stage, Sequence[Event]]) -> list[tuple[Stage, Event]]:
    """All events by running time; a stage whose own time runs backwards keeps its order."""
    tagged = []
    for stage, fields_of_stage in events.items():
        latest = None
        for fields in fields_of_stage:
            latest = fields[2] if latest is None else max(latest, fields[2])
            tagged.append((latest, stage, fields))
    return [(stage, fields) for _, stage, fields in sorted(tagged, key=lambda item: item[0])]


def copy_sample(name: str, folder: Path) -> None:
    shutil.copytree(SAMPLES / name, folder, ignore=shutil.ignore_patterns("analysis"), dirs_exist_ok=True)
