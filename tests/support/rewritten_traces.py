"""Real traces rewritten: a relay on another clock, or sessions that say something else."""

import json
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import Writer
from trace_files import string_cdr

Change = Callable[[str, bytes], bytes]


_MONOTONIC_AT = 4 + 16
"""Bytes before `monotonic_ns` in an event: CDR header, run_id, sequence."""


def shift_relay_clock(source: Path, target: Path, clock: Callable[[int], int]) -> None:
    """Copies traces, the relays' monotonic stamps replaced.

    Args:
        source: folder with `.mcap` files at its top.
        target: a new folder.
        clock: what the relay's clock says when the true one says so; both ns.
    """

    def change(topic: str, data: bytes) -> bytes:
        if topic in {"/dds_trace/t3", "/dds_trace/t4"}:
            (true_ns,) = struct.unpack_from("<q", data, _MONOTONIC_AT)
            return data[:_MONOTONIC_AT] + struct.pack("<q", clock(true_ns)) + data[_MONOTONIC_AT + 8 :]
        if topic == "/dds_trace/session" and (session := _json(data))["role"] == "relay":
            return string_cdr(json.dumps(session | {"monotonic_anchor_ns": clock(session["monotonic_anchor_ns"])}))
        return data

    _copy_all(source, target, change)


def rewrite_sessions(source: Path, target: Path, fields: Mapping[str, Any]) -> None:
    def change(topic: str, data: bytes) -> bytes:
        return string_cdr(json.dumps(_json(data) | fields)) if topic == "/dds_trace/session" else data

    _copy_all(source, target, change)


def _copy_all(source: Path, target: Path, change: Change) -> None:
    target.mkdir(parents=True)
    for path in sorted(source.glob("*.mcap")):
        _copy(path, target / path.name, change)


def _copy(source: Path, target: Path, change: Change) -> None:
    with source.open("rb") as read, target.open("wb") as write:
        writer = Writer(write)
        writer.start(profile="ros2", library="rewritten")
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(read).iter_messages():
            if schema is not None and schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas.get(channel.schema_id, 0), channel.metadata
                )
            writer.add_message(
                channels[channel.id],
                message.log_time,
                change(channel.topic, message.data),
                message.publish_time,
                message.sequence,
            )
        writer.finish()


def _json(data: bytes) -> dict[str, Any]:
    (length,) = struct.unpack_from("<I", data, 4)
    held: dict[str, Any] = json.loads(data[8 : 8 + length - 1])
    return held
