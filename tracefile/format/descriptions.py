"""The two JSON descriptions in a trace: `Session` for a recording process, `Run` for one cell of a sweep.

Unknown fields are kept and written back; a missing field is an error that names the file and the field.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, TypeVar

from ..errors import TraceFormatError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from .json_values import Json, JsonObject

T = TypeVar("T")

FORMAT_VERSION = 1
"""Version of the descriptions' JSON, written into each. Version 1: first version (2026)."""


@dataclass(frozen=True, slots=True)
class Qos:
    """Quality of service of a run's data topics.

    Attributes:
        reliability: `reliable` or `best_effort`.
        durability: `volatile` or `transient_local`.
        history: `keep_last` or `keep_all`.
        depth: number of messages kept, for `keep_last`.
        extra: further fields of the JSON object (`deadline_ns`, `lifespan_ns`), kept as they are.
    """

    reliability: str = "reliable"
    durability: str = "volatile"
    history: str = "keep_last"
    depth: int = 10
    extra: JsonObject = field(default_factory=dict)

    def to_dict(self) -> dict[str, Json]:
        """Return the JSON object of `docs/trace-format.md`."""
        return {
            "reliability": self.reliability,
            "durability": self.durability,
            "history": self.history,
            "depth": self.depth,
            **self.extra,
        }


@dataclass(frozen=True, slots=True)
class Session:
    """Description of one recording process, written at its start and again at a clean end.

    Attributes:
        session_id: 64-bit random number, 16 hex digits in the JSON.
        role: `ping` or `relay`.
        device: name of the machine, as the user gave it or as the system has it.
        backend: the API that carried the messages.
        vendor: the DDS implementation, or `none`.
        rmw: the ROS middleware; None outside of ROS 2.
        domain_id: the DDS domain.
        relay_id: the relay's random number; None for a ping.
        connectivity: the link between the devices, as the user named it.
        wall_anchor_ns: ns since 1970 at the instant `monotonic_anchor_ns` of CLOCK_MONOTONIC.
        monotonic_anchor_ns: CLOCK_MONOTONIC at the same instant, ns.
        host: fingerprint of the environment.
        dropped_events: number of events that the recorder could not keep.
        state: `open` at the start, `closed` at a clean end.
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
    host: JsonObject = field(default_factory=dict)
    dropped_events: int = 0
    state: str = "open"
    extra: JsonObject = field(default_factory=dict)

    def closed(self, dropped_events: int, **extra: Json) -> Session:
        """Return the session as it is described at a clean end, with `extra` added."""
        return replace(self, state="closed", dropped_events=dropped_events, extra={**self.extra, **extra})

    def wall_ns(self, monotonic_ns: int) -> int:
        """Convert an instant of this device's monotonic clock to its wall clock (ns since 1970), by the anchor."""
        return self.wall_anchor_ns + (monotonic_ns - self.monotonic_anchor_ns)

    def to_json(self) -> str:
        """Return the text stored on `/dds_trace/session`."""
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
        """Parse the description of a session.

        Args:
            text: the JSON text.
            path: the trace, for errors.

        Raises:
            TraceFormatError: `text` is no JSON object, has another format version, or lacks a field or has one of
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
    """Description of one run (one cell of a sweep) by its ping, written at its start and at its end.

    Attributes:
        run_id: 64-bit random number, 16 hex digits in the JSON.
        data_type: `binary`, `string`, `imu` or another payload's name.
        payload_bytes: application bytes of a message, without the stamp.
        rate_hz: messages a second, as planned.
        planned_messages: number of messages to be measured, without the warm-up before them.
        warmup_messages: number of first messages that are kept out of every statistic.
        bridge: the bridge between the two domains, or `none`.
        relay_domain_id: the relay's domain, as the user told the ping; None if unknown.
        serialization: `raw` or `typed`.
        qos: quality of service of the data topics.
        labels: the user's labels.
        published: number of messages handed to the middleware, with the warm-up; final in state `finished`.
        state: `started` or `finished`.
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
    extra: JsonObject = field(default_factory=dict)

    def finished(self, published: int, **extra: Json) -> Run:
        """Return the run as it is described at its end, with `extra` added."""
        return replace(self, state="finished", published=published, extra={**self.extra, **extra})

    def to_json(self) -> str:
        """Return the text stored on `/dds_trace/run`."""
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
        """Parse the description of a run; arguments and errors as for `Session.from_json`."""
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
    """A JSON object from a trace, taken field by field; what is left at the end is unknown to this version.

    Args:
        left: the object; each field that is taken is removed from it.
        path: the trace, for errors.
        what: the name of the description, for errors.
    """

    def __init__(self, left: dict[str, Json], path: Path | str, what: str) -> None:
        self._left = left
        self._path = path
        self._what = what

    @classmethod
    def parse(cls, text: str, path: Path | str, what: str) -> _Fields:
        """Parse a description and check that its format version is one that this version reads."""
        try:
            described = json.loads(text)
        except ValueError as err:
            raise TraceFormatError(path, f"the {what} description is not JSON ({err})") from err
        if not isinstance(described, dict):
            raise TraceFormatError(path, f"the {what} description is not a JSON object")
        fields = cls(described, path, what)
        version = fields.integer("format")
        if version != FORMAT_VERSION:
            raise TraceFormatError(
                path,
                f"the {what} description has format {version}, this version reads {FORMAT_VERSION}; "
                "update dds-trace on this machine",
            )
        return fields

    def nested(self, name: str) -> _Fields:
        """Take a field that is an object with fields of its own."""
        return _Fields(self.mapping(name), self._path, f"{self._what}.{name}")

    def text(self, name: str) -> str:
        """Take a string."""
        return self._take(name, str, "a string")

    def integer(self, name: str) -> int:
        """Take an integer."""
        return self._take(name, int, "an integer")

    def number(self, name: str) -> float:
        """Take an integer or a float."""
        value = self._pop(name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._wrong(name, value, "a number")
        return float(value)

    def mapping(self, name: str) -> dict[str, Json]:
        """Take an object as it is."""
        return self._take(name, dict, "an object")

    def hex_id(self, name: str) -> int:
        """Take a 64-bit number written as 16 hex digits."""
        text = self.text(name)
        try:
            value = int(text, 16)
        except ValueError:
            value = -1
        if len(text) != 16 or value < 0:
            raise self._wrong(name, text, "16 hex digits")
        return value

    def optional(self, name: str, kind: type[T]) -> T | None:
        """Take a value of type `kind`, or None where the field is null."""
        if name in self._left and self._left[name] is None:
            del self._left[name]
            return None
        return self._take(name, kind, f"null or {kind.__name__}")

    def rest(self) -> dict[str, Json]:
        """Return the fields that were not taken."""
        return self._left

    def _pop(self, name: str) -> Json:
        if name not in self._left:
            raise TraceFormatError(self._path, f"the {self._what} description has no field {name!r}")
        return self._left.pop(name)

    def _take(self, name: str, kind: type[T], kind_name: str) -> T:
        value = self._pop(name)
        if not isinstance(value, kind) or isinstance(value, bool):
            raise self._wrong(name, value, kind_name)
        return value

    def _wrong(self, name: str, value: Json, kind_name: str) -> TraceFormatError:
        return TraceFormatError(
            self._path, f"field {name!r} of the {self._what} description is {value!r}, not {kind_name}"
        )
