"""What taps heard: events of each publisher at each tap, and its record."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from dds_trace.tracefile.format.descriptions import Session
from dds_trace.tracefile.format.events import Stage, TapColumns
from dds_trace.tracefile.format.json_fields import JsonObject, object_of

from ..loading.campaign import Campaign
from ..loading.event_index import EventPart, merge_parts
from .device_clocks import Machine, machine_of_session

TAP_ROLE = "tap"


@dataclass(frozen=True, slots=True, eq=False)
class Heard:
    """One publisher's messages at one tap."""

    session: Session
    topic: str
    message_type: str
    publisher: str
    node: str
    qos: JsonObject
    has_sequence: bool
    is_local: bool | None
    messages: pl.DataFrame
    end_ns: int

    @property
    def machine(self) -> Machine:
        return machine_of_session(self.session)


def has_taps(campaign: Campaign) -> bool:
    return any(session.role == TAP_ROLE for session in campaign.sessions.values())


def heard_by_taps(campaign: Campaign) -> list[Heard]:
    parts: dict[tuple[int, int], list[EventPart]] = defaultdict(list)
    ends: dict[int, int] = defaultdict(int)
    for (stage, _, publisher_id), parts_of_key in campaign.events.items():
        for part in parts_of_key if stage is Stage.TAP else ():
            taps = [session.session_id for session in campaign.traces[part.trace].sessions if session.role == TAP_ROLE]
            session_id = taps[-1] if taps else -1
            parts[session_id, publisher_id].append(part)
            ends[session_id] = max(ends[session_id], part.last_ns)
    records: dict[tuple[int, int], JsonObject] = {}
    for trace in campaign.traces:
        for record in trace.publishers:
            session_id, publisher_id = _number(record.get("session_id"), 16), _number(record.get("publisher_id"), 10)
            records[session_id, publisher_id] = record
            instant_ns = record.get("monotonic_ns")
            if isinstance(instant_ns, int) and session_id in ends:
                ends[session_id] = max(ends[session_id], instant_ns)
    heard = [
        _heard(campaign.sessions[key[0]], records[key], parts_of_publisher, ends[key[0]])
        for key, parts_of_publisher in parts.items()
        if key in records and key[0] in campaign.sessions
    ]
    return sorted(heard, key=lambda stream: (stream.topic, stream.session.session_id, stream.publisher))


def _number(value: Any, base: int) -> int:
    try:
        return int(str(value), base)
    except ValueError:
        return -1


def _heard(session: Session, record: JsonObject, parts: list[EventPart], end_ns: int) -> Heard:
    events = TapColumns.from_events(merge_parts(parts)[0])
    order = np.argsort(events.monotonic_ns, kind="stable")
    columns = {
        "received_ns": events.monotonic_ns,
        **{name: getattr(events, name) for name in ("header_ns", "source_ns", "content_hash")},
        **{name: getattr(events, name) for name in ("publication_sequence", "payload_bytes")},
    }
    return Heard(
        session=session,
        topic=_text(record, "topic"),
        message_type=_text(record, "type"),
        publisher=_text(record, "publisher"),
        node=_text(record, "node"),
        qos=object_of(record.get("qos")),
        has_sequence=record.get("sequence_is_given") is True and bool((events.publication_sequence > 0).all()),
        is_local=is_local if isinstance(is_local := record.get("is_local"), bool) else None,
        messages=pl.DataFrame({name: values[order] for name, values in columns.items()}),
        end_ns=end_ns,
    )


def _text(record: JsonObject, name: str) -> str:
    value = record.get(name)
    return value if isinstance(value, str) else ""
