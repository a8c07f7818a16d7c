"""The two JSON descriptions in a trace: `Session` (a recording process) and `Run` (one cell of a sweep).

Unknown fields are kept and written back; a missing field that we need is an error naming file and field.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from ..errors import TraceFormatError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

FORMAT_VERSION = 1
"""Version 1: first version (2026). The history of the format is kept here."""


@dataclass(frozen=True, slots=True)
class Qos:
    """Quality of service of a run's data topics.

    Attributes:
        reliability: `reliable` or `best_effort`.
        durability: `volatile` or `transient_local`.
        history: `keep_last` or `keep_all`.
        depth: messages kept, for `keep_last`.
        extra: further fields of the trace's JSON (deadline, lifespan), kept as they are.
    """

    reliability: str = "reliable"
    durability: str = "volatile"
    history: str = "keep_last"
    depth: int = 10
    extra: Mapping[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """The JSON object of `docs/trace-format.md`."""
        return {
            "reliability": self.reliability,
            "durability": self.durability,
            "history": self.history,
            "depth": self.depth,
            **self.extra,
        }


@dataclass(frozen=True, slots=True)
class Session:
    """What one recording process says of itself at its start and again at a clean end.

    Attributes:
        session_id: 64-bit random number, 16 hex digits in the JSON.
        role: `ping` or `relay`.
        wall_anchor_ns: ns since 1970 at the instant `monotonic_anchor_ns` of CLOCK_MONOTONIC.
        host: the environment's fingerprint.
        dropped_events: events that the recorder could not keep.
        extra: fields that this version does not know, kept as they are.
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
    host: Mapping[str, Any] = field(default_factory=dict)
    dropped_events: int = 0
    state: str = "open"
    extra: Mapping[str, Any] = field(default_factory=dict)

    def closed(self, dropped_events: int, **extra: Any) -> Session:
        """The same session as it is described at a clean end."""
        return replace(self, state="closed", dropped_events=dropped_events, extra={**self.extra, **extra})

    def wall_ns(self, monotonic_ns: int) -> int:
        """Wall clock (ns since 1970) of an instant of this device's monotonic clock, by the anchor."""
        return self.wall_anchor_ns + (monotonic_ns - self.monotonic_anchor_ns)

    def to_json(self) -> str:
        """The text stored on `/dds_trace/session`."""
        return json.dumps(
            {
                "format": FORMAT_VERSION,
                "state": self.state,
                "session_id": f"{self.session_id:016x}",
                "role": self.role,
                "device": self.device,
                "backend": self.backend,
                "vendor": self.vendor,
                "rmw": self.rmw,
                "domain_id": self.domain_id,
                "relay_id": self.relay_id,
                "connectivity": self.connectivity,
                "wall_anchor_ns": self.wall_anchor_ns,
                "monotonic_anchor_ns": self.monotonic_anchor_ns,
                "host": dict(self.host),
                "dropped_events": self.dropped_events,
                **self.extra,
            },
        )

    @classmethod
    def from_json(cls, text: str, path: Path | str) -> Session:
        """The session that `text` describes.

        Raises:
            TraceFormatError: no JSON object, another format version, or a needed field is missing or of
                another type; the message names `path` and the field.
        """
        take = _Fields.parse(text, path, "session")
        return cls(
            session_id=take.hex_id("session_id"),
            role=take.text("role"),
            device=take.text("device"),
            backend=take.text("backend"),
            vendor=take.text("vendor"),
            rmw=take.optional("rmw", str),
            domain_id=take.integer("domain_id"),
            relay_id=take.optional("relay_id", int),
            connectivity=take.text("connectivity"),
            wall_anchor_ns=take.integer("wall_anchor_ns"),
            monotonic_anchor_ns=take.integer("monotonic_anchor_ns"),
            host=take.mapping("host"),
            dropped_events=take.integer("dropped_events"),
            state=take.text("state"),
            extra=take.rest(),
        )


