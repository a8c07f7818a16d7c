"""The plan of a run, from the options and the data."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.units import SECOND_NS
from dds_trace.tracefile.format.descriptions import Qos, Run

from ..choices import Serialization
from ..options import DEFAULT_MESSAGES, DEFAULT_RATE_HZ, run_settings

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from dds_trace.tracefile.format.json_fields import JsonObject

    from ..options import PingOptions, RecordOptions
    from ..payloads.base import DataType, Payload


@dataclass(frozen=True, slots=True)
class RunPlan:
    """The messages of a run and their schedule; no statistic counts the first `warmup` ones."""

    payload: Payload
    rate_hz: float
    messages: int
    warmup: int = 0
    qos: Qos = field(default_factory=Qos)
    serialization: Serialization = Serialization.RAW
    bridge: str = "none"
    relay_domain_id: int | None = None
    labels: Mapping[str, str] = field(default_factory=dict)
    extra: JsonObject = field(default_factory=dict)

    @property
    def total(self) -> int:
        """Planned messages, warm-up included."""
        return self.warmup + self.messages

    def scheduled_ns(self, start_ns: int, sequence: int) -> int:
        """Return T0 of a message, which is fixed before the run."""
        return start_ns + round(sequence * SECOND_NS / self.rate_hz)

    def describe(self, run_id: int) -> Run:
        """Return the trace's description of the run."""
        return Run(
            run_id=run_id,
            data_type=self.payload.data_type.name,
            payload_bytes=self.payload.payload_bytes,
            rate_hz=self.rate_hz,
            planned_messages=self.messages,
            warmup_messages=self.warmup,
            bridge=self.bridge,
            relay_domain_id=self.relay_domain_id,
            serialization=self.serialization.value,
            qos=self.qos,
            labels=self.labels,
            extra=self.extra,
        )


def plan_run(options: RecordOptions, ping: PingOptions, payload: Payload, *, session_id: int, seed: int) -> RunPlan:
    """Return the run of these options with this payload."""
    check_serialization([payload.data_type], options.serialization)
    check_rate(ping, is_live=payload.feed is not None)
    rate_hz = ping.rate_hz or payload.rate_hz or DEFAULT_RATE_HZ
    limits.check(limits.RATE_HZ, rate_hz, f"rate of {ping.data}")
    own_domain_id = options.node.domain_id
    source = {"data_source": payload.source} if payload.source else {"seed": seed}
    running = {"bridge_running": True} if ping.bridge_running else {}
    return RunPlan(
        payload=payload,
        rate_hz=rate_hz,
        messages=count_messages(ping.messages, options.duration_s, rate_hz, ping.warmup),
        warmup=ping.warmup,
        qos=options.node.qos,
        serialization=options.serialization,
        bridge=ping.bridge,
        relay_domain_id=own_domain_id if ping.relay_domain_id is None else ping.relay_domain_id,
        labels=ping.labels,
        extra={"session_id": f"{session_id:016x}", **source, **running, "settings": run_settings(ping)},
    )


def count_messages(messages: int | None, duration_s: float | None, rate_hz: float, warmup: int) -> int:
    """Return the messages that are requested, or fit the duration."""
    if messages is not None:
        return messages
    if duration_s is None:
        return DEFAULT_MESSAGES
    fitting = max(round(duration_s * rate_hz) - warmup, 1)
    limits.check(limits.MESSAGES, fitting, f"--duration {duration_s:g} at {rate_hz:g} Hz are")
    return fitting


def check_rate(ping: PingOptions, *, is_live: bool) -> None:
    """Refuse a rate for a live topic."""
    if is_live and ping.rate_hz is not None:
        raise OptionError("--rate cannot be given with topic:/NAME, whose messages are the schedule")


def check_serialization(data_types: Iterable[DataType], serialization: Serialization) -> None:
    """Refuse message objects of a data type that has none."""
    if serialization is Serialization.TYPED:
        for data_type in data_types:
            data_type.object_form()
