"""A trace as the public `mcap` reader gives it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from event_cdr import unpack_event
from mcap.reader import make_reader

if TYPE_CHECKING:
    from pathlib import Path

FIELDS = (
    *("run_id", "sequence", "monotonic_ns", "scheduled_ns", "source_ns", "received_ns"),
    *("payload_bytes", "relay_id"),
)


def events_of(path: Path, stage: str) -> list[dict[str, int]]:
    with path.open("rb") as file:
        messages = make_reader(file, validate_crcs=True).iter_messages([f"/dds_trace/{stage}"])
        return [dict(zip(FIELDS, unpack_event(message.data), strict=True)) for _, _, message in messages]


def records_of(path: Path) -> list[tuple[str, bytes]]:
    """Topic and bytes of every message, in the order of the file."""
    with path.open("rb") as file:
        messages = make_reader(file, validate_crcs=True).iter_messages(log_time_order=False)
        return [(channel.topic, message.data) for _, channel, message in messages]


def last_json(path: Path, name: str) -> dict[str, Any]:
    with path.open("rb") as file:
        messages = make_reader(file, validate_crcs=True).iter_messages([f"/dds_trace/{name}"])
        *_, (_, _, message) = messages
    found: dict[str, Any] = json.loads(message.data[8:].rstrip(b"\0"))
    return found