@dataclass(frozen=True, slots=True)
class Run:
    """What a ping says of one cell of a sweep, at its start and at its end.

    Attributes:
        run_id: 64-bit random number, 16 hex digits in the JSON.
        data_type: `binary`, `string`, `imu` or another payload's name.
        payload_bytes: application bytes of a message, the stamp not counted.
        planned_messages: messages to be measured, the warm-up before them not counted.
        warmup_messages: the first messages, kept out of every statistic.
        bridge: `none` or the bridge between the two domains.
        relay_domain_id: the relay's domain as the ping was told, null if unknown.
        published: messages handed to the middleware, warm-up included; final in state `finished`.
        extra: fields that this version does not know, kept as they are.
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
    extra: Mapping[str, Any] = field(default_factory=dict)

    def finished(self, published: int, **extra: Any) -> Run:
        """The same run as it is described at its end."""
        return replace(self, state="finished", published=published, extra={**self.extra, **extra})

    def to_json(self) -> str:
        """The text stored on `/dds_trace/run`."""
        return json.dumps(
            {
                "format": FORMAT_VERSION,
                "state": self.state,
                "run_id": f"{self.run_id:016x}",
                "data_type": self.data_type,
                "payload_bytes": self.payload_bytes,
                "rate_hz": self.rate_hz,
                "planned_messages": self.planned_messages,
                "warmup_messages": self.warmup_messages,
                "bridge": self.bridge,
                "relay_domain_id": self.relay_domain_id,
                "serialization": self.serialization,
                "qos": self.qos.to_dict(),
                "labels": dict(self.labels),
                "published": self.published,
                **self.extra,
            },
        )

    @classmethod
    def from_json(cls, text: str, path: Path | str) -> Run:
        """The run that `text` describes; errors as for `Session.from_json`."""
        take = _Fields.parse(text, path, "run")
        qos = take.nested("qos")
        return cls(
            run_id=take.hex_id("run_id"),
            data_type=take.text("data_type"),
            payload_bytes=take.integer("payload_bytes"),
            rate_hz=take.number("rate_hz"),
            planned_messages=take.integer("planned_messages"),
            warmup_messages=take.integer("warmup_messages"),
            bridge=take.text("bridge"),
            relay_domain_id=take.optional("relay_domain_id", int),
            serialization=take.text("serialization"),
            qos=Qos(
                reliability=qos.text("reliability"),
                durability=qos.text("durability"),
                history=qos.text("history"),
                depth=qos.integer("depth"),
                extra=qos.rest(),
            ),
            labels={str(k): str(v) for k, v in take.mapping("labels").items()},
            published=take.integer("published"),
            state=take.text("state"),
            extra=take.rest(),
        )


class _Fields:
    """A JSON object from a trace, taken field by field; what is left at the end is unknown to us."""

    def __init__(self, found: dict[str, Any], path: Path | str, what: str) -> None:
        self._left = found
        self._path = path
        self._what = what

    @classmethod
    def parse(cls, text: str, path: Path | str, what: str) -> _Fields:
        """The fields of `text`, whose format version is one that we read."""
        try:
            found = json.loads(text)
        except ValueError as err:
            raise TraceFormatError(path, f"the {what} description is not JSON ({err})") from err
        if not isinstance(found, dict):
            raise TraceFormatError(path, f"the {what} description is not a JSON object")
        held = cls(found, path, what)
        version = held.integer("format")
        if version != FORMAT_VERSION:
            raise TraceFormatError(
                path,
                f"the {what} description has format {version}, this version reads {FORMAT_VERSION}; "
                "update dds-trace on this machine",
            )
        return held

    def nested(self, name: str) -> _Fields:
        return _Fields(self.mapping(name), self._path, f"{self._what}.{name}")

    def _need(self, name: str, kinds: type | tuple[type, ...], kind_name: str) -> Any:
        if name not in self._left:
            raise TraceFormatError(self._path, f"the {self._what} description has no field {name!r}")
        value = self._left.pop(name)
        if not isinstance(value, kinds) or isinstance(value, bool):
            raise TraceFormatError(
                self._path,
                f"field {name!r} of the {self._what} description is {value!r}, not {kind_name}",
            )
        return value

    def text(self, name: str) -> str:
        value: str = self._need(name, str, "a string")
        return value

    def integer(self, name: str) -> int:
        value: int = self._need(name, int, "an integer")
        return value

    def number(self, name: str) -> float:
        return float(self._need(name, (int, float), "a number"))

    def mapping(self, name: str) -> dict[str, Any]:
        value: dict[str, Any] = self._need(name, dict, "an object")
        return value

    def hex_id(self, name: str) -> int:
        text = self.text(name)
        try:
            value = int(text, 16)
        except ValueError:
            value = -1
        if len(text) != 16 or value < 0:
            raise TraceFormatError(
                self._path,
                f"field {name!r} of the {self._what} description is {text!r}, not 16 hex digits",
            )
        return value

    def optional(self, name: str, kind: type) -> Any:
        """The value, or None where the field is null."""
        if name in self._left and self._left[name] is None:
            del self._left[name]
            return None
        return self._need(name, kind, f"null or {kind.__name__}")

    def rest(self) -> dict[str, Any]:
        return self._left
