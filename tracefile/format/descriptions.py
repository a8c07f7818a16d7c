"""The two JSON descriptions in a trace: `Session` of a recording process, `Run` of a ping's run.

Unknown fields are kept and written back; an error names the file and the missing field.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

from dds_trace.base import limits

from .json_fields import FORMAT_VERSION, DescriptionFields, Json, JsonObject


@dataclass(frozen=True, slots=True)
class Qos:
    """Quality of service of a run's data topics; `extra` has further fields of the JSON object (`deadline_ns`, `lifespan_ns`)."""

    reliability: str = "reliable"
    durability: str = "volatile"
    history: str = "keep_last"
    depth: int = 10
    extra: JsonObject = field(default_factory=dict)

    def to_dict(self) -> dict[str, Json]:
        """Return the JSON object."""
        values = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "extra"}
        return {**values, **self.extra}


@dataclass(frozen=True, slots=True)
class Session:
    """One recording process, described at its start and again at a clean end (docs/trace-format.md).

    Attributes:
        session_id: 64-bit random number, 16 hex digits in the JSON.
        role: `ping`, `relay` or `tap`.
        vendor: the DDS implementation, or `none`.
        rmw: None outside of ROS 2.
        relay_id: None for other roles.
        wall_anchor_ns, monotonic_anchor_ns: one instant in ns since 1970, and of CLOCK_MONOTONIC.
        state: `open` at the start, `closed` at a clean end.
        extra: fields that this version does not know.
    """

    session_id: int
    role: str
    device: str
    backend: str
    vendor: str
    rmw: str | None
    domain_id: int
    relay_id: int | None
    connectivity: str
    wall_anchor_ns: int
    monotonic_anchor_ns: int
    host: JsonObject = field(default_factory=dict)
    dropped_events: int = 0
    state: str = "open"
    extra: JsonObject = field(default_factory=dict)

    def closed(self, dropped_events: int, **extra: Json) -> Session:
        """Return the session at a clean end, with `extra` added."""
        return replace(self, state="closed", dropped_events=dropped_events, extra={**self.extra, **extra})

    def wall_ns(self, monotonic_ns: int) -> int:
        """Convert a monotonic instant of this device to its wall clock (ns since 1970), by the anchor."""
        return self.wall_anchor_ns + (monotonic_ns - self.monotonic_anchor_ns)

    def to_dict(self) -> JsonObject:
        """Return the JSON object stored on `/dds_trace/session`."""
        return _description(self, session_id=f"{self.session_id:016x}", host=dict(self.host))

    def to_json(self) -> str:
        """Return its text."""
        return json.dumps(self.to_dict())

    @classmethod
    def from_json(cls, text: str, path: Path | str) -> Session:
        """Parse the description of a session; `path` names the trace in errors."""
        take = DescriptionFields.parse(text, path, "session")
        return cls(
            session_id=take.hex_id("session_id"),
            role=take.text("role"),
            device=take.text("device"),
            backend=take.text("backend"),
            vendor=take.text("vendor"),
            rmw=take.optional("rmw", str),
            domain_id=take.integer("domain_id", limits.STORED_NUMBER),
            relay_id=take.optional("relay_id", int, limits.STORED_RELAY_ID),
            connectivity=take.text("connectivity"),
            wall_anchor_ns=take.integer("wall_anchor_ns", limits.STORED_TIME_NS),
            monotonic_anchor_ns=take.integer("monotonic_anchor_ns", limits.STORED_TIME_NS),
            host=take.mapping("host"),
            dropped_events=take.integer("dropped_events", limits.STORED_COUNT),
            state=take.text("state"),
            extra=take.rest(),
        )


@dataclass(frozen=True, slots=True)
class Run:
    """One run, described by its ping at its start and at its end (docs/trace-format.md).

    Attributes:
        run_id: 64-bit random number, 16 hex digits in the JSON.
        rate_hz: 0 for messages that left as fast as the middleware took them.
        payload_bytes: application bytes of a message, without the stamp.
        planned_messages: without the warm-up.
        relay_domain_id: as the user gave it; None if unknown.
        serialization: `raw` or `typed`.
        published: with the warm-up; final in state `finished`.
        state: `started` or `finished`.
        extra: fields that this version does not know.
    """

    run_id: int
    data_type: str
    payload_bytes: int
    rate_hz: float
    planned_messages: int
    warmup_messages: int
    bridge: str = "none"
    relay_domain_id: int | None = None
    serialization: str = "raw"
    qos: Qos = field(default_factory=Qos)
    labels: Mapping[str, str] = field(default_factory=dict)
    published: int = 0
    state: str = "started"
    extra: JsonObject = field(default_factory=dict)

    @property
    def history_ns(self) -> float | None:
        """Time for which a reliable history of limited depth keeps a message, None for others."""
        is_limited = self.qos.reliability == "reliable" and self.qos.history == "keep_last"
        return self.qos.depth / self.rate_hz * 1e9 if is_limited and self.rate_hz > 0 else None

    @property
    def ping_every(self) -> int:
        """Every n-th message was to be sent back, from 0 on."""
        ping_every = self.extra.get("ping_every")
        return ping_every if isinstance(ping_every, int) and 1 < ping_every < 1 << 63 else 1

    def finished(self, published: int, **extra: Json) -> Run:
        """Return the run at its end, with `extra` added."""
        return replace(self, state="finished", published=published, extra={**self.extra, **extra})

    def to_json(self) -> str:
        """Return the text stored on `/dds_trace/run`."""
        return json.dumps(
            _description(self, run_id=f"{self.run_id:016x}", qos=self.qos.to_dict(), labels=dict(self.labels))
        )

    @classmethod
    def from_json(cls, text: str, path: Path | str) -> Run:
        """Parse the description of a run; as `Session.from_json`."""
        take = DescriptionFields.parse(text, path, "run")
        qos = take.nested("qos")
        return cls(
            run_id=take.hex_id("run_id"),
            data_type=take.text("data_type"),
            payload_bytes=take.integer("payload_bytes", limits.STORED_BYTES),
            rate_hz=take.number("rate_hz", limits.STORED_RATE_HZ),
            planned_messages=take.integer("planned_messages", limits.STORED_COUNT),
            warmup_messages=take.integer("warmup_messages", limits.STORED_COUNT),
            bridge=take.text("bridge"),
            relay_domain_id=take.optional("relay_domain_id", int, limits.STORED_NUMBER),
            serialization=take.text("serialization"),
            qos=Qos(
                reliability=qos.text("reliability"),
                durability=qos.text("durability"),
                history=qos.text("history"),
                depth=qos.integer("depth", limits.STORED_NUMBER),
                extra=qos.rest(),
            ),
            labels={str(k): str(v) for k, v in take.mapping("labels").items()},
            published=take.integer("published", limits.STORED_COUNT),
            state=take.text("state"),
            extra=take.rest(),
        )


def _description(described: Session | Run, **encoded: Json) -> JsonObject:
    """Return a description's JSON object: format and state, then fields, some of them `encoded`, and the unknown ones."""
    values = {f.name: getattr(described, f.name) for f in fields(described)}
    state, extra = values.pop("state"), values.pop("extra")
    return {"format": FORMAT_VERSION, "state": state, **values, **encoded, **extra}
